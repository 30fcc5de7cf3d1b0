"""Without the operator's page there are alarms all the same: in the session's events, and in the terminal."""

from drivers.faults import Fault, FaultKind
from drivers.opening import open_grabber
from drivers.simulated import SimulatedGrabber
from service.cli import main
from service.cli import run as run_command
from service.report.alarms import recorded_alarms
from service.sinks.session.reader import open_session

STATION = """
[source]
device = "simulated"
[generator]
name = "model-f"
[recording]
keep_free_mib = 0
viewer = false
"""


def run(folder, seconds):
    (folder / "s.toml").write_text(STATION)
    options = ["--record", str(folder / "sessions"), "--no-viewer", "--no-console", "--seconds", str(seconds)]
    return main(["run", "--config", str(folder / "s.toml"), *options])


def test_a_picture_that_freezes_is_an_alarm_with_nobody_at_the_page(vision, monkeypatch, tmp_path, capsys):
    scene = open_grabber("simulated:model-f?size=64x48&loop_frames=4").scene
    faults = [Fault(FaultKind.FREEZE, 30, frames=30)]
    monkeypatch.setattr(run_command, "_grabber", lambda s: SimulatedGrabber(scene, loop_frames=4, faults=faults))
    assert run(tmp_path, 6) == 0
    out, err = capsys.readouterr()
    assert "operator's page" not in out
    assert "bowlsight: alarm: FROZEN" in err
    assert "stop moving: the picture is not live" in err
    (folder,) = (tmp_path / "sessions").iterdir()
    (alarm,) = recorded_alarms(open_session(folder).events())
    assert (alarm.key, alarm.first, alarm.acknowledged_utc) == ("source frozen", True, None)
    assert alarm.raised_utc < alarm.cleared_utc


def test_a_source_that_fails_for_good_is_an_alarm_of_the_session_that_it_ends(vision, monkeypatch, tmp_path, capsys):
    scene = open_grabber("simulated:model-f?size=64x48&loop_frames=4").scene
    faults = [Fault(FaultKind.DISCONNECT, 20, seconds=60.0)]
    grabber = SimulatedGrabber(scene, loop_frames=4, faults=faults)
    monkeypatch.setattr(run_command, "_grabber", lambda s: grabber)
    monkeypatch.setattr(run_command, "_supervision", lambda s: None)
    assert run(tmp_path, 20) == 1
    (folder,) = (tmp_path / "sessions").iterdir()
    assert "source ended" in [alarm.key for alarm in recorded_alarms(open_session(folder).events())]
