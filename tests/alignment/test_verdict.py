import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.alignment.bands import Bands, Grade, graded, too_large
from service.alignment.entry import entry
from service.alignment.geometry import Lean, TubeEnd
from service.alignment.verdict import Help, Judgement, Sight, Verdict, judge, picture_axes
from service.vision.measurement import Doubt, Lock, TubeState
from tests.alignment.scenes import geometry_of, guide_over, turned
from tests.fakes.results import make_measurement, make_pose

BANDS = Bands()
GEOMETRY = geometry_of(guide_over(np.eye(3), np.array([0, 0, 1000.0]), (0, 0)))
PARTS = ("pose", "guide", "tube", "pitch")


def sight(
    offset=(0.0, 0.0), tilt=(0.0, 0.0), *, sigma_mm=0.03, sigma_deg=0.03, gap_mm=10.0, source="pose", doubt=(), **more
):
    """A sight with that offset (mm, at the sheet) and tilt (deg); all its sigma from one source."""
    covariance = np.diag([sigma_mm**2, sigma_mm**2, *[np.radians(sigma_deg) ** 2] * 2, 0.01])
    parts = {name: covariance if name == source else np.zeros((5, 5)) for name in PARTS}
    lean = Lean(np.array(offset), np.tan(np.radians(tilt)), gap_mm, covariance, parts)
    tube = TubeEnd(0, 0, np.zeros(2), np.zeros((2, 2)), measured=True)
    m = make_measurement(Lock.PARTIAL if doubt else Lock.FULL, doubt=doubt, tilt_deg=0.0)
    return Sight(m, lean=lean, entry=entry(lean, tube, GEOMETRY), **more)


@pytest.mark.parametrize(
    ("offset", "tilt", "verdict", "grade"),
    [
        (0.0, 0.0, "aligned", Grade.NORMAL),
        (0.25, 0.0, "aligned", Grade.NORMAL),
        (0.26, 0.0, "adjust", Grade.ADVISORY),
        (0.50, 0.0, "adjust", Grade.ADVISORY),
        (0.51, 0.0, "adjust", Grade.ALARM),
        (9.00, 0.0, "adjust", Grade.ALARM),
        (0.0, 0.5, "aligned", Grade.NORMAL),
        (0.0, 0.6, "adjust", Grade.ADVISORY),
        (0.0, 1.1, "adjust", Grade.ALARM),
        (0.24, 0.49, "aligned", Grade.NORMAL),
    ],
)
def test_bands_grade_what_goes_in(offset, tilt, verdict, grade):
    found = judge(sight((0.0, offset), (0.0, tilt), gap_mm=5.0), BANDS, None)
    assert (str(found.verdict), found.grade) == (verdict, grade)
    assert bool(found.advice) == bool(found.reasons) == (verdict == "adjust")


def test_the_entry_rule_decides_before_the_bands():
    """0.2 mm and 0.45 deg are in their bands, but over a gap of 60 mm the nose would touch."""
    found = judge(sight((0.2, 0.0), (0.0, 0.45), gap_mm=60.0), BANDS, None)
    assert (found.offset_grade, found.tilt_grade) == (Grade.NORMAL, Grade.NORMAL)
    assert (found.verdict, found.entry_grade) == (Verdict.ADJUST, Grade.ALARM)
    assert "would touch: margin -0" in found.reasons[0]


def test_a_margin_within_its_uncertainty_is_no_margin():
    found = judge(sight((0.24, 0.0), sigma_mm=0.19), BANDS, None)
    assert (found.verdict, found.entry_grade) == (Verdict.ADJUST, Grade.ADVISORY)
    assert "might touch" in found.reasons[0]


@pytest.mark.parametrize(
    ("change", "reason", "helps"),
    [
        ({"sigma_mm": 0.21}, "offset is uncertain by 0.21 mm", [Help.ZOOM_IN]),
        ({"sigma_mm": np.nan}, "offset is uncertain", None),
        ({"sigma_deg": 0.3}, "tilt is uncertain by 0.30 deg", [Help.ZOOM_IN]),
        ({"sigma_mm": 0.3, "source": "guide"}, "offset", [Help.ALIGN_SETUP]),
        ({"sigma_mm": 0.3, "source": "pitch"}, "offset", [Help.PITCH]),
        ({"sigma_mm": 0.3, "doubt": (Doubt.LIGHT,)}, "offset", [Help.LIGHT]),
        ({"sigma_mm": 0.3, "doubt": (Doubt.FOCUS,)}, "offset", [Help.FOCUS]),
        ({"doubt": (Doubt.INDEX,)}, "index is in doubt", [Help.INDEX]),
        ({"doubt": (Doubt.SCALE,)}, "scale is in doubt", [Help.CALIBRATE]),
        ({"doubt": (Doubt.CALIBRATION, Doubt.LIGHT)}, "calibration", [Help.CALIBRATE, Help.LIGHT]),
        ({"obstacle": ("which tube is L83R87: no anchor", Help.ANCHOR)}, "which tube", [Help.ANCHOR]),
    ],
)
def test_what_cannot_be_judged_is_neither_aligned_nor_misaligned_and_says_what_would_help(change, reason, helps):
    for offset in ((0.0, 0.0), (0.4, 0.0), (3.0, 0.0)):
        found = judge(sight(offset, **change), BANDS, None)
        assert found.verdict is Verdict.CANNOT_JUDGE
        assert (found.grade, found.advice) == (None, "")
        assert reason in found.reasons[0]
        assert helps is None or list(found.helps) == helps


def test_a_wide_sigma_of_an_unknown_focal_length_asks_for_calibration():
    made = sight(sigma_mm=0.3)
    pose = replace(made.measurement.pose, sigma=replace(made.measurement.pose.sigma, focal_length_mm=0.5))
    made = replace(made, measurement=replace(made.measurement, pose=pose))
    assert judge(made, BANDS, None).helps == (Help.CALIBRATE,)


@pytest.mark.parametrize("doubt", [(Doubt.LIGHT,), (Doubt.FOCUS,)])
def test_poor_light_alone_forbids_nothing_that_its_sigma_allows(doubt):
    assert judge(sight(doubt=doubt), BANDS, None).verdict is Verdict.ALIGNED


def test_without_a_lock_the_reason_is_told():
    found = judge(Sight(make_measurement(Lock.NONE, reason="only 3 tubes are seen")), BANDS, None)
    assert (found.verdict, found.reasons) == (Verdict.NO_LOCK, ("only 3 tubes are seen",))
    assert found.helps


def test_a_stale_picture_is_stale_whatever_it_shows():
    for made in (sight(), sight((5.0, 0.0)), Sight(make_measurement(Lock.NONE))):
        assert judge(replace(made, stale=True), BANDS, None).verdict is Verdict.STALE


def test_a_guide_that_points_elsewhere_is_set_up_wrongly():
    found = judge(replace(sight(), lean=None, entry=None), BANDS, None)
    assert (found.verdict, found.helps) == (Verdict.CANNOT_JUDGE, (Help.ALIGN_SETUP,))


@pytest.mark.parametrize(("state", "word"), [(TubeState.PLUGGED, "plugged"), (TubeState.ABSENT, "no tube")])
def test_a_plugged_or_missing_target_is_an_alarm_however_well_aligned(state, word):
    found = judge(sight(state=state), BANDS, None)
    assert (found.verdict, found.grade, found.helps) == (Verdict.ADJUST, Grade.ALARM, (Help.TARGET,))
    assert word in found.reasons[0]
    assert found.advice == "choose another tube"


@given(
    offset=st.floats(0, 2), tilt=st.floats(0, 3), sigma_mm=st.floats(1e-3, 1), sigma_deg=st.floats(1e-3, 1),
    gap=st.floats(0, 60), doubt=st.sampled_from([(), *((d,) for d in Doubt)]),
    state=st.sampled_from(TubeState), stale=st.booleans(), before=st.sampled_from([None, Grade.NORMAL, Grade.ALARM]),
)  # fmt: skip
def test_aligned_is_never_said_where_anything_speaks_against_it(
    offset, tilt, sigma_mm, sigma_deg, gap, doubt, state, stale, before
):
    made = sight(
        (offset, 0.0), (0.0, tilt), sigma_mm=sigma_mm, sigma_deg=sigma_deg, gap_mm=gap, doubt=doubt, state=state,
        stale=stale,
    )  # fmt: skip
    memory = before if before is None else Judgement(Verdict.ADJUST, (), (), "", "", before, before, before)
    if judge(made, BANDS, memory).verdict is Verdict.ALIGNED:
        assert not stale
        assert state not in (TubeState.PLUGGED, TubeState.ABSENT)
        assert not set(doubt) & {Doubt.INDEX, Doubt.SCALE, Doubt.CALIBRATION}
        assert offset <= 0.25 + 1e-9
        assert tilt <= 0.5 + 1e-9
        assert sigma_mm <= 0.2 + 1e-9
        assert sigma_deg <= 0.25 + 1e-9
        assert made.entry.margin_mm >= 2 * made.entry.margin_sigma_mm


def test_a_grade_gets_worse_at_once_and_better_only_by_the_hysteresis():
    grades, before = [], None
    for value in (0.24, 0.26, 0.24, 0.21, 0.20, 0.24, 0.51, 0.46, 0.45, 0.0):
        before = graded(value, 0.25, 0.5, 0.05, before)
        grades.append(int(before))
    assert grades == [0, 1, 1, 1, 0, 0, 2, 2, 1, 0]


@given(
    values=st.lists(st.floats(0, 1), min_size=1),
    normal=st.floats(0.1, 0.4),
    more=st.floats(0.01, 0.4),
    hysteresis=st.floats(0, 0.1),
)
def test_a_grade_is_never_better_than_its_value(values, normal, more, hysteresis):
    before = None
    for value in values:
        before = graded(value, normal, normal + more, hysteresis, before)
        assert before >= graded(value, normal, normal + more, hysteresis, None)
        if value + hysteresis <= normal:
            assert before is Grade.NORMAL


def test_a_value_that_is_no_number_is_the_worst_and_its_sigma_too_large():
    assert graded(float("nan"), 1, 2, 0.1, None) is Grade.ALARM
    assert too_large(float("nan"), 1.0, before=False)


def test_a_sigma_that_was_too_large_must_fall_clearly():
    assert [too_large(s, 0.2, before=b) for s, b in ((0.2, False), (0.21, False), (0.19, True), (0.18, True))] == [
        False,
        True,
        True,
        False,
    ]
    unsure = judge(sight(sigma_mm=0.21), BANDS, None)
    assert judge(sight(sigma_mm=0.19), BANDS, unsure).verdict is Verdict.CANNOT_JUDGE
    assert judge(sight(sigma_mm=0.17), BANDS, unsure).verdict is Verdict.ALIGNED


def test_aligned_stays_aligned_up_to_the_limit_and_comes_back_only_below_it():
    found, said = None, []
    for offset in (0.30, 0.22, 0.19, 0.24, 0.26, 0.22):
        found = judge(sight((0.0, offset)), BANDS, found)
        said.append(str(found.verdict))
    assert said == ["adjust", "adjust", "aligned", "aligned", "adjust", "adjust"]


@pytest.mark.parametrize(
    ("offset", "advice"),
    [
        ((0.8, 0.0), "left 0.80 mm"),
        ((-0.8, 0.02), "right 0.80 mm"),
        ((0.0, 0.4), "up 0.40 mm"),
        ((0.3, -2.04), "down 2.0 mm, left 0.30 mm"),
        ((-30.0, 0.0), "right 30 mm"),
    ],
)
def test_the_way_to_go_is_told_as_the_picture_shows_it(offset, advice):
    found = judge(sight(offset), BANDS, None)
    assert found.advice == advice
    assert found.advice_sheet == f"X {-offset[0]:+.2f} mm, Y {-offset[1]:+.2f} mm"


def test_the_way_turns_with_the_picture():
    for quarter, way in enumerate(("left", "up", "right", "down")):
        made = sight((0.8, 0.0))
        pose = replace(make_pose(0.0), rotation=turned([0, 0, quarter * np.pi / 2]))
        made = replace(made, measurement=replace(made.measurement, pose=pose))
        assert judge(made, BANDS, None).advice == f"{way} 0.80 mm"


def test_a_lean_is_told_as_where_to_point():
    assert judge(sight(tilt=(0.8, 0.0)), BANDS, None).advice == "point left 0.80 deg"
    assert judge(sight((0.0, 0.9), (0.0, -1.5)), BANDS, None).advice == "up 0.90 mm; point down 1.5 deg"


def test_picture_axes_lie_in_the_sheet_at_a_right_angle():
    for turn in itertools.product((0.0, 0.3), (-0.2, 0.4), (1.0, 3.0)):
        axes = picture_axes(replace(make_pose(), rotation=turned(turn)))
        assert axes @ axes.T == pytest.approx(np.eye(2))
        assert np.linalg.det(axes) == pytest.approx(1.0)
