"""The web server of a page: on this machine alone, as viser knows no passwords, and not for other sites."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import warnings

import numpy as np
import viser

from myowarp.view.browser.lights import add_lights
from myowarp.view.browser.origins import check_refusal, refusing_other_sites
from myowarp.view.browser.page_style import SOFTWARE, STYLE
from myowarp.view.browser.updates import name_page, send_whole, take_values_alone

LOCAL = "127.0.0.1"
AHEAD = np.array((0.0, 1.0, -0.2))
"""Direction of a camera until the page has pointed it."""
LEFT = "Queued a .* on a closed connection"
"""viser's warning about a browser that has left while something was sent to it."""


class _LocalServer(viser.ViserServer):
    """viser, without its tunnel to the internet, which any browser could ask for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Do not share."""


def open_server(port: int, title: str) -> viser.ViserServer:
    """Open a server on this machine; its scene is lit, and its panel is empty.

    Args:
        port: Its port; 0 for any that is free.
        title: Title of the page.

    Raises:
        OSError: The port is taken.
        RuntimeError: Pages of other sites could use it.
    """
    check_port(port)
    # What a browser sends that cannot be read, and browsers that leave, are no errors of ours.
    for name in ("websockets.server", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", LEFT, UserWarning)
    with contextlib.redirect_stdout(io.StringIO()), refusing_other_sites():
        server = _LocalServer(LOCAL, port, title, verbose=False)
    try:
        check_refusal(server.get_port())
    except RuntimeError:
        close_server(server)
        raise
    server.get_event_loop().set_exception_handler(lambda loop, context: None)
    take_values_alone(server)
    send_whole(server)
    name_page(server, title)
    server.gui.add_html(STYLE + SOFTWARE)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    server.gui.main_panel.dock_right()
    # Light from a picture takes longer than all else where software draws.
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(False)
    add_lights(server, AHEAD)
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop a server; pages that are open say so."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def check_port(port: int) -> None:
    """Raise OSError if nothing can listen at a port of this machine."""
    if not 0 <= port <= 65535:
        raise ValueError(f"--port must be from 0 to 65535, got {port}")
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((LOCAL, port))
    except OSError as error:
        raise OSError(
            f"port {port} cannot be used ({error.strerror or error}); choose another with --port, or "
            "--port 0 for a free one"
        ) from error
