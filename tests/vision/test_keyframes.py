"""Which pictures a calibration keeps."""

from dataclasses import replace

import numpy as np
import pytest

from service.vision.collecting import Collector
from service.vision.errors import DegenerateError
from service.vision.keyframes import MOST, Keyframes
from service.vision.measurement import Doubt, Lock
from tests.fakes.results import make_measurement
from tests.scenes.rendered import looking, unknown_camera, view
from tests.vision.installation import LATTICE, UNKNOWN, Sheet, seen_from


@pytest.fixture
def sheet():
    return Sheet(np.random.default_rng(1))


def test_a_picture_that_says_the_same_is_not_kept(sheet):
    kept = Keyframes()
    assert kept.add(sheet.picture(seen_from(3.0, 0.0)))
    assert not kept.add(sheet.picture(seen_from(3.05, 0.0), seen=0.3))
    assert kept.add(sheet.picture(seen_from(6.0, 0.0)))
    assert len(kept) == 2


def test_of_two_that_say_the_same_the_one_with_more_tubes_stays(sheet):
    first, fewer, more = (sheet.picture(seen_from(t, 0.0), seen=s) for t, s in ((0.0, 0.7), (5.0, 0.4), (5.05, 0.9)))
    kept = Keyframes()
    assert kept.add(first)
    assert kept.add(fewer)
    assert kept.add(more)
    assert list(kept) == [first, more]


@pytest.mark.parametrize(
    "other",
    [
        {"tilt_x_deg": 3.0},
        {"tilt_y_deg": -3.0},
        {"roll_deg": 12.0},
        {"at_mm": (100.0, 0.0)},
        {"distance_mm": 900.0},
    ],
)
def test_whatever_is_looked_at_otherwise_is_worth_keeping(sheet, other):
    pose = {"tilt_x_deg": 0.0, "tilt_y_deg": 0.0}
    kept = Keyframes()
    assert kept.add(sheet.picture(seen_from(**pose)))
    assert kept.add(sheet.picture(seen_from(**pose | other)))


def test_a_focal_length_guessed_otherwise_makes_no_other_look(sheet):
    """A near-frontal picture's own f is anything, and with it the tangent of its tilt and its distance."""
    picture = sheet.picture(seen_from(3.0, 0.0))
    f, t = picture.camera.focal_length_mm, 1066.0
    rotation, translation = seen_from(np.degrees(np.arctan(2 * np.tan(np.radians(3.0)))), 0.0, 2 * t)
    twice = replace(
        picture, camera=replace(picture.camera, focal_length_mm=2 * f), rotation=rotation, translation_mm=translation
    )
    once = replace(picture, translation_mm=seen_from(3.0, 0.0, t)[1])
    assert np.abs(twice.look() - once.look()).max() < 0.1


def test_no_more_are_kept_than_asked_for_and_the_extremes_stay(sheet):
    kept = Keyframes(most=5)
    tilts = [0.0, 12.0, -12.0, 1.0, 2.0, 3.0, 4.0, -6.0, 6.0]
    pictures = {t: sheet.picture(seen_from(t, 0.0)) for t in tilts}
    for picture in pictures.values():
        kept.add(picture)
    assert len(kept) == 5
    for t in (0.0, 12.0, -12.0):
        assert any(k is pictures[t] for k in kept)


def test_however_long_it_collects_the_number_is_bounded(sheet):
    kept = Keyframes()
    rng = np.random.default_rng(2)
    for _ in range(3 * MOST):
        kept.add(sheet.picture(seen_from(*rng.uniform(-15, 15, 2), roll_deg=rng.uniform(-40, 40)), seen=0.3))
    assert len(kept) == MOST


def test_the_first_picture_stays_for_the_range_that_was_measured_to_it(sheet):
    kept = Keyframes(most=3)
    first = sheet.picture(seen_from(0.0, 0.0), seen=0.4)
    for picture in (first, sheet.picture(seen_from(0.05, 0.0), seen=0.9)):
        kept.add(picture)
    for t in (0.5, 8.0, 9.0, -8.0):
        kept.add(sheet.picture(seen_from(t, 0.0)))
    assert next(iter(kept)) is first


def test_a_collector_says_why_pictures_were_of_no_use():
    collector = Collector(UNKNOWN, LATTICE)
    collector.begin()
    assert not collector.take(make_measurement(Lock.NONE, reason="no tube pattern is seen"))
    v = view("system80", pose=looking(4.0))
    seen = v.measure(unknown_camera(v.optics))
    blurred = replace(seen, doubt=(*seen.doubt, Doubt.FOCUS))
    few = replace(seen, view=replace(seen.view, measured=seen.view.measured & (np.arange(len(seen.view.row)) < 9)))
    for measurement in (blurred, few, few):
        assert not collector.take(measurement)
    assert collector.seen == 4
    assert collector.left_out == {
        "no lock: no tube pattern is seen": 1,
        "out of focus": 1,
        "fewer than 12 tubes measured": 2,
    }
    with pytest.raises(DegenerateError):
        collector.solve()


def test_pictures_of_another_source_or_of_a_doubtful_index_show_other_tubes():
    v = view("system80", pose=looking(4.0))
    w = view("system80", pose=looking(9.0))
    x = view("system80", pose=looking(14.0))
    camera = unknown_camera(v.optics)
    collector = Collector(camera, v.lattice)
    sure = v.measure(camera)
    doubtful = w.measure(camera)
    collector.begin()
    assert collector.take(sure)
    assert collector.take(replace(doubtful, doubt=(Doubt.INDEX,)))
    assert collector.take(x.measure(camera))
    collector.begin()
    assert collector.take(view("system80", pose=looking(9.0, 130.0)).measure(camera))
    first, second, third, fourth = (k.series for k in collector.kept)
    assert first == third
    assert len({first, second, fourth}) == 3
