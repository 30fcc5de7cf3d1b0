import json
from dataclasses import replace

import numpy as np
import pytest

from service.alignment.aligner import Aligner, AlignmentSettings
from service.alignment.bands import Bands
from service.alignment.conditions import alignment_conditions
from service.alignment.targets import NEAREST, Target, nearest_place, parse_anchor, parse_target, state_at
from service.alignment.verdict import Help, Verdict
from service.config.generators import Naming
from service.identity.anchors import Anchor, settle
from service.identity.counting import Growth, NamingRule
from service.identity.maps import load_map
from service.identity.names import NamingError
from service.vision.lattice import Arrangement, Lattice
from service.vision.measurement import Doubt, Lock, Measurement, Tubes, TubeState
from tests.alignment.scenes import CAMERA as CAM
from tests.alignment.scenes import LATTICE, geometry_of, guide_over, make_scene, measure, places_in_view, scattered

RULE = NamingRule(Naming.LINE_ROW, LATTICE, rows_along=False, rows_grow=Growth.DOWN, columns_grow=Growth.RIGHT)
FRAME_NS = 40_000_000
NOTHING = Measurement("progressive", Lock.NONE, "too dark", (), Tubes.none(), None, 0)


def view(offset=(0.0, 0.0), slope=(0.0, 0.0), *, target=(1, 2), time_ns=0, noise_px=0.03, seed=0):
    """A straight view of the sheet with the guide at an offset from a tube: measurement and geometry."""
    rng = np.random.default_rng(seed)
    R, t = np.eye(3), np.array([0.0, 0.0, 1000.0])
    places = places_in_view(CAM, LATTICE, R, t)
    tubes_mm = scattered(rng, LATTICE, places)
    guide = guide_over(R, t, tubes_mm[target][:2] + offset, slope, 15.0, np.diag([1e-6] * 3 + [1e-4] * 3))
    return measure(rng, CAM, LATTICE, R, t, places, tubes_mm, noise_px, CAM, time_ns), geometry_of(guide)


def aligner_for(geometry, target=NEAREST, **settings):
    return Aligner(AlignmentSettings(geometry, **settings), LATTICE, target)


def named_by(*anchors, generation=1, rule=RULE):
    return settle(rule, [Anchor(r, c, rule.parse(n)) for (r, c), n in anchors], np.eye(3), generation)


NAMED = named_by(((0, 0), "L83R87"))


def test_a_guide_over_its_tube_is_aligned_and_says_so_in_json():
    m, geometry = view((0.05, 0.0))
    found = aligner_for(geometry).update(m, NAMED, 0, generation=1)
    line = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert list(line)[:6] == ["target", "offset_mm", "sigma_mm", "parallelism_deg", "parallelism_sigma_deg", "verdict"]
    assert (line["target"], line["verdict"], line["quality"], line["place"]) == ("L88R88", "aligned", "good", [1, 2])
    assert line["offset_mm"] == pytest.approx([0.05, 0.0], abs=3 * line["sigma_mm"])
    assert line["sigma_mm"] < 0.1
    assert line["entry"]["clearance_mm"] == pytest.approx(0.584)
    assert found.entry.margin_mm > 0.3


def test_the_json_object_has_the_same_keys_whatever_is_known():
    m, geometry = view()
    aligner = aligner_for(geometry)
    lines = [aligner.update(x, None, 0).to_dict() for x in (m, NOTHING)]
    aligner.target = parse_target("L83R87", RULE)
    lines += [aligner.update(m, None, 0).to_dict(), aligner.update(m, None, 10**12, fresh=False).to_dict()]
    assert len({tuple(line) for line in lines}) == 1
    assert [line["verdict"] for line in lines] == ["aligned", "no lock", "cannot judge", "stale"]
    assert [line["quality"] for line in lines] == ["good", "bad", "uncertain", "stale"]
    assert all(json.dumps(line, allow_nan=False) for line in lines)


def test_a_target_by_name_by_place_and_the_nearest_are_the_same_tube():
    m, geometry = view((0.4, 0.3))
    for text in ("nearest", "1,2", "L88R88", "88/88"):
        found = aligner_for(geometry, parse_target(text, RULE)).update(m, NAMED, 0, generation=1)
        assert (found.place, str(found.name), found.verdict) == ((1, 2), "L88R88", Verdict.ADJUST)


def test_a_target_elsewhere_tells_the_way_to_it():
    m, geometry = view()
    found = aligner_for(geometry, parse_target("L92R88", RULE)).update(m, NAMED, 0, generation=1)
    assert found.place == (1, 4)
    assert found.judgement.advice == "right 51 mm"
    assert not found.entry.margin_mm > 0


def test_a_named_target_without_names_cannot_be_judged():
    m, geometry = view()
    aligner = aligner_for(geometry, parse_target("L88R88", RULE))
    found = aligner.update(m, None, 0)
    assert (found.verdict, found.judgement.helps) == (Verdict.CANNOT_JUDGE, (Help.ANCHOR,))
    assert "no anchor" in found.judgement.reasons[0]
    doubtful = replace(m, lock=Lock.PARTIAL, doubt=(Doubt.INDEX,))
    assert "index is in doubt" in aligner.update(doubtful, None, 0).judgement.reasons[0]
    assert found.to_dict()["target"] == "L88R88"


def test_a_place_of_another_index_is_another_tube():
    m, geometry = view()
    aligner = aligner_for(geometry, parse_target("1,2", RULE))
    assert aligner.update(m, None, 0, generation=1).verdict is Verdict.ALIGNED
    for other, generation in ((replace(m, index=1), 1), (m, 2)):
        found = aligner.update(other, None, 0, generation=generation)
        assert (found.verdict, found.judgement.helps) == (Verdict.CANNOT_JUDGE, (Help.TARGET,))


def test_a_tube_that_an_exact_map_does_not_have_is_no_target_and_an_approximate_one_only_marks_it():
    m, geometry = view()
    sheet = load_map("system80")
    for approximate, verdict in ((True, Verdict.ALIGNED), (False, Verdict.CANNOT_JUDGE)):
        rule = replace(RULE, map=replace(sheet, approximate=approximate, outer_radius_mm=600.0))
        named = named_by(((0, 0), "L83R87"), rule=rule)
        found = aligner_for(geometry, parse_target("L88R88", rule)).update(m, named, 0, generation=1)
        assert found.verdict is verdict
        assert (found.on_map, found.map_approximate) == ((False, True) if approximate else (None, None))


def test_a_picture_that_stays_the_same_is_stale_and_says_nothing_new():
    m, geometry = view()
    aligner = aligner_for(geometry)
    said, frames = [], []
    for k in range(20):
        found = aligner.update(replace(m, time_ns=k * FRAME_NS), None, k * FRAME_NS, fresh=k == 0)
        said.append(str(found.verdict))
        frames.append(found.parallelism and found.parallelism.frames)
    assert said == ["aligned"] * 13 + ["stale"] * 7
    assert frames == [1] * 13 + [None] * 7


def test_a_result_looked_at_later_is_stale():
    m, geometry = view()
    aligner = aligner_for(geometry, stale_after_s=0.5)
    found = aligner.update(m, None, 0)
    assert aligner.aged(found, 500_000_000).verdict is Verdict.ALIGNED
    old = aligner.aged(found, 1_300_000_000)
    assert (old.verdict, old.quality) == (Verdict.STALE, "stale")
    assert "1.3 s old" in old.judgement.reasons[0]
    assert old.lean is found.lean


def test_a_frame_that_is_late_is_stale_at_once():
    m, geometry = view()
    assert aligner_for(geometry).update(m, None, 600_000_000).verdict is Verdict.STALE


def test_hysteresis_belongs_to_its_target_and_to_a_lock():
    aligner = None
    said = []
    for offset in (0.3, 0.22, 0.1, 0.22):
        m, geometry = view((offset, 0.0), noise_px=0.001)
        aligner = aligner or aligner_for(geometry, bands=Bands(margin_sigmas=0.0))
        aligner.settings = replace(aligner.settings, geometry=geometry)
        said.append(str(aligner.update(m, None, 0).verdict))
    assert said == ["adjust", "adjust", "aligned", "aligned"]
    m, geometry = view((0.3, 0.0), noise_px=0.001)
    aligner.settings = replace(aligner.settings, geometry=geometry)
    assert aligner.update(m, None, 0).verdict is Verdict.ADJUST
    aligner.update(NOTHING, None, 0)
    m, geometry = view((0.22, 0.0), noise_px=0.001)
    aligner.settings = replace(aligner.settings, geometry=geometry)
    assert aligner.update(m, None, 0).verdict is Verdict.ALIGNED


def test_parallelism_is_averaged_and_begins_anew_after_a_lost_lock():
    m, geometry = view()
    aligner = aligner_for(geometry)
    for k in range(5):
        found = aligner.update(replace(m, time_ns=k * FRAME_NS), None, k * FRAME_NS)
    assert found.parallelism.frames == 5
    aligner.update(replace(NOTHING, time_ns=5 * FRAME_NS), None, 5 * FRAME_NS)
    assert aligner.update(replace(m, time_ns=6 * FRAME_NS), None, 6 * FRAME_NS).parallelism.frames == 1


def test_a_plugged_target_is_an_alarm():
    m, geometry = view()
    state = np.where((m.tubes.row == 1) & (m.tubes.column == 2), TubeState.PLUGGED, m.tubes.state).astype(np.uint8)
    found = aligner_for(geometry).update(replace(m, tubes=replace(m.tubes, state=state)), NAMED, 0, generation=1)
    assert (found.verdict, found.judgement.advice) == (Verdict.ADJUST, "choose another tube")
    (condition,) = alignment_conditions(found, Bands())
    assert (condition.key, condition.reason) == ("plugged", "target L88R88 is plugged")


@pytest.mark.parametrize("arrangement", Arrangement)
def test_the_nearest_tube_is_the_nearest(arrangement):
    lattice = Lattice(arrangement, 25.4, 8.4, 9.5)
    rng = np.random.default_rng(3)
    rows, columns = (v.ravel() for v in np.mgrid[-20:21, -20:21])
    sheet = lattice.sheet_points(rows, columns)
    for foot in rng.uniform(-150, 150, (100, 2)):
        i = int(np.argmin(np.linalg.norm(sheet - foot, axis=1)))
        assert nearest_place(foot, lattice, Tubes.none()) == (rows[i], columns[i])


def test_a_place_seen_to_have_no_tube_is_passed_over():
    m, _ = view()
    foot = LATTICE.sheet_points(np.array([1]), np.array([2]))[0] + [3.0, 0.0]
    state = np.where((m.tubes.row == 1) & (m.tubes.column == 2), TubeState.ABSENT, m.tubes.state).astype(np.uint8)
    assert nearest_place(foot, LATTICE, replace(m.tubes, state=state)) == (1, 3)
    assert state_at(m.tubes, (1, 2)) is TubeState.OPEN
    assert state_at(m.tubes, (999, 2)) is TubeState.UNKNOWN


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("nearest", NEAREST),
        ("Nearest ", NEAREST),
        ("-3, 12", Target(place=(-3, 12))),
        ("l83 r87", Target(name=RULE.parse("L83R87"))),
    ],
)
def test_targets_are_read(text, target):
    assert parse_target(text, RULE) == target
    assert parse_target(str(target), RULE) == target


@pytest.mark.parametrize("text", ["", "nearest tube", "1,2,3", "L83R88", "1.5,2"])
def test_what_is_no_target_is_refused(text):
    with pytest.raises(NamingError):
        parse_target(text, RULE)


def test_anchors_are_read_and_refused():
    assert parse_anchor("-3,12=L83R87", RULE) == Anchor(-3, 12, RULE.parse("L83R87"))
    for text, words in (
        ("3=L83R87", "ROW,COLUMN=NAME"),
        ("3,4", "ROW,COLUMN"),
        ("3,4=L83R88", "even"),
        ("3,4=", "read"),
    ):
        with pytest.raises(NamingError, match=words):
            parse_anchor(text, RULE)


class TestConditions:
    def of(self, found, bands=None):
        return [c.key for c in alignment_conditions(found, bands or Bands())]

    def test_an_aligned_guide_raises_nothing(self):
        m, geometry = view()
        assert self.of(aligner_for(geometry).update(m, None, 0)) == []

    def test_off_a_chosen_tube_is_an_alarm_with_the_way_to_go(self):
        m, geometry = view((0.9, 0.0))
        found = aligner_for(geometry, parse_target("1,2", RULE)).update(m, None, 0)
        entry, offset = alignment_conditions(found, Bands())
        assert (entry.key, offset.key, offset.limit, offset.unit) == ("entry", "offset", 0.5, "mm")
        assert offset.value == pytest.approx(0.9, abs=0.1)
        assert "left 0." in offset.todo

    def test_the_nearest_tube_is_passed_not_missed(self):
        m, geometry = view((0.9, 0.0))
        assert self.of(aligner_for(geometry).update(m, None, 0)) == []

    def test_a_leaning_guide_and_arm(self):
        m, geometry = view(slope=(0.03, 0.0))
        found = aligner_for(geometry, parse_target("1,2", RULE)).update(m, None, 0)
        assert self.of(found) == ["entry", "tilt", "parallelism"]

    def test_what_is_wrong_with_the_picture_comes_alone(self):
        m, geometry = view((9.0, 0.0))
        aligner = aligner_for(geometry, parse_target("1,2", RULE))
        assert self.of(aligner.update(m, None, 10**12)) == ["stale"]
        assert self.of(aligner.update(NOTHING, None, 0)) == ["no-lock"]
        aligner.target = parse_target("L83R87", RULE)
        (condition,) = alignment_conditions(aligner.update(m, None, 0), Bands())
        assert (condition.key, condition.todo) == ("cannot-judge", "anchor a tube")

    def test_an_index_in_doubt_asks_for_no_anchor_that_would_be_turned_away(self):
        m, geometry = view()
        doubtful = replace(m, doubt=(Doubt.INDEX,))
        aligner = aligner_for(geometry, parse_target("L83R87", RULE))
        (condition,) = alignment_conditions(aligner.update(doubtful, None, 0), Bands())
        assert "the lattice index is in doubt" in condition.reason
        assert condition.todo.startswith("move back to where the index was certain")


def test_offsets_of_moving_truth_scenes_stay_within_two_sigma():
    """Through the whole of `Aligner`, whichever tube it takes for the nearest."""
    within = []
    for seed in range(100):
        scene, target, lattice = make_scene(seed)
        aligner = Aligner(AlignmentSettings(scene.geometry), lattice)
        found = aligner.update(scene.measurement, None, 0)
        assert found.place == target
        error = found.lean.offset_mm - scene.truth(target)[:2]
        within.extend(np.abs(error) < 2 * np.sqrt(np.diag(found.lean.covariance)[:2]))
    assert 0.9 < np.mean(within) < 0.99
