"""One picture, one moment: what is sent together leaves together.

viser sends at most 128 messages at a time; a moving hand takes more, and a page would draw one part a picture
later. That number is private to viser. Where it is gone, viser's own stays, and a line says so.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import viser

from myowarp.engine.warn_once import warn_once

MOST_MESSAGES = 1 << 16
"""Of a moment: more than any body takes."""


def send_whole(server: viser.ViserServer) -> None:
    """Send all messages that there are at a time."""
    try:
        buffer = server._websock_server._broadcast_buffer
        assert isinstance(buffer.max_window_size, int)
        buffer.max_window_size = MOST_MESSAGES
    except (AttributeError, AssertionError) as error:
        warn_once(f"viser {viser.__version__} has changed, pictures may show two moments: {error!r}")


def at_once(server: viser.ViserServer, send: Callable[[], None]) -> None:
    """Send what belongs together, while nothing of it leaves.

    From another thread, viser may have sent half of the picture before when the next one replaces the other
    half: a page would show two moments. What its event loop calls cannot come in between.

    Raises:
        Exception: What `send` raises.
    """
    done: Future[None] = Future()

    def run() -> None:
        try:
            with server.atomic():
                send()
            done.set_result(None)
        except BaseException as error:  # noqa: BLE001 (for the caller)
            done.set_exception(error)

    server.get_event_loop().call_soon_threadsafe(run)
    done.result()
