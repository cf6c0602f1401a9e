"""Pages of other sites are refused at the socket: websockets can do it, viser has no setting for it.

A browser lets a page of any site open a socket to this machine, and says which site that is. While viser
opens a server, the function of websockets that it calls is exchanged for one that knows the sites. What came
of it is then tried out, as viser may come to call another function.
"""

from __future__ import annotations

import contextlib
import functools
import re
from collections.abc import Iterator
from unittest import mock

import viser
import websockets.asyncio.server
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

ORIGINS = (None, re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"))
"""Sites whose pages may use the socket; None: what is no browser."""
FOREIGN = "http://elsewhere.invalid"
FORBIDDEN = 403


@contextlib.contextmanager
def refusing_other_sites() -> Iterator[None]:
    """Have servers that open in the block refuse pages of other sites."""
    sockets = websockets.asyncio.server
    with mock.patch.object(sockets, "serve", functools.partial(sockets.serve, origins=ORIGINS)):
        yield


def check_refusal(port: int) -> None:
    """Raise RuntimeError if a page of another site may use the socket at a port of this machine."""
    try:
        connect(f"ws://127.0.0.1:{port}", origin=FOREIGN, open_timeout=None).close()
    except InvalidStatus as refused:
        if refused.response.status_code == FORBIDDEN:
            return
    raise RuntimeError(
        f"viser {viser.__version__} has changed, so that pages of other sites could use this one; run "
        '`pip install "viser==1.1.1"`'
    )
