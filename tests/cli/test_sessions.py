"""Sessions at the command line: recorded, replayed, checked; with vision that answers without looking."""

import itertools
import json
import os
import signal

import pytest

from drivers.session_index import INDEX, Row, read_index
from service.cli import main
from service.cli import recording as recording_command
from service.sinks.session.control import RecordingError
from service.sinks.session.reader import SessionEnd, open_session
from tests.fakes.results import make_measurement


@pytest.fixture
def bowlsight(vision, monkeypatch, capsys):
    monkeypatch.setattr("service.cli.again.Measurer", vision)

    def run(*arguments):
        status = main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture
def station(tmp_path):
    """Write a station file that records no viewer, which takes longer to start than all else."""
    path = tmp_path / "s.toml"
    path.write_text(
        '[source]\ndevice = "simulated?size=64x48&loop_frames=2&pitch_px=12"\n[generator]\nname = "model-f"\n'
        '[identity]\nrows_grow = "up"\ncolumns_grow = "right"\n'
        "[recording]\nviewer = false\nkeep_free_mib = 0\n"
    )
    return path


@pytest.fixture
def recorded(bowlsight, video, station, tmp_path):
    def record(*more, frames=10):
        root = tmp_path / "sessions"
        status, out, _ = bowlsight(
            "replay",
            video(frames=frames),
            "--config",
            station,
            "--speed",
            "max",
            "--no-viewer",
            "--record",
            root,
            *more,
        )
        assert status == 0
        folder = max(root.iterdir())
        assert f"{frames} frames, {frames} measured: {folder}" in out
        return folder

    return record


def counting():
    """Answers that differ from frame to frame, as results do; begin again for each measurer."""
    counts = itertools.count(1)
    return lambda: [make_measurement(distance_mm=1000.0 + next(counts))]


def test_a_session_is_whole_and_says_what_it_is(recorded, bowlsight):
    folder = recorded("--csv", "--operator", "A. Smith", "--anchor", "3,-2=ROW12 COL34")
    session = open_session(folder)
    assert (session.about.what, session.about.operator, session.about.from_start) == ("REPLAY", "A. Smith", True)
    assert session.about.anchors == ("3,-2=ROW12 COL34",)
    assert session.counts().end is SessionEnd.CLOSED
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert {"session.toml", INDEX, "results.jsonl", "results.csv", "events.jsonl", "video/000000.mkv"} <= names
    assert "config/station.toml" in names
    assert session.about.software["bowlsight"]


def test_a_session_measured_again_is_the_same(recorded, bowlsight, vision):
    vision.answer = counting()
    folder = recorded()
    vision.answer = counting()
    status, out, _ = bowlsight("replay", folder, "--check")
    assert (status, out.splitlines()[1]) == (
        0, "  recorded     10 frames equal to the last bit (elapsed_ms is not compared)"
    )  # fmt: skip
    assert vision.made[-1].lattice.pitch_mm == vision.made[0].lattice.pitch_mm


def test_a_session_that_comes_out_otherwise_is_a_problem_that_is_named(recorded, bowlsight, vision):
    vision.answer = counting()
    folder = recorded()
    answers = counting()
    vision.answer = lambda: [make_measurement(distance_mm=1010.0)]
    answers()
    status, out, _ = bowlsight("replay", folder, "--check")
    assert status == 1
    assert "1 frames equal to the last bit, 9 differ" in out
    assert "first: frame 0: pose.translation_mm[2] was" in out or "first: frame 0: pose" in out
    assert "distance mm: apart by 5 (median), 9 (most)" in out


def test_with_another_configuration_the_differences_are_shown(recorded, bowlsight, vision):
    vision.answer = counting()
    folder = recorded()
    vision.answer = counting()
    status, out, _ = bowlsight("replay", folder, "--generator", "51b", "--speed", "max", "--no-viewer")
    assert status == 0
    assert vision.made[-1].lattice.pitch_mm == pytest.approx(32.512)
    assert "10 frames equal" in out


def test_replayed_live_it_is_compared_too(recorded, bowlsight, vision):
    vision.answer = counting()
    folder = recorded()
    vision.answer = counting()
    status, out, _ = bowlsight("replay", folder, "--speed", "100", "--no-viewer")
    assert status == 0
    assert "10 delivered = 10 processed + 0 superseded" in out
    assert "10 frames equal to the last bit" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["VIDEO", "--check"], "is no recorded session, and only that can be checked"),
        (["EMPTY", "--check"], "is no recorded session"),
    ],
)
def test_what_cannot_be_checked_is_refused_in_one_line(bowlsight, video, tmp_path, arguments, words):
    (tmp_path / "empty").mkdir()
    named = {"VIDEO": video(), "EMPTY": tmp_path / "empty"}
    status, out, err = bowlsight("replay", *(named.get(a, a) for a in arguments))
    assert (status, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


def test_run_records_what_the_station_asks_for(bowlsight, vision, station, tmp_path):
    stopped = []

    def stop_once_recorded():
        rows = (item for index in (tmp_path / "here").glob(f"*/{INDEX}") for item in read_index(index))
        if not stopped and any(isinstance(item, Row) for item in rows):
            stopped.append(os.kill(os.getpid(), signal.SIGINT))
        return [make_measurement()]

    vision.answer = stop_once_recorded
    station.write_text(station.read_text() + 'enabled = true\nfolder = "here"\noperator = "B"\n')
    status, out, _ = bowlsight("run", "--config", station, "--seconds", "60", "--no-viewer")
    assert status == 0
    (folder,) = (tmp_path / "here").iterdir()
    session = open_session(folder)
    assert (session.about.what, session.about.operator) == ("SIMULATED", "B")
    assert session.about.device["size_px"] == [64, 48]
    assert session.counts().frames > 0
    assert str(folder) in out
    assert (folder / "config" / "camera").is_dir()  # the simulated camera is no file of the station's


def test_a_folder_that_cannot_be_written_is_refused_before_anything_runs(bowlsight, station, tmp_path):
    (tmp_path / "file").write_text("")
    status, out, err = bowlsight(
        "run", "--config", station, "--no-viewer", "--seconds", "1", "--record", tmp_path / "file"
    )
    assert (status, out) == (2, "")
    assert "no session can be recorded there" in err


class FakeRecorder:
    def __init__(self):
        self.asked = []
        self.state = type("State", (), {"folder": None})()

    def verify(self, claim):
        self.asked.append("verify")
        raise RecordingError("nothing is being recorded; start recording first")

    def start_recording(self):
        self.asked.append("start")
        return "somewhere"


def test_keys_ask_the_recorder_and_say_what_came_of_it(capsys):
    recorder = FakeRecorder()
    unseen = [True]
    for key in "vrxkk":
        recording_command.on_key(key, recorder, lambda: bool(unseen) and unseen.pop())
    assert recorder.asked == ["verify", "start"]
    assert capsys.readouterr().err.splitlines() == [
        "bowlsight: nothing is being recorded; start recording first",
        "bowlsight: recording into somewhere",
        "bowlsight: alarms acknowledged",
        "bowlsight: there is no alarm that was not acknowledged",
    ]


def test_without_a_recorder_there_are_keys_for_alarms_alone():
    assert "verify" in recording_command.keys_offered(FakeRecorder())
    assert recording_command.keys_offered(None) == "keys: k acknowledge the alarms"
    recording_command.on_key("v", None, lambda: pytest.fail("not asked for"))


def test_results_are_lines_of_the_documented_kind(recorded):
    session = open_session(recorded(frames=3))
    lines = (session.folder / "results.jsonl").read_text().splitlines()
    assert [json.loads(line)["schema"] for line in lines] == [1, 1, 1]


def test_verify_says_that_a_session_is_sound_and_what_is_not(recorded, bowlsight):
    folder = recorded()
    status, out, _ = bowlsight("verify", folder)
    assert (status, out) == (0, f"{folder.name}: sound: 10 frames, 10 measured, 0 evidence records\n")
    text = (folder / "results.jsonl").read_text()
    (folder / "results.jsonl").write_text(text.replace('"lock":"full"', '"lock":"none"', 1))
    status, out, _ = bowlsight("verify", folder)
    assert status == 1
    assert out.startswith("results.jsonl: the lines of frame 0, from byte 0 on, were changed\n")
    assert out.endswith(f"{folder.name}: 1 problem\n")


def test_verify_measures_again_where_asked(recorded, bowlsight, vision, monkeypatch):
    monkeypatch.setattr("service.cli.verify.prepare_kernels", lambda: None)
    vision.answer = counting()
    folder = recorded()
    vision.answer = counting()
    status, out, _ = bowlsight("verify", folder, "--recompute")
    assert status == 0
    assert "10 frames equal to the last bit" in out
    status, out, _ = bowlsight("verify", folder, "--recompute")  # vision goes on counting: another result
    assert status == 1
    assert "results.jsonl: frame 0: pose" in out


def test_verify_of_what_is_no_session_is_refused(bowlsight, tmp_path):
    status, out, err = bowlsight("verify", tmp_path)
    assert (status, out) == (2, "")
    assert "is no recorded session; bowlsight sessions lists those there are" in err


def test_sessions_are_listed_and_searched(recorded, bowlsight, tmp_path):
    folder = recorded("--operator", "Zoe")
    status, out, _ = bowlsight("sessions", "--in", folder.parent, "zoe")
    assert status == 0
    assert folder.name in out
    assert "by Zoe" in out
    assert out.endswith(f"1 session in {folder.parent}\n")
    status, out, _ = bowlsight("sessions", "--in", folder.parent, "--json", "--rebuild")
    (entry,) = [json.loads(line) for line in out.splitlines()]
    assert (entry["frames"], entry["end"], entry["folder"]) == (10, "closed", str(folder))
    assert bowlsight("sessions", "--in", folder.parent, "nobody")[1].startswith("0 sessions in ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--in", "none"], "none: cannot be listed: No such file or directory"),
        (["--since", "yesterday", "--in", "."], "--since = 'yesterday': must be a day, such as 2026-11-22"),
    ],
)
def test_sessions_that_cannot_be_listed_are_refused(bowlsight, arguments, words):
    status, out, err = bowlsight("sessions", *arguments)
    assert (status, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
