"""The service calibrates while it runs: bounded, told in words, and with a camera file to take."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from drivers.errors import ConfigError
from drivers.scene import NOMINAL
from service.config.cameras import read_camera
from service.results import FrameResult
from service.sinks import calibrating
from service.sinks.calibrating import CAPACITY, PAUSE_S, CalibrationSink
from service.vision.bundle import Range
from service.vision.measurement import Lock
from tests.fakes.drawn import frame_of
from tests.fakes.results import make_measurement
from tests.scenes.rendered import looking, measurer_of, sheet_of, unknown_camera, view

LOOK = replace(NOMINAL, hose=False, lane_rows=0, scatter_mm=0.06)
TILTS = [(1.0, 0.0), (3.0, 60.0), (5.0, 150.0), (7.0, 20.0), *((12.0, 45.0 * i) for i in range(8))]


@pytest.fixture(scope="module")
def answers():
    """Frames with their results, of a sheet from one tilt after another."""
    sheet = sheet_of(view("system80").sheet.lattice, LOOK)
    out = []
    for i, (tilt, azimuth) in enumerate(TILTS):
        v = view("system80", LOOK, pose=looking(tilt, azimuth), seed=i, sheet=sheet)
        m = measurer_of(unknown_camera(v.optics), v.lattice).measure(v.image, 0, "progressive")[0]
        frame = frame_of(v.image, i)
        out.append((frame, (FrameResult("bowl", i, frame.timestamp_ns, 1, m),)))
    return v, out


class Told(list):
    def __call__(self, text, level):
        self.append((text, level))


class Clock:
    """Every look at it is `step_s` later."""

    def __init__(self, step_s):
        self.now_s, self.step_s = 0.0, step_s

    def __call__(self):
        self.now_s += self.step_s
        return self.now_s


def run(answers, out, step_s=PAUSE_S, camera=None, **known):
    v, frames = answers
    told = Told()
    utc = datetime(2026, 1, 2, tzinfo=UTC)
    sink = CalibrationSink(camera, v.lattice, out, told, Clock(step_s), lambda: utc, **known)
    sink.start()
    for frame, results in frames:
        sink.accept(frame, results)
        while sink.stats().depth:
            sink._thread.join(0.005)
    sink.close(30.0)
    return sink, told


def test_it_says_how_far_it_is_and_writes_the_file(answers, tmp_path, monkeypatch):
    monkeypatch.setattr(calibrating, "BETTER", 1.0)  # the last answer may be better by too little to be told
    out = tmp_path / "camera.toml"
    camera = unknown_camera(answers[0].optics)
    sink, told = run(answers, out, camera=camera)
    assert sink.stats().accepted == len(TILTS)
    assert sink.stats().dropped == sink.stats().failed == 0
    assert told[0][0].startswith("calibration: f = ")
    assert "from 4 pictures" in told[0][0]
    assert "tilt the camera" in told[0][0]
    assert all(level == "INFO" for _, level in told)
    assert told[-1][0].endswith("camera.toml is written")
    camera = read_camera(out)
    f = answers[0].optics.focal_length_mm
    assert abs(camera.focal_length_mm - f) < 3 * camera.sigma("focal_length_mm") < 0.03 * f
    assert 'calibrated_utc = "2026-01-02T00:00:00+00:00"' in out.read_text()
    assert f"from {len(TILTS)} pictures" in sink.progress  # told only where it says more than the last time


def test_what_is_known_beforehand_makes_up_for_tilts_that_were_not_seen(answers):
    v, frames = answers
    few, f = (v, frames[:4]), v.optics.focal_length_mm
    distance_mm = float(looking(*TILTS[0])[1] @ looking(*TILTS[0])[0][:, 2])
    known = {"nothing": {}, "range": {"known_range": Range(distance_mm, 1.0)}, "f": {"focal_length_mm": (f, 0.001 * f)}}
    sigma = {}
    for what, told in known.items():
        camera = run(few, None, camera=unknown_camera(v.optics), **told)[0].calibration.camera
        sigma[what] = camera.sigma("focal_length_mm")
        assert abs(camera.focal_length_mm - f) < 3 * sigma[what]
    assert sigma["range"] < 0.5 * sigma["nothing"]
    assert sigma["f"] < 0.5 * sigma["nothing"]


def test_without_a_file_to_write_it_only_tells(answers, tmp_path):
    sink, told = run(answers, None)
    assert told
    assert "written" not in told[-1][0]
    assert sink.calibration is not None
    assert "sx" in sink.calibration.camera.parameters
    assert not list(tmp_path.iterdir())


def test_it_does_not_solve_more_often_than_it_may(answers):
    sink, told = run(answers, None, step_s=1e-3)
    assert "from 4 pictures" in told[0][0]
    assert len(told) <= 2  # that one, and the last before it ends
    assert sink.calibration.frames == len(TILTS)


def test_pictures_without_a_lock_are_passed_over():
    told = Told()
    sink = CalibrationSink(None, view("system80").lattice, None, told)
    sink.start()
    nothing = FrameResult("bowl", 0, 0, 1, make_measurement(Lock.NONE))
    sink.accept(frame_of(np.zeros((48, 64), np.uint8), 0), [nothing])
    sink.close(5.0)
    assert (told, sink.calibration, sink.progress) == ([], None, "no picture yet")


def test_what_finds_no_room_is_counted(answers):
    """The queue is short: a frame that waits is soon a frame too old to be worth anything."""
    v, frames = answers
    sink = CalibrationSink(None, v.lattice, None, Told())
    for frame, results in frames:
        sink.accept(frame, results)
    stats = sink.stats()
    assert (stats.accepted, stats.depth, stats.dropped) == (len(TILTS), CAPACITY, len(TILTS) - CAPACITY)
    sink.start()
    sink.close(5.0)


def test_a_source_opened_anew_has_another_index(answers):
    v, frames = answers
    sink = CalibrationSink(None, v.lattice, None, Told())
    sink.start()
    for i, (frame, (result,)) in enumerate(frames[4:7]):
        sink.accept(frame, [replace(result, generation=1 + i // 2)])
        while sink.stats().depth:
            sink._thread.join(0.005)
    sink.close(5.0)
    first, second, third = (k.series for k in sink._collector.kept)
    assert first == second != third


def test_a_place_that_cannot_be_written_is_refused_at_once(answers, tmp_path):
    sink = CalibrationSink(None, answers[0].lattice, tmp_path / "none" / "camera.toml", Told())
    with pytest.raises(ConfigError, match="cannot be written there"):
        sink.start()
