"""One picture, one moment: what is sent together leaves together."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import viser


def at_once(server: viser.ViserServer, send: Callable[[], None]) -> None:
    """Send what belongs together, while nothing of it leaves.

    From another thread, viser may have sent half of the picture before when the next one replaces the other
    half: a page would show two moments. Calls of its event loop cannot come in between.

    Raises:
        Exception: What `send` raises.
    """

    async def run() -> None:
        with server.atomic():
            send()

    asyncio.run_coroutine_threadsafe(run(), server.get_event_loop()).result()
