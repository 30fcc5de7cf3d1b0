"""The viewer as a page for the browser, served on loopback by the service itself.

Rerun's own server of that page has no say over what the page may fetch, and the page fetches fonts, examples and
release notes, and sends usage statistics. So its files are taken from rerun once, when somebody first asks for the
page, and served under a policy that lets the browser speak to this machine's service only.
"""

from __future__ import annotations

import gzip
import http.server
import logging
import os
import socket
import socketserver
import subprocess
import threading
import urllib.parse
import urllib.request
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any

import rerun_cli  # type: ignore[import-untyped]

from service.sinks.ports import listens

__all__ = ["ViewerPage", "rerun_program"]

log = logging.getLogger(__name__)

FILES = {
    "": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
LOOPBACK = "127.0.0.1"
FETCH_TIMEOUT_S = 20.0
REQUEST_TIMEOUT_S = 10.0


def rerun_program() -> Path:
    """Path of rerun's program itself: its Python wrapper, ended, would leave it running."""
    return Path(rerun_cli.__file__).with_name("rerun")


@dataclass(frozen=True, slots=True)
class _File:
    kind: str
    packed: bytes
    size: int


class ViewerPage:
    """Serves the viewer's page; `/` leads to the live data.

    Parameters
    ----------
    address, port
        Where to listen.
    grpc_url
        Where the page finds the data.
    """

    def __init__(self, address: str, port: int, grpc_url: str) -> None:
        self.grpc_url = grpc_url
        self.url = f"http://{address}:{port}/"
        data = urllib.parse.urlsplit(grpc_url.removeprefix("rerun+"))
        self.policy = (
            "default-src 'none'; base-uri 'none'; form-action 'none'; worker-src 'self' blob:; font-src 'self' data:; "
            "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
            f"connect-src 'self' {data.scheme}://{data.netloc} data: blob:; img-src 'self' data: blob:"
        )
        self._files: dict[str, _File] | None = None
        self._loading = threading.Lock()
        self._server = _Server((address, port), self)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name="bowlsight-viewer-page", daemon=True
        )

    @property
    def location(self) -> str:
        """Path and query that open the live data without the welcome screen, and forget nothing of the layout sent."""
        query = {"url": self.grpc_url, "hide_welcome_screen": "1", "persist": "0", "theme": "dark"}
        return f"/?{urllib.parse.urlencode(query)}"

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def close(self) -> None:
        """Stop listening. May be repeated."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()

    def file(self, name: str) -> _File:
        """One of the page's files, taken from rerun at the first call; raises OSError where that fails."""
        with self._loading:
            if self._files is None:
                self._files = _fetch(self.grpc_url)
            return self._files[name]


def _fetch(grpc_url: str) -> dict[str, _File]:
    """Take the page's files from rerun's own server, which runs for this only."""
    with socket.socket() as s:
        s.bind((LOOPBACK, 0))
        port = s.getsockname()[1]
    command = [str(rerun_program()), "--serve-web", "--bind", LOOPBACK, "--web-viewer-port", str(port), grpc_url]
    quiet = os.environ | {"CI": "1", "RUST_LOG": "off"}  # on CI rerun neither counts its users nor leaves files behind
    with subprocess.Popen(  # noqa: S603 - rerun's own program
        command, env=quiet, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            if not listens(LOOPBACK, port, FETCH_TIMEOUT_S):
                raise OSError(f"{command[0]} did not serve its page within {FETCH_TIMEOUT_S:g} s")
            return {name: _get(f"http://{LOOPBACK}:{port}/{name}", kind) for name, kind in FILES.items()}
        finally:
            process.kill()


def _get(url: str, kind: str) -> _File:
    with urllib.request.urlopen(url, timeout=FETCH_TIMEOUT_S) as answer:  # noqa: S310 - loopback
        content = answer.read()
    return _File(kind, gzip.compress(content, 1), len(content))  # 43 MB of program: 14 MB are kept and sent


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], page: ViewerPage) -> None:
        self.page = page
        super().__init__(address, _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002 - the base class's arguments
        """Log that a browser broke off: the base class would print a traceback."""
        log.debug("viewer page: request from %s broke off", client_address)


class _Handler(http.server.BaseHTTPRequestHandler):
    server: _Server
    timeout = REQUEST_TIMEOUT_S

    def do_GET(self) -> None:
        """Answer with a file of the page, or lead to the live data."""
        path, _, query = self.path.partition("?")
        name = path.lstrip("/")
        if name not in FILES:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif name == "" and not query:
            self.send_response(HTTPStatus.FOUND)
            self.send_header("Location", self.server.page.location)
            self.end_headers()
        else:
            self._send(name)

    def _send(self, name: str) -> None:
        page = self.server.page
        try:
            file = page.file(name)
        except OSError as error:
            log.warning("viewer page: %s", error)
            self.send_error(HTTPStatus.BAD_GATEWAY, explain=str(error))
            return
        packed = "gzip" in self.headers.get("Accept-Encoding", "")
        content = file.packed if packed else gzip.decompress(file.packed)
        self.send_response(HTTPStatus.OK)
        if packed:
            self.send_header("Content-Encoding", "gzip")
        self.send_header("Content-Type", file.kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("rerun-final-length", str(file.size))  # what the page's own progress bar goes by
        self.send_header("Content-Security-Policy", page.policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class's name
        """Keep requests out of the terminal."""
        log.debug(format, *args)
