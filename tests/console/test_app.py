import json
import struct

import numpy as np
import pytest
from starlette.websockets import WebSocketDisconnect

from service.console.commands import COMMANDS
from service.console.message import MARK
from service.console.page_socket import MESSAGES_BURST
from service.console.watched import SourceStatus
from tests.fakes.drawn import made_up
from tests.fakes.station import TOKENS, FakeStation

LIVE = "ws://127.0.0.1:8420/live"


def unpack(message):
    length = struct.unpack("<I", message[:4])[0]
    head = json.loads(message[4 : 4 + length])
    marks = np.frombuffer(message, MARK, head["tubes"], 4 + length)
    return head, marks, message[4 + length + marks.nbytes :]


def receive(socket):
    message = socket.receive()
    if message["type"] == "websocket.close":
        raise WebSocketDisconnect(message["code"], message.get("reason", ""))
    return message


def next_text(socket, kind):
    """The next text message of a kind; what comes before it is passed over."""
    while True:
        message = receive(socket)
        if message.get("text") and json.loads(message["text"])["type"] == kind:
            return json.loads(message["text"])


def next_frame(socket):
    while True:
        message = receive(socket)
        if message.get("bytes"):
            return unpack(message["bytes"])


# -- what is served ----------------------------------------------------------------------------------------------------


def test_the_page_and_all_that_it_names_are_served_and_nothing_of_it_comes_from_elsewhere(serve):
    client = serve()
    page = client.get("/")
    assert page.status_code == 200
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    for name in ("page.css", "icon.svg", "main.js", "link.js", "picture.js", "dials.js", "readouts.js", "alarms.js"):
        assert client.get(f"/page/{name}").status_code == 200, name
        assert "https://" not in client.get(f"/page/{name}").text
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert page.headers["x-content-type-options"] == "nosniff"
    assert page.headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    "path", ["/page/../app.py", "/page/..%2fapp.py", "/page/%2e%2e/%2e%2e/app.py", "/page//etc/passwd", "/page/", "/x"]
)
def test_nothing_else_is(serve, path):
    assert serve().get(path).status_code == 404


# -- one page ----------------------------------------------------------------------------------------------------------


def test_a_page_gets_the_picture_with_the_marks_of_the_same_frame(serve):
    client = serve()
    with client.websocket_connect(LIVE) as socket:
        hello = next_text(socket, "hello")
        assert (hello["kind"], hello["may_control"], hello["bands"]) == ("LIVE", True, None)
        frame, result = made_up(7)
        client.station.show(frame, result)
        head, marks, jpeg = next_frame(socket)
    assert head["sequence"] == 7
    assert head["size_px"] == [160, 120]
    assert jpeg[:2] == b"\xff\xd8"
    tubes = result.measurement.tubes
    assert np.abs(marks["place_8px"][:, :2] / 8 - tubes.center_px).max() < 0.1
    assert marks["row"].tolist() == tubes.row.tolist()
    assert marks["kind"].tolist() == [0, 0, 0, 0, 1, 1, 2, 3]


def test_a_page_that_is_slow_gets_the_newest_and_never_what_it_missed(serve):
    client = serve()
    with client.websocket_connect(LIVE) as socket:
        next_text(socket, "hello")
        client.station.show(*made_up(0))
        got = [next_frame(socket)[0]["sequence"]]
        for i in range(1, 9):  # what comes now must wait for a receipt
            client.station.show(*made_up(i))
        socket.send_json({"seen": 1})
        got.append(next_frame(socket)[0]["sequence"])
    assert got == [0, 8]


def test_a_page_that_opens_late_gets_the_last_frame_and_the_last_minute(serve):
    client = serve()
    for i in range(5):
        client.station.show(*made_up(i * 5))
    with client.websocket_connect(LIVE) as socket:
        hello = next_text(socket, "hello")
        assert [point[5] for point in hello["trend"]] == pytest.approx([400.0, 400.5, 401.0, 401.5, 402.0])
        assert next_frame(socket)[0]["sequence"] == 20


def test_a_page_can_set_its_clock(serve):
    client = serve()
    with client.websocket_connect(LIVE) as socket:
        socket.send_json({"ping": 12.5})
        pong = next_text(socket, "pong")
    assert pong == {"type": "pong", "ping": 12.5, "now_ms": client.station.clock.now_ns / 1e6}


def test_the_state_tells_of_the_source_and_of_alarms(serve):
    station = FakeStation()
    station.watched.shown = SourceStatus("FROZEN", "the same byte for byte", since_ns=500_000_000)
    client = serve(station)
    with client.websocket_connect(LIVE) as socket:
        state = next_text(socket, "state")
    assert (state["liveness"], state["since_ms"]) == ("FROZEN", 500.0)
    [alarm] = state["alarms"]
    assert alarm["reason"] == "FROZEN: the same byte for byte"
    assert (alarm["active"], alarm["acknowledged"]) == (True, False)
    assert state["first_out"]["key"] == alarm["key"]
    assert "alarm: FROZEN: the same byte for byte" in station.told


# -- hostile pages -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:8420", "http://127.0.0.1:80", None]
)
def test_a_page_of_another_origin_gets_no_line_and_no_command(serve, origin):
    client = serve(origin=origin)
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE):
        pass
    assert client.post("/api/recording", json={"on": True}).status_code == 403
    assert client.station.recorder.state.folder is None


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8420", "127.0.0.1:1", "0.0.0.0:8420", "", "a b", "127.0.0.1:x"]
)
def test_another_name_for_this_address_is_refused(serve, host):
    client = serve(host=host, origin=f"http://{host}")
    assert client.get("/").status_code == 421
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE):
        pass


@pytest.mark.parametrize("host", ["localhost:8420", "127.0.0.1:8420", "[::1]:8420", "station7.plant:8420", "127.0.0.1"])
def test_its_own_names_are_not(serve, host):
    client = serve(FakeStation(names=("station7.plant",)), host=host, origin=f"http://{host}")
    assert client.get("/").status_code == 200
    assert client.post("/api/acknowledge", json={}).status_code == 200


@pytest.mark.parametrize(
    "message",
    ["", "x", "[]", "{}", '{"seen": 99}', '{"seen": -1}', '{"ping": "now"}', '{"ping": 1, "x": ' + "1" * 500 + "}"],
)
def test_a_page_that_sends_nonsense_is_sent_away(serve, message):
    with serve().websocket_connect(LIVE) as socket:
        socket.send_text(message)
        with pytest.raises(WebSocketDisconnect) as ended:
            next_frame(socket)
    assert ended.value.code == 1007


def test_a_page_that_sends_bytes_is_sent_away(serve):
    with serve().websocket_connect(LIVE) as socket:
        socket.send_bytes(b"{}")
        with pytest.raises(WebSocketDisconnect):
            next_frame(socket)


def test_a_page_that_floods_is_sent_away_and_others_are_not(serve):
    client = serve()
    with client.websocket_connect(LIVE) as other:
        with client.websocket_connect(LIVE) as socket:
            for _ in range(int(MESSAGES_BURST) + 60):
                socket.send_json({"seen": 0})
            with pytest.raises(WebSocketDisconnect) as ended:
                next_frame(socket)
        assert ended.value.code == 1008
        client.station.show(*made_up(3))
        assert next_frame(other)[0]["sequence"] == 3


def test_no_more_pages_are_open_than_may_be(serve):
    client = serve(FakeStation(clients=1))
    with client.websocket_connect(LIVE) as one:
        next_text(one, "hello")
        with client.websocket_connect(LIVE) as two, pytest.raises(WebSocketDisconnect) as ended:
            next_frame(two)
        assert ended.value.code == 1013
    with client.websocket_connect(LIVE) as again:
        assert next_text(again, "hello")["kind"] == "LIVE"


def test_a_flood_of_requests_is_slowed_down(serve):
    client = serve()
    statuses = [client.get("/page/nothing").status_code for _ in range(300)]
    assert statuses[0] == 404
    assert 429 in statuses


# -- commands ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b'{"tube": "1,1"}', 200),
        (b'{"tube": "1,1", "operator": "M\xc3\xbcller", "generation": 1}', 200),
        (b'{"tube": "1,1", "generation": null}', 200),
        (b'{"tube": "1,1", "generation": 7}', 409),
        (b'{"tube": "L83R87"}', 409),
        (b'{"tube": ""}', 400),
        (b'{"tube": 1}', 400),
        (b'{"tube": "a\\nb"}', 400),
        (b'{"tube": "\\ud800"}', 400),
        (b'{"tube": "1,1", "generation": true}', 400),
        (b'{"tube": "1,1", "generation": 1.5}', 400),
        (b'{"tube": "1,1", "extra": 1}', 400),
        (b"{}", 400),
        (b"[]", 400),
        (b"null", 400),
        (b"", 400),
        (b"[" * 4000, 400),
        (b'{"tube": "' + b"x" * 5000 + b'"}', 413),
        (b'{"tube": "1,1", "generation": ' + b"9" * 4000 + b"}", 400),
    ],
)
def test_arguments_are_checked(serve, body, status):
    client = serve()
    client.station.show(*made_up(0))
    answer = client.post("/api/target", content=body, headers={"content-type": "application/json"})
    assert answer.status_code == status, answer.text
    assert status == 200 or set(answer.json()) == {"error"}


def test_a_body_that_is_not_json_is_refused_before_it_is_read(serve):
    client = serve()
    for kind in ("text/plain", "application/x-www-form-urlencoded", ""):
        answer = client.post("/api/target", content=b'{"tube": "nearest"}', headers={"content-type": kind})
        assert answer.status_code == 415


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_are_only_for_posts(serve, name):
    client = serve()
    assert client.get(f"/api/{name}").status_code == 405
    assert client.put(f"/api/{name}", json={}).status_code == 405


def test_recording_marks_and_verifications_reach_the_recorder(serve):
    client = serve()
    refused = client.post("/api/mark", json={"text": "acquisition"})
    assert refused.status_code == 409
    assert "start recording first" in refused.json()["error"]
    assert client.post("/api/recording", json={"on": True}).json()["folder"] == "/sessions/one"
    assert client.post("/api/recording", json={"on": True}).status_code == 409
    assert client.post("/api/mark", json={"text": "acquisition", "operator": "A"}).json()["number"] == 0
    said = client.post("/api/verify", json={"claim": "row 3 col 5", "operator": "A", "reason": "drawing 7"}).json()
    assert (said["agrees"], said["tube_seen"]) == (False, "ROW3 COL4")
    assert "secret" not in said
    assert client.station.recorder.asked == [("mark", "acquisition", "A"), ("verify", "row 3 col 5", "A", "drawing 7")]
    assert client.post("/api/verify", json={"claim": "nonsense"}).status_code == 409
    assert client.post("/api/recording", json={"on": False}).json()["folder"] is None


def test_an_answer_tells_from_when_on_pictures_show_what_was_done(serve):
    client = serve()
    client.station.clock.advance(1.5)
    answer = client.post("/api/target", json={"tube": "nearest"}).json()
    assert answer == {"target": "nearest", "now_ms": client.station.clock.now_ns / 1e6}


def test_without_a_recorder_that_is_said(serve):
    client = serve(FakeStation(recorder=False))
    assert "[recording]" in client.post("/api/recording", json={"on": True}).json()["error"]


def test_inputs_are_switched_and_refusals_are_told(serve):
    client = serve()
    assert client.post("/api/input", json={"name": "CH1"}).status_code == 200
    assert client.post("/api/input", json={"name": "CH2"}).json() == {"error": "CH2: the device does not answer"}
    assert "there is CH1, CH2" in client.post("/api/input", json={"name": "CH9"}).json()["error"]


# -- rights ------------------------------------------------------------------------------------------------------------


def network_station():
    return FakeStation(tokens=TOKENS, address="0.0.0.0")


def test_without_a_token_a_page_of_the_network_gets_nothing(serve):
    client = serve(network_station())
    assert client.get("/").status_code == 200  # the page itself holds nothing of the station
    assert client.get("/api/state").status_code == 401
    assert client.post("/api/target", json={"tube": "nearest"}).status_code == 401
    with client.websocket_connect(LIVE) as socket, pytest.raises(WebSocketDisconnect) as ended:
        socket.receive_json()
    assert ended.value.reason == "token"


@pytest.mark.parametrize("token", ["wrong", "", "view-token ", "control-toke", "\u00e9"])
def test_a_wrong_token_opens_nothing(serve, token):
    client = serve(network_station())
    assert client.post("/api/login", json={"token": token}).status_code == 401
    assert not client.cookies
    assert client.get("/api/state", headers={"authorization": "Bearer x"}).status_code == 401


@pytest.mark.parametrize("body", [{}, {"token": 1}, {"token": None}, {"token": "x" * 300}, {"token": "a", "b": 1}, []])
def test_a_login_that_is_none_is_refused(serve, body):
    assert serve(network_station()).post("/api/login", json=body).status_code == 400


def test_guessing_is_slowed_down(serve):
    client = serve(network_station())
    assert 429 in [client.post("/api/login", json={"token": "guess"}).status_code for _ in range(15)]


def test_the_token_to_watch_does_not_operate(serve):
    client = serve(network_station())
    answer = client.post("/api/login", json={"token": "view-token"})
    assert answer.json() == {"may_control": False}
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert client.get("/api/state").status_code == 200
    for name in COMMANDS:
        assert client.post(f"/api/{name}", json={}).status_code == 403
    with client.websocket_connect(LIVE) as socket:
        assert next_text(socket, "hello")["may_control"] is False


def test_the_token_to_operate_does_both(serve):
    client = serve(network_station())
    assert client.post("/api/login", json={"token": "control-token"}).json() == {"may_control": True}
    assert client.post("/api/target", json={"tube": "nearest"}).status_code == 200
    with client.websocket_connect(LIVE) as socket:
        assert next_text(socket, "hello")["may_control"] is True


def test_programs_give_the_token_in_a_header(serve):
    client = serve(network_station(), authorization="Bearer control-token")
    assert client.post("/api/target", json={"tube": "nearest"}).status_code == 200


def test_on_another_address_there_are_always_tokens():
    with pytest.raises(ValueError, match="needs tokens"):
        FakeStation(address="0.0.0.0")
