"""The page over HTTP and its scenes over a WebSocket, each visitor's controllers in a process of their own.

What can be fetched is a table of names made at the start, so that no request reaches a file.  A page of another host is
refused by its ``Origin``, and one that gave its own name this address (DNS rebinding) by its ``Host``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import socket
import sys
import webbrowser
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import parse_qs

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from .export import files
from .scene import parsed

MOST_VISITORS = 6
"""Each has a process with all controllers in it, of some 300 MB."""

_FIRST_ANSWER, _NEXT_ANSWER = 180.0, 20.0
"""Seconds after which a visitor's process is given up: it interrupts its controllers long before, where it can."""

_LONGEST_MESSAGE = 200_000
_LONGEST_ANSWER = 2**24
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "media-src blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript"}


class Unanswered(Exception):
    """A process that did not answer, and was ended."""


class Process:
    """A process in which one visitor's controllers work.

    Parameters
    ----------
    specs : sequence of str
        The user's own controllers.
    """

    def __init__(self, specs: Sequence[str]) -> None:
        self._specs = specs
        self._process: asyncio.subprocess.Process | None = None
        self._ready = self._warm = False

    @property
    def command(self) -> tuple[str, ...]:
        """The program and its arguments."""
        return (sys.executable, "-m", f"{__package__}.scene", *self._specs)

    async def start(self) -> None:
        """Start it; it is ready once it has imported all controllers."""
        pipe = asyncio.subprocess.PIPE
        self._process = await asyncio.create_subprocess_exec(
            *self.command, stdin=pipe, stdout=pipe, limit=_LONGEST_ANSWER
        )

    async def ask(self, message: Mapping[str, Any]) -> bytes:
        """Return the answer to a message.

        Raises
        ------
        Unanswered
            If there is none in time, or the process ended; it is then gone.
        """
        process, line = self._process, b""
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            async with asyncio.timeout(_NEXT_ANSWER if self._warm else _FIRST_ANSWER):
                if not self._ready:
                    await process.stdout.readline()  # that it is
                    self._ready = True
                process.stdin.write(json.dumps(message).encode() + b"\n")
                await process.stdin.drain()
                line = await process.stdout.readline()
        except (TimeoutError, ConnectionError, ValueError):
            line = b""
        self._warm = message["do"] == "advance"
        if not line.endswith(b"\n"):
            await self.end()
            raise Unanswered
        return line[:-1]

    async def end(self) -> None:
        """End it, whatever it is doing."""
        if self._process is None:
            return
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        await self._process.communicate()  # closes both pipes


class Server:
    """The page, its socket, and who may use them.

    Parameters
    ----------
    specs : sequence of str
        The user's own controllers, ``path.py:factory`` or ``module:factory``.
    host : str
        Where to listen; beyond this machine only visitors that know the token are served.
    port : int
        The port; 0 takes a free one.
    """

    def __init__(self, specs: Sequence[str] = (), host: str = "127.0.0.1", port: int = 0) -> None:
        self._specs = specs
        self._spare: Process | None = None
        self._visitors = 0
        self._files = {name: text.encode() for name, text in files(specs).items()}
        self.listener = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
        self.port = int(self.listener.getsockname()[1])
        self._host = host if host not in ("0.0.0.0", "::") else socket.gethostname()
        self.token = "" if host in _LOOPBACK else secrets.token_urlsafe(16)
        routes = [Route("/{name:path}", self._page), WebSocketRoute("/socket", self._socket)]
        self.app = Starlette(routes=routes, lifespan=self._lifespan)

    @property
    def url(self) -> str:
        """Where the page is, with the token that it takes from elsewhere."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    def serving(self) -> uvicorn.Server:
        """Return what serves the page once it is run on the listener."""
        return uvicorn.Server(
            uvicorn.Config(
                self.app, log_level="warning", ws="websockets-sansio", ws_max_size=_LONGEST_MESSAGE, server_header=False
            )
        )

    def run(self, browser: bool) -> None:
        """Serve until interrupted, and open the page in a browser."""
        print(f"{self.url}\nCtrl-C ends it.", flush=True)
        if browser:
            webbrowser.open(self.url)
        with contextlib.suppress(KeyboardInterrupt):
            self.serving().run(sockets=[self.listener])

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self._spare = await self._new()
        yield
        if self._spare is not None:
            await self._spare.end()

    async def _new(self) -> Process:
        process = Process(self._specs)
        await process.start()
        return process

    def _refused(self, connection: HTTPConnection) -> str:
        """Return why a page or socket is not for this visitor, if so."""
        host, origin = connection.headers.get("host", ""), connection.headers.get("origin")
        name = host.rpartition(":")[0].strip("[]")
        if not self.token and (name not in _LOOPBACK or host.rpartition(":")[2] != str(self.port)):
            return "This address is only served as 127.0.0.1 or localhost."
        if origin is not None and origin != f"http://{host}":
            return "Pages of other hosts are not served."
        return ""

    def _knows_token(self, connection: HTTPConnection) -> bool:
        given = parse_qs(str(connection.url.query)).get("token", [""])[0]
        return not self.token or secrets.compare_digest(given.encode(), self.token.encode())

    async def _page(self, request: Request) -> Response:
        name = request.path_params["name"] or "index.html"
        if why := self._refused(request):
            return PlainTextResponse(why, 403, _HEADERS)
        if name not in self._files:
            return PlainTextResponse("There is no such page.", 404, _HEADERS)
        if name == "index.html" and not self._knows_token(request):
            return PlainTextResponse("Open the address that was printed, with its token.", 403, _HEADERS)
        return Response(self._files[name], headers=_HEADERS, media_type=_KINDS[name.rpartition(".")[2]])

    async def _socket(self, visitor: WebSocket) -> None:
        if self._refused(visitor) or not self._knows_token(visitor):
            await visitor.close(1008)
            return
        await visitor.accept()
        if self._visitors >= MOST_VISITORS:
            await _say(visitor, error=f"{MOST_VISITORS} pages are open already; close one of them and reload this one.")
            await visitor.close(1013)
            return
        self._visitors += 1
        try:
            await self._serve(visitor)
        finally:
            self._visitors -= 1

    async def _serve(self, visitor: WebSocket) -> None:
        """Answer a visitor's messages in turn until the visitor leaves, be it in the middle of an answer."""
        process, self._spare = self._spare or await self._new(), None
        inbox: asyncio.Queue[str | None] = asyncio.Queue(4)
        leaving = asyncio.create_task(_read(visitor, inbox))
        answering: asyncio.Task[bytes] | None = None
        idle = True
        try:
            while (text := await inbox.get()) is not None:
                try:
                    message = parsed(text)
                    identity = message.pop("id", None)
                    if not (identity is None or (type(identity) is int and abs(identity) < 2**53)):
                        raise ValueError("id must be a whole number.")
                    if message.get("do") not in ("scene", "advance"):
                        raise ValueError('do must be "scene" or "advance".')
                except ValueError as error:
                    await _say(visitor, error=str(error))
                    continue
                answering, idle = asyncio.create_task(process.ask(message)), False
                await asyncio.wait({answering, leaving}, return_when=asyncio.FIRST_COMPLETED)
                if not answering.done():
                    break
                try:
                    answer = answering.result()
                except Unanswered:
                    process = await self._new()
                    await _say(visitor, id=identity, lost="The controllers did not answer and were stopped.")
                    continue
                idle = True
                await visitor.send_text(f'{{"id": {json.dumps(identity)}, {answer[1:].decode()}')
        except (WebSocketDisconnect, RuntimeError):
            pass  # the visitor left while being answered
        finally:
            leaving.cancel()
            if answering is not None and not idle:
                idle = bool((await asyncio.wait({answering}, timeout=1.0))[0]) and answering.exception() is None
                answering.cancel()
                await asyncio.wait({answering})
            if idle and self._spare is None:
                self._spare = process  # the next scene replaces all that was in it
            else:
                await process.end()


async def _read(visitor: WebSocket, inbox: asyncio.Queue[str | None]) -> None:
    """Pass messages on, and end when the visitor leaves."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            message = await visitor.receive()
            if message["type"] != "websocket.receive":
                break
            await inbox.put(message.get("text") or "")
    await inbox.put(None)


async def _say(visitor: WebSocket, **words: object) -> None:
    await visitor.send_text(json.dumps(words))
