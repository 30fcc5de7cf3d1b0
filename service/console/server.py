"""Serves the web application from a thread of its own."""

from __future__ import annotations

import ipaddress
import logging
import socket
import threading
from typing import TYPE_CHECKING, Final

import uvicorn

from drivers.errors import ConfigError
from service.sinks.ports import free_port

if TYPE_CHECKING:
    from starlette.types import ASGIApp

__all__ = ["PORT", "WebServer", "bind", "reachable"]

log = logging.getLogger(__name__)

PORT: Final = 8420
START_TIMEOUT_S: Final = 10.0
LONGEST_MESSAGE: Final = 1024
CLOSE_S: Final = 1


def bind(address: str, port: int | None) -> socket.socket:
    """Take the port to listen on; raises ConfigError where it is not to be had."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    wanted = free_port(address, port, PORT, "[console] port")
    taken = socket.socket(family, socket.SOCK_STREAM)
    try:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind((address, wanted))
    except OSError as error:
        taken.close()
        raise ConfigError(f"[console] port = {wanted} at {address}: {error.strerror}; name another port") from None
    return taken


def reachable(address: str) -> str:
    """An address that browsers can be given: for all networks of this machine, that on the one it mostly uses."""
    if not ipaddress.ip_address(address).is_unspecified:
        return address
    family, elsewhere = (socket.AF_INET6, "2001:db8::1") if ":" in address else (socket.AF_INET, "192.0.2.1")
    with socket.socket(family, socket.SOCK_DGRAM) as asking:
        try:
            asking.connect((elsewhere, 9))  # sends nothing: the kernel only looks where that would leave
        except OSError:
            return address
        return str(asking.getsockname()[0])


class _Told(logging.Handler):
    """Passes on what uvicorn finds wrong with itself; what clients do wrong is theirs."""

    def emit(self, record: logging.LogRecord) -> None:
        log.error("the operator's page: %s", " ".join(record.getMessage().split()), exc_info=record.exc_info)


def _quiet() -> None:
    """Keep uvicorn off the terminal, but for its errors, in our own words."""
    theirs = logging.getLogger("uvicorn")
    if not any(isinstance(handler, _Told) for handler in theirs.handlers):
        theirs.addHandler(_Told(logging.ERROR))
        theirs.propagate = False


class WebServer:
    """A server on a bound socket, from `start` to `close`."""

    def __init__(self, app: ASGIApp, listening: socket.socket) -> None:
        self._listening = listening
        _quiet()
        config = uvicorn.Config(
            app,
            ws="websockets-sansio",
            http="h11",
            loop="asyncio",
            lifespan="on",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            ws_max_size=LONGEST_MESSAGE,
            ws_per_message_deflate=False,  # pictures are compressed as they are
            timeout_graceful_shutdown=CLOSE_S,
            backlog=64,
        )
        self._server = uvicorn.Server(config)
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="bowlsight-page-server", daemon=True)

    def start(self) -> None:
        """Begin to serve; raises ConfigError where that fails."""
        self._thread.start()
        waited = threading.Event()
        for _ in range(int(START_TIMEOUT_S / 0.01)):
            if self._server.started or not self._thread.is_alive():
                break
            waited.wait(0.01)
        if not self._server.started:
            self.close(1.0)
            raise ConfigError(f"the operator's page: the server did not start: {self._failed or 'no answer in time'}")

    def _run(self) -> None:
        try:
            self._server.run(sockets=[self._listening])
        except BaseException as error:  # noqa: BLE001 - a thread's end is told, whatever it was
            self._failed = error
            log.error("the operator's page is not served any more: %s", error)  # noqa: TRY400 - one line

    def close(self, timeout_s: float) -> None:
        """Stop to serve. May be repeated."""
        self._server.should_exit = True
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
            if self._thread.is_alive():
                self._server.force_exit = True
        self._listening.close()
