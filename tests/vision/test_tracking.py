"""Following the sheet: how fast, what becomes of the lattice index, and that a slip is never told as the truth."""

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import CLEAN, NOMINAL
from service.vision.measurement import Doubt, Lock
from tests.scenes.rendered import (
    PERIOD_NS,
    PLAIN,
    drift_pitches,
    errors_of,
    film,
    follow,
    in_doubt,
    looking,
    measurer_of,
)

SMALL = {"size_px": (240, 180), "pitch_px": 24.0}
REAL = replace(NOMINAL, hose=False, lane_rows=0)
"""Tubes off their places, plugs, texture, noise: what tells places apart."""
ALIKE = replace(CLEAN, plugged=0.0)
"""Every place looks like every other."""
PITCH_MM = 25.4
LATTICE_WAYS = [np.array([math.cos(a), math.sin(a)]) for a in np.radians([0, 60, 120, 240])]


def at(offsets_pitches, **pose):
    return [looking(6.0, at_mm=PITCH_MM * np.asarray(o), **pose) for o in offsets_pitches]


def never_slips_unseen(views, answers):
    """Every answer with a pose is either of the first one's index, or says that it may not be."""
    drift = drift_pitches(views, answers)
    return bool(np.all(np.isnan(drift) | (drift < 0.3) | in_doubt(answers)))


@pytest.mark.parametrize("tubes", ["system80", "model-f"])
@pytest.mark.parametrize("way_deg", [0, 100, 215])
def test_three_tenths_of_a_pitch_a_frame_are_held_from_rest_to_rest(tubes, way_deg):
    way = np.array([math.cos(math.radians(way_deg)), math.sin(math.radians(way_deg))])
    path = [0, 0, 0, *np.arange(1, 13), 12, 12]
    views = film(at([0.3 * k * way for k in path]), tubes, REAL, **SMALL)
    answers = follow(views)
    assert [m.lock for m in answers] == [Lock.FULL] * len(views)
    assert drift_pitches(views, answers).max() < 0.05
    rms = [np.sqrt(np.mean(errors_of(v, m).measured_px ** 2)) for v, m in zip(views, answers, strict=True)]
    assert max(rms) < 2 * rms[0] + 0.05


def test_turning_tilting_and_coming_nearer_are_followed_too():
    poses = [looking(4.0 + k, 40.0 + 3 * k, 10.0 + 2 * k, 700.0 - 12 * k) for k in range(12)]
    views = film(poses, look=REAL, **SMALL)
    answers = follow(views)
    assert [m.lock for m in answers] == [Lock.FULL] * len(views)
    for seen, m in zip(views, answers, strict=True):
        assert m.pose.distance_mm == pytest.approx(seen.rotation[:, 2] @ seen.translation_mm, abs=2.0)
        assert m.pose.tilt_deg == pytest.approx(math.degrees(math.acos(seen.rotation[2, 2])), abs=0.3)


def test_a_tracked_picture_says_what_it_says_from_nothing():
    views = film(at([(0.1 * k, 0.05 * k) for k in range(6)]), look=REAL, **SMALL)
    tracked, anew = follow(views)[-1], views[-1].measure()
    sigma = math.hypot(tracked.pose.sigma.distance_mm, anew.pose.sigma.distance_mm)
    assert abs(tracked.pose.distance_mm - anew.pose.distance_mm) < 2 * sigma
    assert abs(tracked.pose.tilt_deg - anew.pose.tilt_deg) < 0.1
    assert abs(len(tracked.tubes) - len(anew.tubes)) <= 2


@pytest.mark.parametrize("way", LATTICE_WAYS)
@pytest.mark.parametrize("pitches", [1.0, 2.0])
def test_a_leap_of_whole_pitches_that_no_residual_shows_does_not_slip(pitches, way):
    views = film(at([(0, 0)] * 4 + [pitches * way] * 5), look=REAL, **SMALL)
    answers = follow(views)
    assert never_slips_unseen(views, answers)
    assert answers[-1].lock is Lock.FULL
    assert drift_pitches(views, answers)[-1] < 0.1


@pytest.mark.parametrize("offset", [(0.5, 0.0), (0.4, 0.3), (1.4, 0.3), (-2.5, 0.6), (3.1, -1.7)])
def test_a_leap_within_a_frame_is_found_again_in_the_same_picture(offset):
    views = film(at([(0, 0)] * 4 + [offset] * 3), look=REAL, **SMALL)
    answers = follow(views)
    assert None not in [m.pose for m in answers]
    assert never_slips_unseen(views, answers)
    assert drift_pitches(views, answers)[-1] < 0.1


@pytest.mark.parametrize("offset", [(0.5, 0.1), (1.0, 0.0), (4.0, 0.0)])
def test_where_all_places_look_alike_a_leap_after_a_gap_stays_in_doubt(offset):
    views = film(at([(0, 0)] * 4 + [offset] * 5), look=ALIKE, **SMALL)
    times = [(k + (25 if k >= 4 else 0)) * PERIOD_NS for k in range(len(views))]
    answers = follow(views, times_ns=times)
    assert not in_doubt(answers[:4]).any()
    assert in_doubt(answers[4:]).all()
    assert {m.lock for m in answers[4:]} == {Lock.PARTIAL}


@pytest.mark.parametrize("offset", [(0.0, 0.0), (1.0, 0.0), (2.3, 1.9)])
def test_a_gap_in_the_stream_is_settled_by_what_tells_places_apart(offset):
    views = film(at([(0, 0)] * 6 + [offset] * 6), look=REAL, **SMALL)
    times = [(k + (50 if k >= 6 else 0)) * PERIOD_NS for k in range(len(views))]
    answers = follow(views, times_ns=times)
    assert never_slips_unseen(views, answers)
    assert answers[-1].lock is Lock.FULL
    assert drift_pitches(views, answers)[-1] < 0.1


def test_a_frame_or_two_lost_on_the_way_are_no_reason_to_doubt():
    views = film(at([(0.1 * k, 0) for k in (0, 1, 2, 4, 5, 7, 8)]), look=ALIKE, **SMALL)
    answers = follow(views, times_ns=[k * PERIOD_NS for k in (0, 1, 2, 4, 5, 7, 8)])
    assert [m.lock for m in answers] == [Lock.FULL] * len(views)


@pytest.mark.parametrize("look", [REAL, ALIKE])
def test_lost_and_found_again_a_pitch_aside(look):
    views = film(at([(0, 0)] * 6 + [(1.0, 0.0)] * 6), look=look, **SMALL)
    dark = [replace(views[0], image=np.zeros_like(views[0].image))] * 10
    told = follow(views[:6] + dark + views[6:])
    lost, found = told[6:16], told[16:]
    assert {m.lock for m in lost} == {Lock.NONE}
    assert all(m.reason and m.pose is None and len(m.tubes) == 0 for m in lost)
    assert never_slips_unseen([views[0], *views[6:]], [told[0], *found])
    if look is REAL:
        assert found[-1].lock is Lock.FULL
        assert drift_pitches([views[0], views[-1]], [told[0], found[-1]])[1] < 0.1
    else:
        assert in_doubt(found).all()


def test_far_off_and_back_the_index_is_the_first_one():
    way = [0.25 * k for k in range(25)]
    views = film(at([(x, 0.4 * x) for x in way + way[::-1]]), look=REAL, **SMALL)
    answers = follow(views)
    assert {m.lock for m in answers} == {Lock.FULL}
    assert drift_pitches(views, answers).max() < 0.1


def test_forgetting_makes_the_next_picture_the_first_one():
    views = film(at([(0, 0)] * 3 + [(1.0, 0.0)]), look=REAL, **SMALL)
    measurer = measurer_of(views[0].camera, views[0].lattice)
    before = follow(views[:3], measurer)
    measurer.reset()
    after = measurer.measure(views[3].image, 0, "progressive")[0]
    fresh = views[3].measure()
    assert Doubt.INDEX not in after.doubt
    assert np.array_equal(after.tubes.center_px, fresh.tubes.center_px)
    assert after.lock is before[-1].lock is Lock.FULL


def test_the_same_picture_again_and_again_changes_nothing():
    seen = film(at([(0, 0)]), look=REAL, **SMALL)[0]
    answers = follow([seen] * 12)
    assert [m.lock for m in answers] == [Lock.FULL] * 12
    distance = np.array([m.pose.distance_mm for m in answers])
    assert np.ptp(distance[2:]) < 0.5 * answers[-1].pose.sigma.distance_mm


@pytest.mark.parametrize("times_ns", [[0, 0, 0, 0], [10**9, 5 * 10**8, 0, 2 * 10**9], [0, 1, 2, 3]])
def test_times_that_stand_still_or_run_backwards_do_no_harm(times_ns):
    views = film(at([(0.02 * k, 0) for k in range(4)]), look=REAL, **SMALL)
    answers = follow(views, times_ns=times_ns)
    assert None not in [m.pose for m in answers]
    assert drift_pitches(views, answers).max() < 0.1


def test_from_picture_to_picture_a_sheet_of_another_pitch_is_not_taken_for_this_one():
    here = film(at([(0, 0)] * 3), look=PLAIN, **SMALL)
    other = film(at([(0, 0)]), "51b", PLAIN, size_px=(240, 180), pitch_px=31.0)
    answers = follow([*here, *other])
    assert answers[2].lock is Lock.FULL
    assert answers[3].lock is Lock.NONE


@pytest.mark.parametrize("outage", [5, 15, 25])
def test_an_outage_while_the_arm_speeds_up_loses_no_index_that_the_map_can_tell(outage):
    """To where the speed would have led by then, an index beyond the map's reach was taken."""
    path = [0.0, *(0.02 * k * k for k in range(7))]
    views = film(at([(s, 0.0) for s in [*path, *[path[-1]] * 4]]), look=REAL, **SMALL)
    measurer, answers = measurer_of(views[0].camera, views[0].lattice), []
    for k, seen in enumerate(views):
        late = outage if k > len(path) - 1 else 0
        answers += measurer.measure(seen.image, (k + late) * PERIOD_NS, "progressive")
        if k == len(path) - 1:
            black = np.zeros_like(seen.image)
            for blank in range(1, outage):
                measurer.measure(black, (k + blank) * PERIOD_NS, "progressive")
    assert never_slips_unseen(views, answers)
    assert [m.lock for m in answers[-3:]] == [Lock.FULL] * 3
    assert drift_pitches(views, answers)[-3:].max() < 0.05


def test_places_do_not_slide_over_a_picture_that_stands():
    """A jump of labels taken for a speed moved them on, picture by picture, under one number of the index."""
    views = film(at([(0.0, 0.0)] * 4), look=ALIKE, **SMALL)
    measurer = measurer_of(views[0].camera, views[0].lattice)
    for k in range(6):
        measurer.measure(views[k % 4].image, k * PERIOD_NS, "progressive")
    away = film(at([(0.45, 0.3)] * 8), look=ALIKE, **SMALL)
    answers = [measurer.measure(seen.image, (60 + k) * PERIOD_NS, "progressive")[0] for k, seen in enumerate(away)]
    assert len({m.index for m in answers}) == 1
    first = answers[0].tubes
    for m in answers[1:]:
        there = {(r, c): xy for r, c, xy in zip(m.tubes.row, m.tubes.column, m.tubes.center_px, strict=True)}
        assert all(
            np.hypot(*(there[r, c] - xy)) < 2.0
            for r, c, xy in zip(first.row, first.column, first.center_px, strict=True)
            if (r, c) in there
        )
        assert any((r, c) in there for r, c in zip(first.row, first.column, strict=True))
