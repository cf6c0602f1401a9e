"""What a browser may set of a control: its value. viser sets whatever attribute a message names.

What this needs is private to viser. Where it is gone, viser's own handler stays, and a line says so.
"""

from __future__ import annotations

import viser
from viser.infra import ClientId, Message

from myowarp.engine.warn_once import warn_once


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
