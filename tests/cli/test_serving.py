"""The operator's page as commands serve it."""

import socket
import urllib.request
from types import SimpleNamespace

import pytest

from service.acquisition.liveness import Liveness, Shown
from service.cli import main
from service.cli.serving import Served
from service.console.watched import RefusedError
from tests.fakes.results import make_measurement
from tests.fakes.scripted import PATIENCE_S


class FakeService:
    inputs, input, latest = ("CH1", "CH2"), "CH1", None

    def __init__(self, shown):
        self._shown = shown

    def health(self):
        account = SimpleNamespace(dropped=3, corrupt=1, failed=2)
        return SimpleNamespace(shown=self._shown, account=account, capture_fps=25.0, result_fps=24.0)

    def select_input(self, name):
        raise ValueError(f"camera has no input {name!r}; it offers CH1, CH2")


@pytest.mark.parametrize(
    ("liveness", "word"),
    [
        (Liveness.LIVE, "LIVE"),
        (Liveness.REPLAY, "LIVE"),
        (Liveness.SIMULATED, "LIVE"),
        (Liveness.FROZEN, "FROZEN"),
        (Liveness.NO_SIGNAL, "NO SIGNAL"),
        (Liveness.RECONNECTING, "RECONNECTING"),
    ],
)
def test_the_source_is_shown_as_the_service_sees_it(liveness, word):
    served = Served()
    assert served.status().liveness == "STARTING"
    served.attach(FakeService(Shown(liveness, "why", 7)))
    status = served.status()
    assert (status.liveness, status.reason, status.since_ns) == (word, "why", 7)
    assert (status.dropped, status.bad, status.inputs, status.input) == (3, 3, ("CH1", "CH2"), "CH1")


def test_an_input_that_cannot_be_is_refused_in_words():
    served = Served()
    with pytest.raises(RefusedError, match="not open yet"):
        served.select_input("CH2")
    served.attach(FakeService(Shown(Liveness.LIVE)))
    with pytest.raises(RefusedError, match="it offers CH1, CH2"):
        served.select_input("CH9")


def test_the_page_is_served_while_the_command_runs_and_its_address_printed(vision, video, capsys):
    said, pages = [], []

    def look():
        """Open the page in the midst of the first picture; the recording ends after it."""
        if not said:
            said.append(capsys.readouterr().out)
            address = said[0].partition("operator's page: ")[2].split()[0]
            with urllib.request.urlopen(address, timeout=PATIENCE_S) as page:
                pages.append((address, page.read()))
        return [make_measurement()]

    vision.answer = look
    assert main(["replay", str(video()), "--speed", "max", "--no-viewer"]) == 0
    [(address, page)] = pages
    assert b"Bowlsight" in page
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(address, timeout=PATIENCE_S)


def test_a_port_that_is_taken_is_refused_before_anything_runs(vision, video, capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        assert main(["replay", str(video()), "--no-viewer", "--console-port", port]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines()[-1].startswith(f"bowlsight: [console] port = {port} at 127.0.0.1: ")


def test_a_station_may_have_no_page(vision, video, tmp_path, capsys):
    station = tmp_path / "s.toml"
    station.write_text('[source]\ndevice = "simulated"\n[generator]\nname = "candu6"\n[console]\nenabled = false\n')
    assert main(["replay", str(video()), "--speed", "max", "--no-viewer", "--config", str(station)]) == 0
    assert "operator's page" not in capsys.readouterr().out
