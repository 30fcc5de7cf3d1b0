import socket

import pytest

from service.cli import main, viewing
from service.cli.parser import parse
from service.cli.viewing import Viewing, make_viewing
from service.config.generators import load_generator
from service.config.station import ViewerSettings
from service.sinks import viewer


@pytest.fixture
def make(monkeypatch):
    """Make the viewing of `bowlsight demo` with some options; gives it and what the live sink was made with."""
    made = {}
    monkeypatch.setattr(viewer, "ViewerSink", lambda watch, **options: made.update(watch=watch, **options) or "live")

    def run(*options, kind="REPLAY", **settings):
        args = parse(["demo", *map(str, options)])
        return make_viewing(args, ViewerSettings(**settings), load_generator("candu6"), kind, "bowl.mp4"), made

    return run


def test_none_is_made_where_none_is_asked_for(make):
    assert make("--no-viewer") == (Viewing(), {})
    assert make(enabled=False) == (Viewing(), {})


def test_a_recording_can_be_had_without_a_viewer(make, tmp_path):
    shown, made = make("--no-viewer", "--save", tmp_path / "a.rrd")
    assert [sink.name for sink in shown.sinks] == ["viewer file"]
    assert (shown.live, made) == (None, {})
    assert not (tmp_path / "a.rrd").exists()


def test_a_taken_port_costs_no_recording_that_is_there(vision, capsys, tmp_path):
    kept = tmp_path / "a.rrd"
    kept.write_bytes(b"precious")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["demo", "--no-console", "--port", str(port), "--save", str(kept)]) == 2
    assert f"viewer port = {port} at 127.0.0.1: Address already in use" in capsys.readouterr().err
    assert kept.read_bytes() == b"precious"


def test_options_overrule_the_station(make):
    _, made = make("--port", 1234, port=1, web_port=2, memory_mib=64)
    assert (made["address"], made["port"], made["web_port"]) == ("127.0.0.1", 1234, 2)
    assert made["memory_limit"] == "64MiB"


def test_the_title_says_what_is_not_live_and_claims_nothing_of_what_may_be(make):
    _, made = make()
    assert made["watch"].title.startswith("REPLAY bowl.mp4")
    assert made["watch"].epoch_ns is None
    _, made = make(kind="LIVE")
    assert made["watch"].title.startswith("bowl.mp4")
    assert made["watch"].epoch_ns > 0


@pytest.mark.parametrize("asked", ["--open", None])
@pytest.mark.parametrize("display", [":0", None])
def test_a_browser_is_opened_only_when_asked_and_never_in_the_terminal(make, monkeypatch, capsys, asked, display):
    class Live:
        url, native_command = "http://127.0.0.1:9090/", "rerun somewhere"

    opened = []
    monkeypatch.setattr(viewing.webbrowser, "open", lambda url: not opened.append(url))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if display:
        monkeypatch.setenv("DISPLAY", display)
    shown, _ = make(*[asked] if asked else [])
    Viewing((), Live(), shown.opens).announce()
    out, err = capsys.readouterr()
    assert "viewer: http://127.0.0.1:9090/" in out
    assert opened == [Live.url] * bool(asked and display)
    assert ("no browser can be opened" in err) is bool(asked and not display)


def test_the_live_service_serves_and_records(vision, video, capsys, tmp_path):
    assert main(["replay", str(video()), "--speed", "max", "--no-console", "--save", str(tmp_path / "a.rrd")]) == 0
    out = capsys.readouterr().out
    assert out.startswith("viewer: http://127.0.0.1:")
    assert "\n  viewer file  " in out
    assert "\n  viewer  " in out
    assert (tmp_path / "a.rrd").stat().st_size > 10_000
