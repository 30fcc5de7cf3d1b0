import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.config.generators import Naming, load_generator
from service.identity.anchors import Anchor, settle
from service.identity.counting import Growth, NamingRule, all_countings, is_staggered
from service.identity.namer import TubeNamer
from service.identity.names import NamingError, TubeName
from service.vision.lattice import Arrangement, Lattice
from service.vision.measurement import Doubt, Lock
from tests.fakes.results import make_measurement, make_pose

places = st.tuples(st.integers(-60, 60), st.integers(-60, 60))
SYSTEM80 = NamingRule(Naming.LINE_ROW, load_generator("system80").lattice)
MODEL_F = NamingRule(Naming.ROW_COLUMN, load_generator("model-f").lattice)


def rolled(angle_deg):
    """camera_from_sheet of a camera turned about the sheet's normal: the sheet's X points `angle_deg` below right."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def rule_of(arrangement, naming=Naming.ROW_COLUMN, **more):
    return NamingRule(naming, Lattice(arrangement, 25.4, 8.4, 9.5), **more)


@pytest.mark.parametrize("arrangement", Arrangement)
@pytest.mark.parametrize("rows_along", [True, False])
def test_there_are_as_many_ways_to_count_as_the_lattice_has_symmetries_each_another(arrangement, rows_along):
    ways = all_countings(rule_of(arrangement, rows_along=rows_along))
    assert len({w.matrix.tobytes() for w in ways}) == len(ways) == 2 * arrangement.symmetry
    assert sum(w.mirrored for w in ways) == arrangement.symmetry


@given(
    arrangement=st.sampled_from(Arrangement), along=st.booleans(), way=st.integers(0, 11), origin=places, place=places
)
def test_every_place_has_a_name_of_its_own_and_the_name_its_place(arrangement, along, way, origin, place):
    rule = rule_of(arrangement, rows_along=along)
    ways = all_countings(rule)
    counting = ways[way % len(ways)].through(origin, TubeName(rule.naming, 400, 400))
    row, column = counting.numbers(np.array([place[0]]), np.array([place[1]]))[0].tolist()
    assert counting.place(TubeName(rule.naming, row, column)) == place
    if is_staggered(rule.lattice):
        assert (row + column) % 2 == 0
        assert counting.place(TubeName(rule.naming, row + 1, column)) is None


@given(way=st.integers(0, 11), origin=places, place=places)
def test_no_anchor_of_even_parity_ever_names_a_system_80_tube_of_odd_parity(way, origin, place):
    counting = all_countings(SYSTEM80)[way].through(origin, TubeName(Naming.LINE_ROW, 87, 83))
    assert counting.numbers(*(np.array([i]) for i in place)).sum() % 2 == 0


def test_a_system_80_counts_as_its_drawings_do():
    """x = (L - 83) 0.866 p, y = y1 + (r - 1) p / 2: neighbours in a line differ by 2, in the next line by 1."""
    rule = replace(SYSTEM80, rows_grow=Growth.UP, columns_grow=Growth.RIGHT)
    named = settle(rule, [Anchor(3, -2, rule.parse("L83R87"))], rolled(30), 1)

    def sheet(text):
        return rule.lattice.sheet_points(*(np.array([i]) for i in named.place_of(rule.parse(text))))[0]

    def picture(text):
        return (rolled(30)[:2, :2] @ (sheet(text) - sheet("L83R87"))).round(3).tolist()

    p = 25.4
    assert picture("L83R89") == pytest.approx([0, -p], abs=2e-3)
    assert picture("L84R88") == pytest.approx([p * math.sqrt(0.75), -p / 2], abs=2e-3)
    assert picture("L82R86") == pytest.approx([-p * math.sqrt(0.75), p / 2], abs=2e-3)
    assert str(named.name_of(3, -2)) == "L83R87"


@given(
    arrangement=st.sampled_from(Arrangement),
    along=st.booleans(),
    truth=st.integers(0, 11),
    others=st.lists(places, min_size=3, max_size=5, unique=True),
)
def test_three_tubes_not_in_one_line_settle_everything(arrangement, along, truth, others):
    rule = rule_of(arrangement, rows_along=along)
    ways = all_countings(rule)
    true = ways[truth % len(ways)].through((0, 0), TubeName(rule.naming, 400, 400))
    names = [TubeName(rule.naming, *true.numbers(np.array([r]), np.array([c]))[0].tolist()) for r, c in others]
    anchors = [Anchor(r, c, name) for (r, c), name in zip(others, names, strict=True)]
    if np.linalg.matrix_rank(np.diff(np.array(others), axis=0)) == 2:
        assert settle(rule, anchors, np.eye(3), 1).counting.matrix.tolist() == true.matrix.tolist()
    else:
        with pytest.raises(NamingError, match="ways to count fit"):
            settle(rule, anchors, np.eye(3), 1)


@pytest.mark.parametrize(
    ("rows_grow", "columns_grow", "mirrored"),
    [("up", "right", True), ("up", "left", False), ("down", "right", False), ("left", "up", True)],
)
def test_handedness_follows_from_where_the_numbers_grow(rows_grow, columns_grow, mirrored):
    rule = replace(MODEL_F, rows_grow=Growth(rows_grow), columns_grow=Growth(columns_grow))
    assert rule.mirrored is mirrored
    named = settle(rule, [Anchor(0, 0, rule.parse("R30C60"))], np.eye(3), 1)
    for text, growth in (("R31C60", rows_grow), ("R30C61", columns_grow)):
        row, column = named.place_of(rule.parse(text))
        assert [column, row] == Growth(growth).direction.tolist()


@pytest.mark.parametrize("roll_deg", [-25, -10, 10, 25])
def test_one_anchor_follows_the_picture_however_the_first_frame_laid_the_axes(roll_deg):
    rule = replace(MODEL_F, rows_grow=Growth.UP, columns_grow=Growth.RIGHT)
    for quarter in range(4):
        named = settle(rule, [Anchor(0, 0, rule.parse("R30C60"))], rolled(roll_deg + 90 * quarter), 1)
        row, column = named.place_of(rule.parse("R30C61"))
        assert rolled(roll_deg + 90 * quarter)[0, :2] @ [column, row] == pytest.approx(math.cos(math.radians(roll_deg)))


def test_a_picture_turned_so_far_that_two_ways_fit_is_not_guessed_at():
    rule = replace(MODEL_F, rows_grow=Growth.UP, columns_grow=Growth.RIGHT)
    anchor = Anchor(0, 0, rule.parse("R30C60"))
    with pytest.raises(NamingError, match="anchor another tube"):
        settle(rule, [anchor], rolled(44), 1)
    named = settle(rule, [anchor, Anchor(-1, 0, rule.parse("R31C60"))], rolled(44), 1)
    assert str(named.name_of(0, 1)) == "ROW30 COL61"


def test_one_anchor_without_directions_says_what_is_missing():
    with pytest.raises(NamingError, match=r"8 ways to count .* rows_grow and columns_grow .* or anchor two more tubes"):
        settle(MODEL_F, [Anchor(0, 0, MODEL_F.parse("R30C60"))], np.eye(3), 1)


def test_anchors_that_contradict_each_other_are_refused_and_named():
    anchors = [Anchor(0, 0, MODEL_F.parse("R30C60")), Anchor(0, 5, MODEL_F.parse("R30C66"))]
    with pytest.raises(NamingError, match=r"0,0=ROW30 COL60, 0,5=ROW30 COL66: no way to count"):
        settle(MODEL_F, anchors, np.eye(3), 1)


def test_the_wrong_leg_shows_by_its_handedness():
    rule = replace(MODEL_F, rows_grow=Growth.UP, columns_grow=Growth.RIGHT)
    mirrored = [("R30C60", 0, 0), ("R31C60", -1, 0), ("R30C61", 0, -1)]
    with pytest.raises(NamingError, match=r"mirrored, .* is this the leg that is set"):
        settle(rule, [Anchor(r, c, rule.parse(text)) for text, r, c in mirrored], np.eye(3), 1)


def test_an_anchor_of_odd_parity_is_refused():
    with pytest.raises(NamingError, match="must be even"):
        settle(SYSTEM80, [Anchor(0, 0, TubeName(Naming.LINE_ROW, 88, 83))], np.eye(3), 1)


def test_a_tube_that_falls_between_says_so():
    rule = rule_of(Arrangement.TRIANGULAR, rows_grow=Growth.UP, columns_grow=Growth.RIGHT)
    named = settle(rule, [Anchor(0, 0, rule.parse("R30C60"))], rolled(30), 1)
    with pytest.raises(NamingError, match=r"ROW30 COL61: falls between tubes as counted from 0,0=ROW30 COL60"):
        named.place_of(rule.parse("R30C61"))


def test_places_before_the_first_row_have_no_name():
    rule = replace(MODEL_F, rows_grow=Growth.UP, columns_grow=Growth.RIGHT)
    named = settle(rule, [Anchor(0, 0, rule.parse("R1C60"))], np.eye(3), 1)
    assert named.names_of(np.array([-1, 0, 1]), np.array([0, 0, 0]))[1:] == [rule.parse("R1C60"), None]


@pytest.mark.shared
def test_the_landmarks_of_rendered_pictures_name_each_other(shared):
    """One landmark's text, taken for an anchor, gives the others the names that are painted on them."""
    told = 0
    for path in sorted((shared / "bowl" / "stills").glob("*.json")):
        truth = json.loads(path.read_text())
        unwrapped = [m for m in truth["landmarks"] if m["text"] == f"L{m['col'] + 83}R{m['row'] + 87}"]
        if len(unwrapped) < 2:
            continue
        triangular = truth["pattern"] == "triangular"
        lattice = Lattice(Arrangement(truth["pattern"]), truth["pitch_mm"], 7, 8)
        rule = NamingRule(Naming.LINE_ROW, lattice, False, Growth.DOWN, Growth.RIGHT)
        anchors = [
            Anchor(m["row"], (m["col"] - m["row"]) // 2 if triangular else m["col"], rule.parse(m["text"]))
            for m in unwrapped
        ]
        named = settle(rule, anchors[:1], np.eye(3), 1)
        for a in anchors[1:]:
            assert named.place_of(a.name) == a.place
            told += 1
    assert told > 10


class TestTubeNamer:
    def namer(self, *anchors):
        rule = replace(MODEL_F, rows_grow=Growth.UP, columns_grow=Growth.RIGHT)
        return TubeNamer(rule, [Anchor(0, c, rule.parse(text)) for c, text in anchors])

    def test_an_anchor_waits_for_the_first_pose_and_then_names(self):
        namer = self.namer((0, "R30C60"))
        assert namer.update(make_measurement(Lock.NONE), 1) is None
        assert str(namer.update(make_measurement(), 1).name_of(0, 1)) == "ROW30 COL61"
        assert namer.update(make_measurement(Lock.NONE), 1) is None
        assert str(namer.update(make_measurement(), 1).name_of(0, 1)) == "ROW30 COL61"

    def test_while_the_index_is_in_doubt_nothing_has_a_name(self):
        namer = self.namer((0, "R30C60"))
        doubtful = make_measurement(Lock.PARTIAL, doubt=(Doubt.INDEX,))
        assert namer.update(doubtful, 1) is None
        assert namer.update(make_measurement(), 1) is not None
        assert namer.update(doubtful, 1) is None
        assert namer.update(make_measurement(), 1) is not None

    def test_a_reopened_source_drops_the_anchor_for_good(self):
        namer = self.namer((0, "R30C60"))
        namer.update(make_measurement(), 1)
        assert namer.update(make_measurement(), 2) is None
        assert "dropped" in namer.problem
        assert namer.update(make_measurement(), 2) is None
        namer.anchor([Anchor(0, 0, namer.rule.parse("R5C6"))], 2, 0)
        assert str(namer.update(make_measurement(), 2).name_of(0, 0)) == "ROW5 COL6"
        assert namer.problem is None

    def test_an_anchor_read_from_an_earlier_index_comes_too_late(self):
        namer = self.namer()
        namer.anchor([Anchor(0, 0, namer.rule.parse("R5C6"))], 1, 0)
        assert namer.update(make_measurement(), 2) is None
        assert "too late" in namer.problem

    def test_an_anchor_that_cannot_be_takes_the_old_one_with_it_and_says_why(self):
        namer = self.namer((0, "R30C60"))
        namer.update(make_measurement(), 1)
        namer.anchor([Anchor(0, 0, namer.rule.parse("R5C6")), Anchor(0, 1, namer.rule.parse("R9C9"))], 1, 0)
        assert namer.update(make_measurement(), 1) is None
        assert "no way to count" in namer.problem

    def doubtful(self, index):
        return replace(make_measurement(Lock.PARTIAL, doubt=(Doubt.INDEX,)), index=index)

    def test_an_anchor_read_before_the_index_came_into_doubt_is_not_taken_and_says_so(self):
        namer = self.namer((0, "R30C60"))
        named = namer.update(make_measurement(), 1)
        namer.anchor([Anchor(0, 0, namer.rule.parse("R5C6"))], 1, 0)
        assert namer.update(self.doubtful(1), 1) is None
        assert "came too late: the lattice index may have slipped" in namer.problem
        assert namer.taken is None
        assert namer.update(make_measurement(), 1) is named  # the slip was mended: what was anchored before holds
        namer.anchor([Anchor(0, 0, namer.rule.parse("R5C6"))], 1, 0)
        assert str(namer.update(make_measurement(), 1).name_of(0, 0)) == "ROW5 COL6"
        assert namer.problem is None

    def test_an_anchor_from_the_start_waits_for_an_index_that_is_not_in_doubt(self):
        namer, settler = self.namer((0, "R30C60")), Settler()
        assert namer.update(self.doubtful(1), 1) is None
        namer.settle_index(settler)
        assert settler.asked == []
        assert namer.update(make_measurement(), 1) is not None

    @pytest.mark.parametrize(("row", "column", "slip"), [(2, 3, (-2, -1)), (0, 2, (0, 0))])
    def test_in_doubt_an_anchor_tells_how_far_the_index_slipped_and_the_names_hold(self, row, column, slip):
        namer, settler, said = self.namer((0, "R30C60")), Settler(), []
        namer.tell = lambda *event: said.append(event)
        named = namer.update(make_measurement(), 1)
        assert namer.update(self.doubtful(7), 1) is None
        namer.anchor([Anchor(row, column, namer.rule.parse("R30C62"))], 1, 7)
        assert namer.update(self.doubtful(7), 1) is None  # its doubt is told already
        namer.settle_index(settler)
        assert settler.asked == [(7, slip)]
        assert not namer.begins_anew
        assert namer.update(make_measurement(), 1) is named
        namer.settle_index(settler)
        assert settler.asked == [(7, slip)]
        (text, level), expected = said[0], "had not slipped" if slip == (0, 0) else "had slipped by -2, -1"
        assert (level, expected in text, len(said)) == ("INFO", True, 1)

    @pytest.mark.parametrize("before", [[(0, "R30C60")], []])
    def test_where_nothing_tells_how_far_it_slipped_names_begin_anew_and_it_is_told_which_are_dropped(self, before):
        namer, settler, said = self.namer(*before), Settler(), []
        namer.tell = lambda *event: said.append(event)
        namer.update(make_measurement(), 1)
        turned = replace(self.doubtful(7), pose=make_pose())
        turned = replace(turned, pose=replace(turned.pose, rotation=rolled(90)))
        namer.anchor([Anchor(4, 4, namer.rule.parse("R12C34"))], 1, 7)
        assert namer.update(turned, 1) is None
        namer.settle_index(settler)
        assert settler.asked == [(7, None)]
        assert namer.begins_anew
        assert str(namer.update(replace(make_measurement(), index=7), 1).name_of(4, 4)) == "ROW12 COL34"
        assert namer.update(make_measurement(), 1) is None  # the index that was dropped
        ((text, level),) = said
        assert level == "WARN"
        assert ("dropped: 0,0=ROW30 COL60" in text) == bool(before)

    def test_an_anchor_whose_index_slipped_in_the_same_frame_names_nothing(self):
        namer = self.namer()
        namer.anchor([Anchor(0, 0, namer.rule.parse("R5C6"))], 1, 7)
        namer.update(self.doubtful(7), 1)
        namer.settle_index(Settler(taken=False))
        assert namer.named is None
        assert "came too late" in namer.problem


class Settler:
    def __init__(self, *, taken=True):
        self.asked, self._taken = [], taken

    def settle_index(self, index, shift):
        self.asked.append((index, shift))
        return self._taken
