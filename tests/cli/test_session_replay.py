"""Real pictures, recorded as they are measured live, come out the same to the last bit: also after kill -9."""

import argparse
import itertools
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.errors import ConfigError
from drivers.grabber import SystemClock
from drivers.replay import ReplayGrabber
from drivers.session_index import INDEX, Measured, Outside, Row, read_index
from service.acquisition.cross_check import CrossCheck
from service.acquisition.measuring import FrameMeasurer
from service.acquisition.readings import InstrumentReadings
from service.acquisition.slot import FrameQueue
from service.alignment.targets import Target
from service.cli import main
from service.cli.again import measured_as_recorded, remembered
from service.cli.interpreting import interpreter_for
from service.config.recording import RecordingSettings
from service.config.station import read_station
from service.identity.anchors import Anchor
from service.identity.names import TubeName
from service.report.digest import read_digest
from service.sinks.session.comparison import Comparison
from service.sinks.session.configuration import configuration
from service.sinks.session.plan import RecordingPlan
from service.sinks.session.reader import SessionEnd, open_session
from service.sinks.session.recorder import SessionRecorder
from service.sinks.session.verification import verify_session
from service.vision.measurement import Doubt
from service.vision.paper import assumed_camera
from service.vision.process import Measurer

pytestmark = [pytest.mark.shared, pytest.mark.slow]

VIDEOS = [
    ("v0_WF_nominal_pan_640x480.mp4", "model-f"),
    ("v2_51B_brutal_interlaced_720x480.avi", "51b"),
    ("w1_Delta60_hard_speckle_640x480.avi", "delta60"),
]
GUIDE = "mouth_mm = [5, -4, 600]\naxis = [0.01, -0.01, 1]\naxis_sigma_deg = 0.1\npoint_sigma_mm = 0.1\n"


def tube(rule, number):
    return TubeName(rule.naming, number, number)


def station(folder: Path, generator: str) -> Path:
    (folder / "guide.toml").write_text(GUIDE)
    path = folder / "s.toml"
    path.write_text(
        f'[source]\ndevice = "simulated"\n[generator]\nname = "{generator}"\n[recording]\nviewer = false\n'
        '[alignment]\nguide = "guide.toml"\nprobe_diameter_mm = 10\ngap_mm = 25\n'
        '[range_finder]\nport = "/dev/none"\nmodel = "dimetix"\n'
        '[identity]\nrows_grow = "up"\ncolumns_grow = "right"\nleg = "HL"\n'
    )
    return path


def as_a_live_source_gives_them(video: Path, count: int):
    """Frames with what befalls them: some are not measured, one is bad, and the source is reopened once."""
    with ReplayGrabber(video, speed=math.inf) as grabber:
        grabber.start()
        for k, frame in enumerate(itertools.islice(grabber, count)):
            bad = "truncated" if k == count // 3 else None
            again = 2 if k >= 2 * count // 3 else 1
            yield replace(frame, generation=again, defect=bad, received_ns=time.monotonic_ns()), k % 4 != 3


def with_a_leap(video: Path, before: int, after: int, leap_to: int):
    """All frames of a source that leaps in the midst, as a looped video does."""
    with ReplayGrabber(video, speed=math.inf) as grabber:
        grabber.start()
        frames = [f for k, f in enumerate(itertools.islice(grabber, leap_to + after)) if k < before or k >= leap_to]
    times_ns = [f.timestamp_ns for f in frames[:2]]
    for k, frame in enumerate(frames):
        time_ns = times_ns[0] + k * (times_ns[1] - times_ns[0])
        yield replace(frame, sequence=k, generation=1, timestamp_ns=time_ns, received_ns=time.monotonic_ns()), True


def record_frames(frames_measured, folder: Path, generator: str, do, *, anchor_from_start=True, begin_at=0) -> Path:
    """Measure and record these frames as the live service does, without its threads.

    Before each frame, `do` gets its sequence number, the interpreter, and the last result.
    """
    path = station(folder, generator)
    s = read_station(path)
    rule = s.identity.rule(s.generator)
    anchor = [f"0,0={tube(rule, 20)}"] if anchor_from_start else []
    plan = RecordingPlan(
        RecordingSettings(enabled=not begin_at, folder=folder / "sessions", keep_free_mib=0),
        "REPLAY", generator, configuration(path), rule, anchor,
    )  # fmt: skip
    frames = FrameQueue(8, waits=True)
    recorder = SessionRecorder(plan, SystemClock(), remembers=True)
    recorder.listen(frames)
    said = argparse.Namespace(anchor=anchor, target=None)
    distances = map(float, itertools.count(900))
    interpreter = interpreter_for(said, s.identity, s.alignment, s.generator)
    measurer = last = None
    recorder.start()
    for frame, measured in frames_measured:
        if measurer is None:
            vision = Measurer(assumed_camera(frame.size_px), s.generator.lattice, time.perf_counter_ns)
            check = CrossCheck(lambda: InstrumentReadings(distance_mm=next(distances), distance_sigma_mm=1.0))
            measurer = FrameMeasurer(
                vision, None, SystemClock(), interpreter, check, memory_wanted=lambda: recorder.memory_wanted
            )
        if begin_at and frame.sequence == begin_at:
            recorder.start_recording()
        frames.offer(frame)
        do(frame.sequence, interpreter, last)
        if measured:
            results = measurer.answer(frame)[0]
            recorder.accept(frame, results)
            last = results[-1]
    frames.close()
    recorder.close(60.0)
    (session,) = (folder / "sessions").iterdir()
    return session


def record(video: Path, folder: Path, generator: str, count: int, begin_at: int = 0) -> Path:
    """Record with all that befalls a live source, and with what operators do in the midst of it."""

    def do(sequence, interpreter, _):
        if sequence == count // 4:
            interpreter.aligner.target = Target(place=(1, 1), generation=1)
        elif sequence == count // 2:
            interpreter.namer.anchor([Anchor(1, -2, tube(interpreter.namer.rule, 20))], 1, 0)

    frames = as_a_live_source_gives_them(video, count)
    return record_frames(frames, folder, generator, do, begin_at=begin_at)


@pytest.mark.parametrize(("video", "generator"), VIDEOS)
def test_skipped_bad_and_reopened_frames_are_measured_again_to_the_last_bit(shared, tmp_path, video, generator):
    count = 60 if video.startswith("v0") else 24
    session = open_session(record(shared / "bowl" / "videos" / video, tmp_path, generator, count))
    assert list(verify_session(session.folder)) == []
    locks = [line["lock"] for line in session.results()]
    assert sum(lock != "none" for lock in locks) > len(locks) // 2
    alignments = [line["alignment"] for line in session.results()]
    assert len({alignment["target"] for alignment in alignments}) > 1
    chosen = [item.values for item in session.index() if isinstance(item, Outside)]
    assert sum("target" in values for values in chosen) == 1
    assert sum("anchors" in values for values in chosen) == 1
    assert len({values["readings"]["distance_mm"] for values in chosen}) == len(chosen) == len(alignments)
    comparison = Comparison(session)
    for frame, results in measured_as_recorded(session):
        comparison.accept(frame, results)
    assert comparison.same, comparison.lines()
    assert comparison.equal == session.counts().measured == count - count // 4


@pytest.mark.parametrize(("video", "generator"), VIDEOS)
@pytest.mark.parametrize("begin_at", [10, 15])
def test_a_recording_that_begins_in_the_midst_begins_with_what_was_remembered(
    shared, tmp_path, video, generator, begin_at
):
    count = 60 if video.startswith("v0") else 28
    session = open_session(record(shared / "bowl" / "videos" / video, tmp_path, generator, count, begin_at))
    assert not session.about.from_start
    assert list(verify_session(session.folder)) == []
    assert session.size_bytes < 100e6
    memory = session.memory()
    comparison = Comparison(session, remembered=True)
    for frame, results in measured_as_recorded(session, memory):
        comparison.accept(frame, results)
    assert comparison.same, comparison.lines()
    assert comparison.inexact == 0
    assert comparison.equal == session.counts().measured == sum(k % 4 != 3 for k in range(begin_at, count))


def test_without_what_was_remembered_it_would_differ_and_a_changed_byte_of_it_is_found(shared, tmp_path, capsys):
    video, generator = VIDEOS[0]
    session = open_session(record(shared / "bowl" / "videos" / video, tmp_path, generator, 30, 10))
    for options in (["--check"], ["--no-viewer", "--no-console", "--speed", "max"]):
        assert main(["replay", str(session.folder), *options]) == 0
        assert "recorded     15 frames equal to the last bit (" in capsys.readouterr().out
    assert main(["replay", str(session.folder), "--check", "--target", "nearest"]) == 1
    assert "differ after frames that are not recorded" in capsys.readouterr().out
    comparison = Comparison(session)
    for frame, results in measured_as_recorded(session):
        comparison.accept(frame, results)
    assert comparison.inexact > 0
    path = session.folder / "memory.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert [f.file for f in verify_session(session.folder)] == ["memory.npz"]
    with pytest.raises(ConfigError, match="was changed"):
        session.memory()
    assert remembered(session) is None
    path.unlink()
    assert [f.file for f in verify_session(session.folder)] == ["memory.npz"]
    assert remembered(session) is None


@pytest.mark.parametrize(("video", "generator", "leap_to"), [(*VIDEOS[1], 100)])  # the map mends the others' leaps
@pytest.mark.parametrize("anchored", [True, False])
def test_an_anchor_settles_an_index_that_came_into_doubt_then_as_again(
    shared, tmp_path, video, generator, leap_to, anchored
):
    leap, anchor, end = 12, 16, 24
    told = []

    def do(sequence, interpreter, last):
        interpreter.namer.tell = lambda text, level: told.append(text)
        if sequence == anchor:
            assert Doubt.INDEX in last.measurement.doubt
            tubes = last.measurement.tubes
            place = int(tubes.row[3]), int(tubes.column[3])
            name = tube(interpreter.namer.rule, 30)
            interpreter.namer.anchor([Anchor(*place, name)], 1, last.measurement.index)

    frames = with_a_leap(shared / "bowl" / "videos" / video, leap, end - leap, leap_to)
    session = open_session(record_frames(frames, tmp_path, generator, do, anchor_from_start=anchored))
    by_frame = [answered.lines for answered in session.answers()]
    doubted = [any("index" in line["doubt"] for line in lines) for lines in by_frame]
    named = [any(t["name"] for line in lines for t in line["tubes"]) for lines in by_frame]
    assert doubted == [leap <= k <= anchor for k in range(end)]
    assert named == [(anchored and k < leap) or k > anchor for k in range(end)]
    assert len(told) == 1
    assert ("had slipped by" in told[0]) == anchored
    assert [answered.last_of_index for answered in session.answers()].count(True) == (not anchored)
    sheets = read_digest(session).sheets.values()
    assert sum(sheet.pictures for sheet in sheets) == sum(map(len, by_frame))
    assert len(sheets) == (1 if anchored else 2)
    comparison = Comparison(session)
    for frame, results in measured_as_recorded(session):
        comparison.accept(frame, results)
    assert comparison.same, comparison.lines()
    assert comparison.equal == end


def recorded_until(root: Path, measured: int, process: subprocess.Popen, seconds: float = 300.0) -> Path:
    """Wait until so many frames were measured and recorded."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        assert process.poll() is None, "the replay ended"
        for index in root.glob(f"*/{INDEX}"):
            if sum(isinstance(item, Measured) for item in read_index(index)) >= measured:
                return index.parent
        time.sleep(0.1)
    pytest.fail("nothing was recorded in time")


@pytest.mark.parametrize(("video", "generator"), VIDEOS)
def test_kill_9_loses_less_than_a_second_and_what_is_there_is_the_same(shared, tmp_path, video, generator):
    root = tmp_path / "sessions"
    with subprocess.Popen(
        [
            sys.executable, "-c", "import sys; from service.cli import main; sys.exit(main())", "replay",
            str(shared / "bowl" / "videos" / video), "--config", str(station(tmp_path, generator)), "--record",
            str(root), "--no-viewer", "--loop",
        ],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=Path(__file__).parents[2],
    ) as process:  # fmt: skip
        folder = recorded_until(root, 10, process)
        os.kill(process.pid, signal.SIGKILL)
        process.wait(30)
    session = open_session(folder)
    assert session.counts().end is SessionEnd.INTERRUPTED
    assert [f for f in verify_session(folder) if f.grave] == []
    rows = [item for item in session.index() if isinstance(item, Row)]
    shown = [row for row, _, problem in session.pictures(rows) if problem is None]
    assert rows[-1].received_ns - shown[-1].received_ns < 1e9  # how far a busy machine lags behind is not our matter
    comparison = Comparison(session)
    for frame, results in measured_as_recorded(session):
        comparison.accept(frame, results)
    assert comparison.same, comparison.lines()
    assert comparison.equal >= 9
