"""Interlaced video: one answer a field, found out by itself, whoever comes first, and also where the camera rests."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import NOMINAL
from service.vision.fields import FieldMotion, Interlace, Scan
from service.vision.measurement import Lock
from service.vision.stopwatch import Stopwatch
from service.vision.tracking import Tracker
from tests.scenes.rendered import PERIOD_NS, drift_pitches, errors_of, film, looking, measurer_of, woven

REAL = replace(NOMINAL, hose=False, lane_rows=0)
SMALL = {"size_px": (240, 180), "pitch_px": 28.0}
PITCH_MM = 25.4
WAY = np.array([0.9, 0.45])


def moving(pitches_a_field, fields=16):
    """Pictures at the rate of fields, so far apart; `pitches_a_field` one number, or one a field."""
    steps = np.broadcast_to(pitches_a_field, fields)
    return film([looking(6.0, at_mm=s * PITCH_MM * WAY) for s in np.cumsum(steps)], look=REAL, **SMALL)


def measured(frames, views, field="unknown"):
    """Answers to frames, by frame."""
    measurer = measurer_of(views[0].camera, views[0].lattice)
    return [measurer.measure(f, k * PERIOD_NS, field) for k, f in enumerate(frames)]


@pytest.mark.parametrize("bottom_first", [False, True])
@pytest.mark.parametrize("told", [True, False])
def test_each_field_is_measured_at_its_own_time(bottom_first, told):
    views = moving(0.05, 24)
    order = "interlaced-bottom-first" if bottom_first else "interlaced-top-first"
    answers = measured(woven(views, bottom_first=bottom_first), views, order if told else "unknown")
    assert [len(a) for a in answers[1:]] == [2] * (len(answers) - 1)
    names = ["bottom", "top"] if bottom_first else ["top", "bottom"]
    assert [m.field for m in answers[-1]] == names
    first, second = answers[-1]
    assert second.time_ns - first.time_ns == PERIOD_NS // 2
    told_of = [views[k] for k in range(2 * len(answers))][-6:]
    for seen, m in zip(told_of, [m for a in answers[-3:] for m in a], strict=True):
        assert m.lock is Lock.FULL
        e = errors_of(seen, m)
        assert np.sqrt(np.mean(e.measured_px**2)) < 0.3
        assert e.index_share == 1.0
        assert e.missed == 0


def test_a_field_by_itself_is_told_in_the_frames_lines():
    seen = moving(0.0, 1)[0]
    for parity, name in enumerate(("top", "bottom")):
        m = measurer_of(seen.camera, seen.lattice).measure(seen.image[parity::2], 0, name)[0]
        e = errors_of(seen, m)
        assert (m.field, m.lock) == (name, Lock.FULL)
        assert np.sqrt(np.mean(e.measured_px**2)) < 0.3
        assert abs(e.measured_px[:, 1].mean()) < 0.2
        assert m.pose.camera.image_size_px == seen.camera.image_size_px


def test_progressive_video_is_never_taken_for_fields():
    views = moving(0.1, 16)
    answers = measured([v.image for v in views], views)
    assert [[m.field for m in a] for a in answers] == [["progressive"]] * 16
    assert drift_pitches(views, [a[0] for a in answers]).max() < 0.05


def test_where_the_camera_stands_still_both_fields_make_one_picture():
    views = moving(0.0, 16)
    answers = measured(woven(views), views)
    assert {m.field for a in answers for m in a} == {"progressive"}
    assert {m.lock for a in answers for m in a} == {Lock.FULL}


def test_interlace_is_found_out_once_the_camera_moves_and_kept_when_it_rests_again():
    steps = np.concatenate([np.zeros(8), np.full(16, 0.04), np.zeros(8), np.full(8, -0.04)])
    views = moving(steps, 40)
    answers = measured(woven(views), views)
    counts = [len(a) for a in answers]
    assert counts[:4] == [1] * 4
    assert counts[6:] == [2] * 14
    last = [m for a in answers[-4:] for m in a]
    assert [m.field for m in last] == ["top", "bottom"] * 4
    assert {m.lock for m in last} == {Lock.FULL}
    assert drift_pitches(views[-8:], last).max() < 0.05


def test_a_rest_at_the_start_does_not_make_a_video_progressive():
    views = moving(np.concatenate([np.zeros(60), np.full(8, 0.05)]), 68)
    answers = measured(woven(views), views)
    assert [len(a) for a in answers[-2:]] == [2, 2]


def test_fields_too_far_apart_for_one_picture_are_told_apart():
    """A fast pan from the first picture on: the frame as a whole shows no lattice worth the name."""
    views = moving(0.25, 12)
    answers = measured(woven(views), views)
    assert [len(a) for a in answers[-3:]] == [2] * 3
    assert {m.lock for m in answers[-1]} <= {Lock.FULL, Lock.PARTIAL}


@pytest.mark.parametrize("field", ["unknown", "interlaced-top-first"])
def test_an_odd_number_of_lines_is_no_trouble(field):
    views = moving(0.05, 8)
    frames = [f[:-1] for f in woven(views)]
    camera = replace(views[0].camera, image_size_px=(240, 179))
    measurer = measurer_of(camera, views[0].lattice)
    answers = [measurer.measure(f, k * PERIOD_NS, field) for k, f in enumerate(frames)]
    assert {m.lock for a in answers[1:] for m in a} == {Lock.FULL}


def test_one_frame_lost_in_a_leap_does_not_make_a_video_interlaced():
    views = moving(0.0, 2)
    refined = Tracker(views[0].camera, views[0].lattice).step(views[0].image, None, 0, Stopwatch(lambda: 0)).refined
    interlace = Interlace()
    interlace.compared(refined, None, None, 0.0)
    interlace.compared(None, refined, None, 0.0)
    assert interlace.scan is Scan.UNDECIDED
    interlace.compared(refined, None, None, 0.0)
    for expected in (Scan.UNDECIDED, Scan.INTERLACED):
        interlace.compared(None, refined, None, 0.0)
        assert interlace.scan is expected


def test_a_first_frame_that_only_its_fields_explain_is_interlaced():
    views = moving(0.0, 1)
    refined = Tracker(views[0].camera, views[0].lattice).step(views[0].image, None, 0, Stopwatch(lambda: 0)).refined
    interlace = Interlace()
    interlace.compared(None, refined, None, 0.0)
    assert interlace.scan is Scan.INTERLACED


def test_a_motion_is_clear_beyond_noise_only():
    rng = np.random.default_rng(0)
    still, moved = rng.normal(0, 0.3, (60, 2)), rng.normal(0, 0.3, (60, 2)) + np.array([0.8, 0.0])
    assert not FieldMotion(still).clear
    assert FieldMotion(moved).clear
    assert not FieldMotion(np.tile([0.15, 0.0], (60, 1))).clear  # a codec's


def test_nothing_seen_decides_nothing():
    interlace = Interlace()
    for _ in range(30):
        interlace.compared(None, None, None, 5.0)
    assert interlace.scan is Scan.UNDECIDED
    interlace.ordered(None, None)
    assert interlace.top_first
