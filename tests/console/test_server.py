"""The page's server itself, by what a browser would never send."""

import contextlib
import http.client
import json
import logging
import socket
import threading

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from drivers.errors import ConfigError
from service.console.server import WebServer, bind, reachable
from tests.browser.served import Served

PATIENCE_S = 30.0


@pytest.fixture
def served():
    with Served() as station:
        yield station


def live(served, **more):
    where = f"ws://127.0.0.1:{served.port}/live"
    return connect(where, origin=f"http://127.0.0.1:{served.port}", compression=None, **more)


def answer(served, sent: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE_S) as line:
        with contextlib.suppress(OSError):
            line.sendall(sent)
        try:
            return line.recv(4096)
        except ConnectionError:
            return b""


def read_on(line) -> None:
    for _ in range(1000):
        line.recv(PATIENCE_S)


def answers_still(served) -> bool:
    line = http.client.HTTPConnection("127.0.0.1", served.port, timeout=PATIENCE_S)
    with contextlib.closing(line):
        line.request("GET", "/api/state")
        return line.getresponse().status == 200


@pytest.mark.parametrize(
    "sent",
    [
        b"\x00" * 2000,
        b"GET " + b"/" * 100_000,
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + b"A: b\r\n" * 20_000,
        b"GET / HTTP/1.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    ],
)
def test_what_is_no_request_is_refused_without_a_word_in_the_log(served, sent, caplog):
    assert b" 200 " not in answer(served, sent)
    assert answers_still(served)
    assert [r for r in caplog.records if r.levelno >= logging.ERROR] == []


def test_connections_that_say_nothing_keep_nobody_out(served):
    with contextlib.ExitStack() as idle:
        for _ in range(100):
            idle.enter_context(socket.create_connection(("127.0.0.1", served.port), timeout=PATIENCE_S))
        assert answers_still(served)


def test_a_message_too_long_ends_the_line(served):
    with live(served) as line:
        line.send("x" * 100_000)
        with pytest.raises(ConnectionClosed) as ended:
            read_on(line)
    assert ended.value.rcvd.code == 1009


def test_a_line_from_elsewhere_is_refused(served):
    with pytest.raises(InvalidStatus), connect(f"ws://127.0.0.1:{served.port}/live", origin="http://evil.example"):
        pass


def test_a_page_that_reads_nothing_holds_up_nobody(served):
    with live(served, max_size=None) as stalled, live(served, max_size=None) as other:
        stalled.recv(PATIENCE_S)
        frames = 0
        while frames < 10:
            message = other.recv(PATIENCE_S)
            if isinstance(message, bytes):
                frames += 1
                other.send(json.dumps({"seen": frames}))


def test_a_server_stops_with_pages_open(served):
    with live(served, max_size=None) as line:
        line.recv(PATIENCE_S)
        served.server.close(PATIENCE_S)
        assert not any(t.name == "bowlsight-page-server" for t in threading.enumerate())
        with pytest.raises(ConnectionClosed):
            read_on(line)


def test_a_server_that_cannot_start_says_so():
    async def broken(scope, receive, send):
        raise RuntimeError("no")

    with pytest.raises(ConfigError, match="did not start"):
        WebServer(broken, bind("127.0.0.1", None)).start()


def test_a_port_that_is_taken_is_refused_by_its_name():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(ConfigError, match=r"\[console\] port = "):
            bind("127.0.0.1", other.getsockname()[1])


def test_addresses_are_given_that_browsers_can_use():
    assert reachable("127.0.0.1") == "127.0.0.1"
    assert reachable("0.0.0.0").count(".") == 3


@pytest.mark.skipif(not socket.has_ipv6, reason="no IPv6 here")
def test_the_newer_protocol_is_served_too():
    try:
        listening = bind("::1", None)
    except ConfigError as error:
        pytest.skip(str(error))
    with listening:
        assert listening.family is socket.AF_INET6
