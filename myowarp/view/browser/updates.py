"""Changes to viser's private handling of messages, and one message that it has no function for.

A browser may set a control's value; viser sets whatever attribute a message names. Messages that are sent
together leave together; viser cuts after 128 of them, fewer than a hand takes, and a page draws one part a
picture later. All pages of viser are called "Viser". Where what this needs is gone, viser's own way stays,
and a line says so.
"""

from __future__ import annotations

import json

import viser
from viser.infra import ClientId, Message

from myowarp.process import warn_once

MOST_MESSAGES = 1 << 16
"""Messages that leave together: more than any body takes."""


def send_whole(server: viser.ViserServer) -> None:
    """Have all messages that there are leave together."""
    try:
        buffer = server._websock_server._broadcast_buffer
        assert isinstance(buffer.max_window_size, int)
        buffer.max_window_size = MOST_MESSAGES
    except (AttributeError, AssertionError) as error:
        warn_once(f"viser {viser.__version__} has changed, pictures may show two moments: {error!r}")


def name_page(server: viser.ViserServer, title: str) -> None:
    """Give a page its title, in its panel and in the browser's tab."""
    server.gui.set_panel_label(title)
    try:
        from viser._messages import RunJavascriptMessage

        script = f"document.title = {json.dumps(f'{title} · MyoWarp')}"
        server.gui._websock_interface.queue_message(RunJavascriptMessage(source=script))
    except (ImportError, AttributeError, TypeError) as error:
        warn_once(f"viser {viser.__version__} has changed, a browser's tab has no title: {error!r}")


def take_values_alone(server: viser.ViserServer) -> None:
    """Refuse messages that set more of a control than its value."""
    try:
        from viser._messages import GuiUpdateMessage

        sockets, handle = server._websock_server, server.gui._handle_gui_updates
        sockets.unregister_handler(GuiUpdateMessage, handle)
    except (ImportError, AttributeError, AssertionError, ValueError) as error:
        warn_once(f"viser {viser.__version__} has changed, a browser may set more than values: {error!r}")
        return

    async def update(client: ClientId, message: Message) -> None:
        assert isinstance(message, GuiUpdateMessage)
        if message.updates.keys() == {"value"}:
            await handle(client, message)

    sockets.register_handler(GuiUpdateMessage, update)
