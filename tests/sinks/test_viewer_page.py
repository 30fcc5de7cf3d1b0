import gzip
import socket
import urllib.error
import urllib.request

import pytest

from service.sinks import viewer_page
from service.sinks.ports import free_port
from service.sinks.viewer_page import ViewerPage, rerun_program

GRPC = "rerun+http://127.0.0.1:9876/proxy"
LONG_S = 30.0


@pytest.fixture
def page():
    page = ViewerPage("127.0.0.1", free_port("127.0.0.1", None, 19090, "port"), GRPC)
    page.start()
    yield page
    page.close()


def get(page, path, **headers):
    request = urllib.request.Request(page.url.rstrip("/") + path, headers=headers)
    return urllib.request.urlopen(request, timeout=LONG_S)


def test_the_page_comes_from_rerun_and_may_speak_to_nobody_else(page):
    with get(page, "/") as answer:  # leads on to the data
        assert answer.url.startswith(page.url + "?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy&")
        assert b"re_viewer.js" in answer.read()
        policy = dict(part.split(" ", 1) for part in answer.headers["Content-Security-Policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["connect-src"] == "'self' http://127.0.0.1:9876 data: blob:"
    assert not any("//" in value for key, value in policy.items() if key != "connect-src")


def test_the_program_is_sent_packed_and_whole(page):
    with get(page, "/re_viewer_bg.wasm", **{"Accept-Encoding": "gzip"}) as answer:
        content = gzip.decompress(answer.read())
        assert answer.headers["Content-Type"] == "application/wasm"
        assert answer.headers["Content-Encoding"] == "gzip"
        assert int(answer.headers["rerun-final-length"]) == len(content)
    assert content[:4] == b"\0asm"
    with get(page, "/favicon.ico") as plain:
        assert "Content-Encoding" not in plain.headers
        assert len(plain.read()) == int(plain.headers["Content-Length"])


@pytest.mark.parametrize("path", ["/etc/passwd", "/../../etc/passwd", "/index.html", "//re_viewer.jsx"])
def test_nothing_else_is_served(page, path):
    with pytest.raises(urllib.error.HTTPError, match="404"):
        get(page, path)


def test_a_page_that_cannot_be_had_is_said_in_the_browser_and_tried_again(page, monkeypatch, tmp_path, caplog):
    monkeypatch.setattr(viewer_page, "rerun_program", lambda: tmp_path / "gone")
    for _ in range(2):
        with pytest.raises(urllib.error.HTTPError, match="502"):
            get(page, "/?x")
    assert str(tmp_path / "gone") in caplog.text
    monkeypatch.setattr(viewer_page, "rerun_program", rerun_program)
    with get(page, "/?x") as answer:
        assert answer.status == 200


def test_a_browser_that_says_nothing_or_breaks_off_holds_nothing_up(page, capfd):
    address = ("127.0.0.1", int(page.url.rsplit(":", 1)[1].rstrip("/")))
    with socket.create_connection(address), socket.create_connection(address) as other:
        other.sendall(b"GET /re_viewer_bg.wasm HTTP/1.0\r\n\r\n")
        other.close()
        with get(page, "/?x") as answer:
            assert answer.status == 200
        page.close()
    assert "Traceback" not in capfd.readouterr().err


def test_closing_frees_the_port_and_may_be_repeated(page):
    page.close()
    page.close()
    port = int(page.url.rsplit(":", 1)[1].rstrip("/"))
    assert free_port("127.0.0.1", port, port, "port") == port
