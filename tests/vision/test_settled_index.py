"""An index in doubt that somebody settles who knows the tubes: what is told from then on, and what is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import CLEAN
from tests.scenes.rendered import PERIOD_NS, drift_pitches, film, follow, in_doubt, looking, measurer_of

PITCH_MM = 25.4
ALIKE = replace(CLEAN, plugged=0.0)
"""Every place looks like every other: no map settles anything."""
LEAP = 3
"""Pitches along a row, after a gap; a whole number shows in no picture."""


@pytest.fixture
def leapt():
    """A measurer after a leap in mid-gap, its views and answers so far, and the views that follow."""
    offsets = [0, 0, 0, LEAP, LEAP, LEAP, LEAP, LEAP]
    poses = [looking(6.0, at_mm=(PITCH_MM * k, 0.0)) for k in offsets]
    views = film(poses, look=ALIKE, size_px=(240, 180), pitch_px=24.0)
    times_ns = [(k + (30 if k >= 3 else 0)) * PERIOD_NS for k in range(len(views))]
    measurer = measurer_of(views[0].camera, views[0].lattice)
    answers = follow(views[:5], measurer, times_ns=times_ns[:5])
    assert in_doubt(answers).tolist() == [False] * 3 + [True] * 2
    assert round(drift_pitches(views[:5], answers)[-1]) == LEAP
    return measurer, views, times_ns, answers


def less_by(views, answers):
    """By how many rows and columns places are less in the last picture than in the first, by the truth."""
    first, last = ((v.rotation.T @ (m.pose.translation_mm - v.translation_mm))[:2] for v, m in
                   ((views[0], answers[0]), (views[len(answers) - 1], answers[-1])))  # fmt: skip
    lattice = views[0].lattice
    row, column = np.rint(lattice.lattice_coordinates((last - first)[None]))[0].astype(int).tolist()
    return row, column


def test_told_how_far_it_slipped_places_are_what_they_were_on_the_first_picture(leapt):
    measurer, views, times_ns, answers = leapt
    shift = less_by(views, answers)
    assert any(shift)
    assert measurer.settle_index(answers[-1].index, shift)
    answers += follow(views[5:], measurer, times_ns=times_ns[5:])
    assert not in_doubt(answers[5:]).any()
    assert drift_pitches(views, answers)[5:].max() < 0.1
    assert {m.index for m in answers[5:]} == {answers[0].index}


def test_where_that_is_not_known_places_stay_and_are_trusted(leapt):
    measurer, views, times_ns, answers = leapt
    assert measurer.settle_index(answers[-1].index, None)
    answers += follow(views[5:], measurer, times_ns=times_ns[5:])
    assert not in_doubt(answers[5:]).any()
    assert np.rint(drift_pitches(views, answers)[5:]).tolist() == [LEAP] * 3
    assert {m.index for m in answers[4:]} == {answers[-1].index}
    assert answers[-1].index != answers[0].index


def test_an_index_that_is_not_the_present_one_or_not_in_doubt_is_left_alone(leapt):
    measurer, views, times_ns, answers = leapt
    assert not measurer.settle_index(answers[0].index, (0, 0))
    assert not measurer.settle_index(answers[-1].index + 1, None)
    assert in_doubt(follow(views[5:6], measurer, times_ns=times_ns[5:6])).all()
    assert measurer.settle_index(answers[-1].index, None)
    assert not measurer.settle_index(answers[-1].index, None)
