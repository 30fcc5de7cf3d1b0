import os
import signal
import threading

import pytest

from drivers.errors import DeviceDisconnectedError
from service.cli import live, main
from service.cli import replay as replay_command
from service.vision.measurement import Lock
from tests.fakes.results import make_measurement
from tests.fakes.scripted import ScriptedGrabber


@pytest.fixture
def replay(vision, capsys):
    def run(*arguments):
        status = main(["replay", *map(str, arguments), "--no-viewer", "--no-console"])
        out, err = capsys.readouterr()
        return status, out, err

    return run


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    return [make_measurement()]


def test_at_full_speed_every_frame_is_measured(replay, video):
    status, out, _ = replay(video(frames=30), "--speed", "max", "--generator", "system80")
    assert status == 0
    assert "ended after" in out
    assert "30 delivered = 30 processed + 0 superseded" in out
    assert "every frame accounted for" in out
    assert "30 full, 0 partial, 0 none of 30 pictures" in out


def test_the_generator_and_the_camera_are_the_stations_unless_given(replay, vision, video, tmp_path):
    (tmp_path / "c.toml").write_text("image_size_px = [64, 48]\npixel_pitch_mm = [0.004, 0.004]\n")
    (tmp_path / "s.toml").write_text(
        '[source]\ndevice = "simulated"\n[generator]\nname = "candu6"\n[camera]\nfile = "c.toml"\n'
        '[measuring]\nfield_order = "bottom"\n'
    )
    path = video(frames=2)
    replay(path, "--speed", "max", "--config", tmp_path / "s.toml")
    assert vision.made[-1].lattice.pitch_mm == pytest.approx(24.13)
    assert vision.made[-1].camera.pixel_pitch_mm == (0.004, 0.004)
    assert {call[2] for call in vision.made[-1].calls} == {"interlaced-bottom-first"}
    replay(path, "--speed", "max", "--generator", "51b", "--field-order", "progressive")
    assert vision.made[-1].lattice.pitch_mm == pytest.approx(32.512)
    assert {call[2] for call in vision.made[-1].calls} == {"progressive"}


def test_ctrl_c_is_how_a_live_command_is_done(replay, vision, video):
    vision.answer = interrupt
    status, out, err = replay(video(), "--loop")
    assert status == 0
    assert "stopped after" in out
    assert "every frame accounted for" in out
    assert "interrupted" not in err


def test_it_stops_after_the_seconds_asked_for(replay, video):
    status, out, _ = replay(video(), "--loop", "--seconds", "0.3")
    assert status == 0
    assert out.startswith("REPLAY")
    assert float(out.partition("time is up after ")[2].split()[0]) >= 0.3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none.mp4"], "none.mp4: cannot be opened"),
        (["VIDEO", "--generator", "none"], "steam generator 'none': unknown"),
        (["VIDEO", "--config", "none.toml"], "none.toml: no such file"),
        (["VIDEO", "--camera", "none.toml"], "none.toml: no such file"),
    ],
)
def test_what_cannot_start_is_refused_in_one_line(replay, video, arguments, words):
    status, out, err = replay(*(str(video()) if a == "VIDEO" else a for a in arguments))
    assert (status, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


def test_a_camera_of_another_size_is_refused_before_it_streams(replay, video, tmp_path):
    (tmp_path / "c.toml").write_text("image_size_px = [640, 480]\npixel_pitch_mm = [0.004, 0.004]\n")
    status, out, err = replay(video(), "--camera", tmp_path / "c.toml")
    assert (status, out) == (2, "")
    assert "64x48 px" in err
    assert "[640, 480]" in err


def test_a_source_that_breaks_off_is_a_problem_after_its_summary(replay, monkeypatch):
    broken = ScriptedGrabber([0, 1, DeviceDisconnectedError("bowl.mp4", "cannot be read on: torn")])
    monkeypatch.setattr(replay_command, "ReplayGrabber", lambda *_, **__: broken)
    status, out, err = replay("bowl.mp4", "--speed", "max")
    assert status == 1
    assert "broke off after" in out
    assert "2 delivered = 2 processed" in out
    assert err.endswith("bowlsight: bowl.mp4: cannot be read on: torn\n")


def test_a_measurer_that_hangs_is_left_behind_and_told(replay, vision, video, monkeypatch):
    release = threading.Event()

    def answer():
        os.kill(os.getpid(), signal.SIGINT)
        release.wait(30)
        return [make_measurement()]

    monkeypatch.setattr(live, "STOP_S", 0.6)
    vision.answer = answer
    status, out, err = replay(video())
    release.set()
    assert status == 1
    assert "the measuring thread did not stop in time" in err
    assert "1 in flight" in out or "2 in flight" in out


def test_measuring_that_fails_is_counted_and_the_watch_goes_on(replay, vision, video):
    def answer():
        raise ZeroDivisionError("oops")

    vision.answer = answer
    status, out, err = replay(video(frames=5), "--speed", "max")
    assert status == 0
    assert "0 corrupt + 5 failed" in out
    assert err.count("could not be measured") == 1


def test_run_grabs_what_the_station_says_from_any_folder(vision, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    station = tmp_path / "s.toml"
    station.write_text(
        '[source]\ndevice = "simulated?size=64x48&loop_frames=2&pitch_px=12"\ninput = "CH2"\nlock = ["auto_focus"]\n'
        '[source.controls]\nbrightness = 300\n[generator]\nname = "model-f"\n'
    )
    vision.answer = lambda: [make_measurement(Lock.PARTIAL)]
    assert main(["run", "--config", str(station), "--seconds", "0.5", "--no-viewer", "--no-console"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("SIMULATED")
    assert "asked for brightness = 300, the device took 255" in err
    assert vision.made[0].camera.complete


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('input = "CH2"', 'input = "S-Video"', "has no input S-Video; it offers CH1, CH2, CH3, CH4"),
        ("brightness", "brigthness", "has no control brigthness"),
        ('"simulated?size=64x48', '"simulated?sise=64x48', "unknown key 'sise'; did you mean size?"),
        ('"simulated?size=64x48&loop_frames=2&pitch_px=12"', '"none.mp4"', "none.mp4: cannot be opened"),
        ("[generator]", "[viewer]\nprot = 1\n[generator]", "viewer.prot = 1: unknown key; did you mean port?"),
    ],
)
def test_a_station_that_asks_for_what_there_is_not_is_refused(vision, capsys, tmp_path, old, new, words):
    station = tmp_path / "s.toml"
    text = (
        '[source]\ndevice = "simulated?size=64x48&loop_frames=2&pitch_px=12"\ninput = "CH2"\n'
        '[source.controls]\nbrightness = 128\n[generator]\nname = "model-f"\n'
    )
    station.write_text(text.replace(old, new))
    assert main(["run", "--config", str(station), "--no-viewer", "--no-console"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert words in err
    assert err.count("\n") == 1


def test_the_demonstration_plays_the_bundled_video(vision, capsys):
    assert main(["demo", "--seconds", "0.5", "--no-viewer", "--no-console"]) == 0
    assert vision.made[0].camera.image_size_px == (640, 480)
    assert vision.made[0].camera.complete
    assert "every frame accounted for" in capsys.readouterr().out
