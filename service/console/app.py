"""The page's web application: files, commands, and one WebSocket a page."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from typing import TYPE_CHECKING, Any, Final

from anyio import to_thread
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute

from service.console.access import Buckets, Right
from service.console.commands import COMMANDS, LOGIN, BadRequestError, Command, read_arguments
from service.console.files import INDEX, page_files
from service.console.page_socket import SocketPage
from service.console.schema import openapi
from service.console.watched import RefusedError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable

    from starlette.requests import HTTPConnection, Request
    from starlette.types import ASGIApp, Receive, Scope, Send
    from starlette.websockets import WebSocket

    from drivers.grabber import Clock
    from service.console.access import Access
    from service.console.board import Board
    from service.console.operations import Operations
    from service.console.state import StateTeller

__all__ = ["WebApp"]

log = logging.getLogger(__name__)

LOOK_S: Final = 0.1
LARGEST_BODY: Final = 4096
REQUESTS_HZ, REQUESTS_BURST = 50.0, 200.0
LOGINS_HZ, LOGINS_BURST = 0.5, 10.0
"""Guesses at a token: with 2^192 of them, this is courtesy."""
HEADERS: Final = [
    (
        b"content-security-policy",
        (
            b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
            b"base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        ),
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
]
BUSY, NOT_ALLOWED = 1013, 1008


class WebApp:
    """Answers requests, all in the server's loop.

    Parameters
    ----------
    most_pages
        That may be open at once.
    """

    def __init__(
        self, access: Access, board: Board, teller: StateTeller, operations: Operations, clock: Clock, most_pages: int
    ) -> None:
        self._access, self._board, self._teller, self._operations = access, board, teller, operations
        self._clock, self._most_pages = clock, most_pages
        self._files = page_files()
        self._schema = openapi()
        self._requests = Buckets(REQUESTS_HZ, REQUESTS_BURST, clock)
        self._logins = Buckets(LOGINS_HZ, LOGINS_BURST, clock)
        self._state = ""
        self._pages = 0
        self._commanding = asyncio.Lock()
        routes = [
            Route("/", self._index, methods=["GET"]),
            Route("/page/{name}", self._file, methods=["GET"]),
            Route("/api/schema.json", self._describe, methods=["GET"]),
            Route("/api/state", self._tell_state, methods=["GET"]),
            Route("/api/login", self._login, methods=["POST"]),
            *(Route(f"/api/{name}", self._commanded(c), methods=["POST"]) for name, c in COMMANDS.items()),
            WebSocketRoute("/live", self._live),
        ]
        starlette = Starlette(routes=routes, lifespan=self._lifespan, exception_handlers={HTTPException: _refused})
        self.asgi: ASGIApp = _Guard(starlette, access, self._requests)

    # -- what goes on without a request ------------------------------------------------------------------------------

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        del app
        self._board.attach(asyncio.get_running_loop())
        looking = asyncio.create_task(self._look())
        try:
            yield
        finally:
            self._board.attach(None)
            looking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await looking

    async def _look(self) -> None:
        """Follow the station's state, whether or not a page is open."""
        while True:
            try:
                self._state = json.dumps({**self._teller.look(), "pages": self._pages}, separators=(",", ":"))
                self._board.wake()
            except Exception:
                log.exception("the page's look at the station failed")
            await asyncio.sleep(LOOK_S)

    # -- requests ----------------------------------------------------------------------------------------------------

    async def _index(self, request: Request) -> Response:
        del request
        return self._sent(INDEX)

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"]
        return self._sent(name) if name in self._files else _error(404, "there is no such file")

    def _sent(self, name: str) -> Response:
        file = self._files[name]
        return Response(file.content, media_type=file.kind)

    async def _describe(self, request: Request) -> Response:
        del request
        return JSONResponse(self._schema)

    async def _tell_state(self, request: Request) -> Response:
        if self._right(request) is Right.NONE:
            return _error(401, "give the token that was shown when the service started")
        return Response(self._state or "{}", media_type="application/json")

    async def _login(self, request: Request) -> Response:
        try:
            token = read_arguments(LOGIN, await _body(request, self._access))["token"]
        except _Answer as answer:
            return answer.response
        except BadRequestError as error:
            return _error(400, str(error))
        if not self._logins.take(_client(request.scope)):
            return _error(429, "too many attempts; wait a little")
        right = self._access.right(token)
        if right is Right.NONE:
            log.warning("page: a wrong token was given from %s", _client(request.scope))
            return _error(401, "this is not a token of the running service")
        response = JSONResponse({"may_control": right is Right.CONTROL})
        if self._access.asks:
            response.set_cookie(self._access.cookie, token, httponly=True, samesite="strict", path="/")
        return response

    def _commanded(self, command: Command) -> Callable[[Request], Awaitable[Response]]:
        async def answer(request: Request) -> Response:
            try:
                body = await _body(request, self._access)
                if (right := self._right(request)) is not Right.CONTROL:
                    return _error(401 if right is Right.NONE else 403, "this needs the token for operating")
                arguments = read_arguments(command.arguments, body)
                async with self._commanding:  # one thing at a time, as one operator would
                    done = await to_thread.run_sync(command.run, self._operations, arguments)
            except _Answer as refusal:
                return refusal.response
            except BadRequestError as error:
                return _error(400, str(error))
            except RefusedError as error:
                return _error(409, str(error))
            now_ms = self._clock.monotonic_ns() / 1e6  # pictures grabbed from now on show what was done
            return JSONResponse({**({} if done is None else done), "now_ms": now_ms})

        return answer

    # -- pages -------------------------------------------------------------------------------------------------------

    async def _live(self, socket: WebSocket) -> None:
        right = self._right(socket)
        if not self._access.is_from_ours(socket.headers.get("origin"), socket.headers.get("host")):
            await socket.close(NOT_ALLOWED)
            return
        await socket.accept()
        if right is Right.NONE:
            await socket.close(NOT_ALLOWED, "token")
            return
        if self._pages >= self._most_pages:
            await socket.close(BUSY, f"{self._pages} pages are open already; close one")
            return
        self._pages += 1
        try:
            hello = self._teller.hello(may_control=right is Right.CONTROL)
            await SocketPage(socket, self._board, self._clock, hello, lambda: self._state).serve()
        finally:
            self._pages -= 1

    def _right(self, connection: HTTPConnection) -> Right:
        kind, _, bearer = connection.headers.get("authorization", "").partition(" ")
        token = bearer if kind.lower() == "bearer" else connection.cookies.get(self._access.cookie)
        return self._access.right(token)


def _client(scope: Scope) -> str:
    client = scope.get("client")
    return str(client[0]) if client else "unknown"


class _Answer(Exception):  # noqa: N818 - no error: a request is answered early
    """Carries a refusal out of where it was found."""

    def __init__(self, status: int, words: str) -> None:
        super().__init__(words)
        self.response = _error(status, words)


def _error(status: int, words: str) -> Response:
    return JSONResponse({"error": words}, status)


async def _refused(request: Request, error: Exception) -> Response:
    """What there is not, in the words that everything else is refused in."""
    del request
    assert isinstance(error, HTTPException), "registered for these"
    response = _error(error.status_code, error.detail.lower())
    response.headers.update(error.headers or {})
    return response


async def _body(request: Request, access: Access) -> bytes:
    """The body of a command, once it is certain that this page, or a program of the station, sent it."""
    if not access.is_from_ours(request.headers.get("origin"), request.headers.get("host")):
        raise _Answer(403, "commands are taken from this page only; a program gives its address as Origin")
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise _Answer(415, "the body must be application/json")
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > LARGEST_BODY:
            raise _Answer(413, f"the body must be at most {LARGEST_BODY} bytes long")
    return bytes(body)


class _Guard:
    """Stands before everything: hosts that are not this one, floods, and headers that keep the page to itself."""

    def __init__(self, app: ASGIApp, access: Access, requests: Buckets) -> None:
        self._app, self._access, self._requests = app, access, requests

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        host = next((value.decode("latin-1") for name, value in scope["headers"] if name == b"host"), None)
        if not self._access.is_ours(host):
            await self._refuse(421, "this is not the name of this station; see [console] names", scope, receive, send)
        elif not self._requests.take(_client(scope)):
            await self._refuse(429, "too many requests; wait a little", scope, receive, send)
        else:
            await self._app(scope, receive, _with_headers(send))

    @staticmethod
    async def _refuse(status: int, words: str, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": NOT_ALLOWED})
        else:
            await _error(status, words)(scope, receive, _with_headers(send))


def _with_headers(send: Send) -> Send:
    async def sent(message: Any) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), *HEADERS]
        await send(message)

    return sent
