import itertools
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.alignment.consistency import (
    LIMIT,
    Agreement,
    LatticeStatement,
    Source,
    Verdict,
    check_consistency,
)
from service.vision.camera import Camera
from service.vision.measurement import Pose, PoseSigma

D, F = 1200.0, 10.0
CAMERA, LENS, RANGE, RATIO = 0.01, 0.02, 0.005, 0.004
"""Relative sigmas of the camera's f, the lens's f, the range, and of D/f."""


def lattice(f=F, d=D, s_camera=CAMERA, s_ratio=RATIO):
    return LatticeStatement(d, d * math.hypot(s_camera, s_ratio), f, f * s_camera)


def lens(f=F, s=LENS):
    return f, f * s


def finder(d=D, s=RANGE):
    return d, d * s


def verdict(*statements):
    found = check_consistency(*statements)
    return found.verdict, found.odd


def test_three_that_say_the_same_agree():
    found = check_consistency(lattice(), lens(), finder())
    assert (found.verdict, found.odd, len(found.pairs)) == (Verdict.AGREEMENT, None, 3)
    assert "lattice and lens agree (0.0 %, limit 6.9 %)" in found.text


@pytest.mark.parametrize(("s_ratio", "counted"), [(0.01, 0.01), (0.0, RATIO)])
def test_what_two_share_falls_out_of_their_pair(s_ratio, counted):
    found = check_consistency(lattice(s_ratio=s_ratio), lens(), finder())
    assert [pair.sigma for pair in found.pairs] == pytest.approx(
        [math.hypot(CAMERA, LENS), math.hypot(CAMERA, s_ratio, RANGE), math.hypot(counted, LENS, RANGE)]
    )


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_the_odd_one_out_is_named_with_its_differences_and_their_limits(factor):
    # a camera file of another zoom: its f is off, and with it the lattice's distance
    found = check_consistency(lattice(F * factor, D * factor), lens(), finder())
    assert (found.verdict, found.odd) == (Verdict.ODD_ONE_OUT, Source.LATTICE)
    assert verdict(lattice(), lens(F * factor), finder()) == (Verdict.ODD_ONE_OUT, Source.LENS)
    assert verdict(lattice(), lens(), finder(D * factor)) == (Verdict.ODD_ONE_OUT, Source.RANGE_FINDER)
    assert "lattice is the odd one out" in found.text
    assert "25.0 %, limit 6.9 %" in found.text


def test_a_wrong_pitch_looks_like_a_lone_range_finder_and_the_text_says_so():
    found = check_consistency(lattice(d=D * 1.2), lens(), finder())
    assert (found.verdict, found.odd) == (Verdict.ODD_ONE_OUT, Source.RANGE_FINDER)
    assert "pitch or lattice" in found.text


def test_three_that_all_differ_disagree_and_none_is_named():
    found = check_consistency(lattice(), lens(F * 1.3), finder(D * 0.7))
    assert (found.verdict, found.odd) == (Verdict.DISAGREEMENT, None)
    assert "cannot be told" in found.text


def test_one_that_agrees_with_two_that_differ_settles_nothing():
    # 3 sigma of lattice against range finder is 3.6 %; the lens is too uncertain to side with either
    assert verdict(lattice(), lens(F * 1.02), finder(D * 1.04)) == (Verdict.DISAGREEMENT, None)


def test_two_can_only_agree_or_disagree():
    assert verdict(lattice(), lens(), None) == (Verdict.AGREEMENT, None)
    assert verdict(lattice(), lens(F * 1.2), None) == (Verdict.DISAGREEMENT, None)
    assert verdict(lattice(), None, finder()) == (Verdict.AGREEMENT, None)
    assert verdict(lattice(), None, finder(D * 1.2)) == (Verdict.DISAGREEMENT, None)


@pytest.mark.parametrize(
    "statements",
    [
        (None, None, None),
        (lattice(), None, None),
        (None, lens(), finder()),
        (lattice(d=math.nan), lens(), finder()),
        (lattice(f=0.0), lens(), finder()),
        (lattice(), (0.0, 1.0), None),
        (lattice(), (math.nan, 1.0), (D, math.nan)),
        (lattice(), None, (math.inf, 1.0)),
        (lattice(), None, (D, -1.0)),
    ],
)
def test_what_says_nothing_is_not_compared(statements):
    found = check_consistency(*statements)
    assert (found.verdict, found.odd, found.pairs) == (Verdict.CANNOT_TELL, None, ())


def test_what_is_too_vague_to_differ_is_no_agreement():
    found = check_consistency(lattice(s_camera=0.1), lens(), None)
    assert [pair.agreement for pair in found.pairs] == [Agreement.VAGUE]
    assert (found.verdict, found.text) == (Verdict.CANNOT_TELL, "too uncertain to be compared")
    assert verdict(lattice(s_camera=0.1), lens(F * 1.5), None) == (Verdict.DISAGREEMENT, None)


def test_without_a_camera_file_lens_and_range_finder_still_check_each_other_through_the_picture():
    for s_camera in (0.3, math.inf):
        free = LatticeStatement(D * 1.5, D * s_camera, F * 1.5, F * s_camera)
        assert verdict(free, lens(), finder()) == (Verdict.AGREEMENT, None)
        assert verdict(free, lens(F * 1.2), finder()) == (Verdict.DISAGREEMENT, None)


@given(*[st.floats(0.5, 2.0)] * 3, *[st.floats(0.0, 0.1)] * 4)
def test_pairs_close_their_triangle_and_scale_changes_nothing(a, b, c, s_camera, s_lens, s_range, s_ratio):
    statements = lattice(F * a, D * a, s_camera, s_ratio), lens(F * b, s_lens), finder(D * c, s_range)
    found = check_consistency(*statements)
    x, y, z = (pair.difference for pair in found.pairs)
    assert y == pytest.approx(x + z, abs=1e-12)
    assert all(pair.sigma >= 0 for pair in found.pairs)
    first = statements[0]
    inch = LatticeStatement(
        first.distance_mm / 25.4, first.distance_sigma_mm / 25.4, first.focal_length_mm, first.focal_sigma_mm
    )
    again = check_consistency(inch, statements[1], (D * c / 25.4, D * c * s_range / 25.4))
    assert [p.difference for p in again.pairs] == pytest.approx([p.difference for p in found.pairs], abs=1e-12)


def trials(count, wrong=None, by_sigmas=0.0):
    """Verdicts in per cent where the sigmas hold, with one of the three off by so many sigmas of its wider pair."""
    rng = np.random.default_rng(4)
    s_lattice = math.hypot(CAMERA, RATIO)
    pairs = {
        (Source.LATTICE, Source.LENS): math.hypot(CAMERA, LENS),
        (Source.LATTICE, Source.RANGE_FINDER): math.hypot(s_lattice, RANGE),
        (Source.LENS, Source.RANGE_FINDER): math.hypot(RATIO, LENS, RANGE),
    }
    off = math.exp(by_sigmas * max((s for pair, s in pairs.items() if wrong in pair), default=0.0))
    found = Counter()
    for q, camera, zoom, measured in np.exp(rng.normal(0, [RATIO, CAMERA, LENS, RANGE], (count, 4))):
        f = F * camera * (off if wrong is Source.LATTICE else 1)
        found[verdict(
            lattice(f, D / F * q * f),
            lens(F * zoom * (off if wrong is Source.LENS else 1)),
            finder(D * measured * (off if wrong is Source.RANGE_FINDER else 1)),
        )] += 100 / count  # fmt: skip
    return found


def test_false_alarms_are_as_rare_as_the_module_says():
    found = trials(20_000)
    assert found[Verdict.AGREEMENT, None] == pytest.approx(99.3, abs=0.2)
    assert sum(found[Verdict.ODD_ONE_OUT, source] for source in Source) < 0.2


@pytest.mark.parametrize("wrong", Source)
def test_an_error_of_five_sigmas_is_named_as_often_as_the_module_says(wrong):
    found = trials(5_000, wrong, 5.0)
    assert found[Verdict.ODD_ONE_OUT, wrong] == pytest.approx(97.3, abs=1.0)
    assert sum(found[Verdict.ODD_ONE_OUT, source] for source in Source if source is not wrong) < 0.4


def test_no_agreement_is_told_beyond_its_limit():
    for a, b, c in itertools.product([0.9, 0.97, 1.0, 1.03, 1.1], repeat=3):
        found = check_consistency(lattice(F * a, D * a), lens(F * b), finder(D * c))
        worst = max(abs(p.difference) / p.sigma for p in found.pairs)
        assert (found.verdict is Verdict.AGREEMENT) == (worst <= LIMIT)


def test_a_pose_states_its_distance_along_the_optical_axis():
    tilt = math.radians(30)
    rotation = np.array([[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]])
    camera = Camera((640, 480), (0.005, 0.005), F)
    sigma = PoseSigma(1.0, 2.0, 0.1, 0.1, 0.05)
    pose = Pose(rotation, np.array([0.0, 0.0, 1000.0]), camera, np.zeros((6, 6)), sigma, 0.1)
    stated = LatticeStatement.of(pose)
    assert stated.distance_mm == pytest.approx(1000.0)  # the origin lies on the axis
    assert stated.distance_sigma_mm == pytest.approx(2.0 / math.cos(tilt))
    assert (stated.focal_length_mm, stated.focal_sigma_mm) == (F, 0.05)
    unknown = Pose(rotation, pose.translation_mm, Camera((640, 480), (0.005, 0.005)), np.zeros((6, 6)), sigma, 0.1)
    assert LatticeStatement.of(unknown) is None
