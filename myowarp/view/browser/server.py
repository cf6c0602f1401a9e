"""The web server of a page: on this machine alone, or open to others behind a token.

viser knows no passwords. It listens on this machine only, and refuses pages of other sites. What comes from
elsewhere meets a gate, which lets a connection through that brings the token, once in the address and from
then on in a cookie.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import hmac
import io
import logging
import re
import socket
import threading
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from viser._messages import GuiUpdateMessage
from viser.infra import ClientId

LOCAL = "127.0.0.1"
LOCAL_NAMES = (LOCAL, "localhost", "::1")
EVERYWHERE = ("0.0.0.0", "::", "")
ORIGINS = (None, re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"))
"""Sites whose pages may use the socket; None: what is no browser."""
COOKIE = "myowarp_token"
HEAD_BYTES, HEAD_SECONDS = 65536, 10.0  # of a request
PIECE = 65536  # bytes passed on at a time
REFUSED = "This page needs its token: open the whole address that `myowarp view` has printed.\n"
ELSEWHERE = "A page of another site may not use this one.\n"


class _LocalServer(viser.ViserServer):
    """viser, without its tunnel to the internet, which any browser could ask for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Do not share."""


def open_server(port: int, title: str) -> viser.ViserServer:
    """Open a server on this machine.

    Args:
        port: Its port; 0 for any that is free.
        title: Title of the panel.

    Raises:
        OSError: The port is taken.
    """
    check_port(LOCAL, port)
    # What a browser sends that cannot be read, and browsers that leave, are no errors of ours.
    for name in ("websockets.server", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    sockets = websockets.asyncio.server
    serve = sockets.serve
    sockets.serve = functools.partial(serve, origins=ORIGINS)  # type: ignore[misc, assignment]  # viser has no setting
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            server = _LocalServer(LOCAL, port, title, verbose=False)
    finally:
        sockets.serve = serve  # type: ignore[misc]
    server.get_event_loop().set_exception_handler(lambda loop, context: None)
    _take_values_alone(server)
    server.scene.configure_default_lights(cast_shadow=False)
    return server


def _take_values_alone(server: viser.ViserServer) -> None:
    """Refuse messages that set more of a control than its value; viser sets whatever attribute they name."""
    gui, sockets = server.gui, server._websock_server

    async def update(client: ClientId, message: GuiUpdateMessage) -> None:
        if message.updates.keys() == {"value"}:
            await gui._handle_gui_updates(client, message)

    sockets.unregister_handler(GuiUpdateMessage, gui._handle_gui_updates)
    sockets.register_handler(GuiUpdateMessage, update)


def close_server(server: viser.ViserServer) -> None:
    """Stop a server; pages that are open say so."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def address_of(host: str, port: int) -> str:
    """Return the address of a page for a browser; what listens everywhere goes by the machine's name."""
    name = socket.gethostname() if host in EVERYWHERE else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}"


def check_port(host: str, port: int) -> None:
    """Raise OSError if nothing can listen there."""
    if not 0 <= port <= 65535:
        raise ValueError(f"--port must be from 0 to 65535, got {port}")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
    except OSError as error:
        raise OSError(
            f"port {port} of {host} cannot be used ({error.strerror or error}); choose another with --port, "
            "or --port 0 for a free one"
        ) from error


class Gate:
    """Passes connections with the right token on to a port of this machine.

    Attributes:
        port: Where it listens.
    """

    def __init__(self, host: str, port: int, inner: int, token: str) -> None:
        """Listen, in a thread of its own.

        Args:
            host: Address to listen at.
            port: Its port; 0 for any that is free.
            inner: Port of this machine that connections are passed on to.
            token: What they must bring.

        Raises:
            OSError: The port is taken.
        """
        check_port(host, port)
        self._inner, self._token = inner, token
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(lambda loop, context: None)
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        opening = asyncio.start_server(self._serve, host, port, limit=HEAD_BYTES)
        self._server = asyncio.run_coroutine_threadsafe(opening, self._loop).result()
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._cookie = f"{COOKIE}_{self.port}"  # a browser gives a cookie to all ports of a machine

    def close(self) -> None:
        """Stop listening, and end what is connected."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)

    async def _end(self) -> None:
        """Let all connections go, so that none is left to complain."""
        self._server.close()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer a connection."""
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_SECONDS)
            if not _is_from_here(head):
                await _answer(writer, "403 Forbidden", ELSEWHERE)
            elif self._is_right(_cookie(head, self._cookie)):
                await self._pass_on(_without_origin(head), reader, writer)
            elif self._is_right(_query(head)):
                cookie = f"{self._cookie}={self._token}; HttpOnly; SameSite=Lax; Path=/"
                await _answer(writer, "303 See Other", "", f"Location: /\r\nSet-Cookie: {cookie}\r\n")
            else:
                await _answer(writer, "403 Forbidden", REFUSED)
        except (OSError, EOFError, asyncio.LimitOverrunError, TimeoutError):
            pass  # it left, or never was a browser
        finally:
            writer.close()

    def _is_right(self, token: str) -> bool:
        """Say whether a token is ours, in a time that does not tell how much of it is right."""
        return hmac.compare_digest(token.encode(errors="replace"), self._token.encode())

    async def _pass_on(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Join a connection with one to the inner port until either ends."""
        inner_reader, inner_writer = await asyncio.open_connection(LOCAL, self._inner)
        try:
            inner_writer.write(head)
            ways = (_copy(reader, inner_writer), _copy(inner_reader, writer))
            tasks = [asyncio.ensure_future(way) for way in ways]
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        finally:
            inner_writer.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Pass bytes on until there are no more."""
    while piece := await reader.read(PIECE):
        writer.write(piece)
        await writer.drain()


async def _answer(writer: asyncio.StreamWriter, status: str, text: str, headers: str = "") -> None:
    """Write an answer of plain text."""
    length = f"Content-Type: text/plain\r\nContent-Length: {len(text)}\r\nConnection: close\r\n"
    writer.write(f"HTTP/1.1 {status}\r\n{headers}{length}\r\n{text}".encode())
    await writer.drain()


def _header(head: bytes, wanted: str) -> str:
    """Return a header of a request, "" for none."""
    for line in head.decode("latin-1").split("\r\n")[1:]:
        name, _, value = line.partition(":")
        if name.strip().lower() == wanted:
            return value.strip()
    return ""


def _is_from_here(head: bytes) -> bool:
    """Say whether a request comes from a page of the same address, or from no page."""
    origin = _header(head, "origin")
    return not origin or urlsplit(origin).netloc == _header(head, "host")


def _without_origin(head: bytes) -> bytes:
    """Return a request that viser takes for one from this machine."""
    return b"\r\n".join(line for line in head.split(b"\r\n") if not line.lower().startswith(b"origin:"))


def _cookie(head: bytes, wanted: str) -> str:
    """Return a request's cookie of a name, "" for none."""
    for part in _header(head, "cookie").split(";"):
        key, _, token = part.strip().partition("=")
        if key == wanted:
            return token
    return ""


def _query(head: bytes) -> str:
    """Return the token in a request's address, "" for none."""
    target = head.decode("latin-1").split("\r\n")[0].partition(" ")[2].partition(" ")[0]
    return parse_qs(urlsplit(target).query).get("token", [""])[0]
