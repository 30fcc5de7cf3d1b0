"""What tells places of the lattice apart: the map of how each tube end stands off, and of what stands there."""

from dataclasses import replace

import pytest

from drivers.scene import CLEAN, HARD, NOMINAL
from service.vision.evidence import CONTRADICTION, SUSPICIOUS, WINDOW, PlaceMap
from service.vision.stopwatch import Stopwatch
from service.vision.tracking import Tracker
from tests.scenes.rendered import film, looking

SMALL = {"size_px": (240, 180), "pitch_px": 24.0}
REAL = replace(NOMINAL, hose=False, lane_rows=0)
DIM = replace(HARD, hose=False, lane_rows=0, ambient=0.3)
ALIKE = replace(CLEAN, plugged=0.0)
STANDING_OFF = replace(CLEAN, plugged=0.0, scatter_mm=0.05)
ODD_PLACES = replace(CLEAN, plugged=0.08, absent=0.05)


def pictures(look, count=4, **settings):
    """The lattice and `count` pictures of one sheet, each refined from nothing, all indexed alike."""
    views = film([looking(6.0 + 0.3 * k, roll_deg=3.0 + k) for k in range(count)], look=look, **(SMALL | settings))
    tracker = Tracker(views[0].camera, views[0].lattice)
    seen = [tracker.step(v.image, None, 40_000_000 * k, Stopwatch(lambda: 0)) for k, v in enumerate(views)]
    return views[0].lattice, [s.refined for s in seen]


def learned(lattice, refined):
    places = PlaceMap(lattice)
    for r in refined:
        places.learn(r)
    return places


@pytest.mark.parametrize("look", [REAL, DIM, STANDING_OFF, ODD_PLACES], ids=["real", "dim", "standing off", "odd"])
@pytest.mark.parametrize("tubes", ["system80", "model-f"])
def test_every_slip_within_reach_is_found_and_the_right_index_confirmed(look, tubes):
    lattice, refined = pictures(look, tubes=tubes)
    places = learned(lattice, refined[:-1])
    for row, column in [(0, 0), (1, 0), (0, -1), (-1, 1), (2, 2), (-3, 1), (0, WINDOW // 2)]:
        slipped = refined[-1].shifted(row, column, lattice)
        verdict = places.compare(slipped)
        assert (verdict.row, verdict.column) == (-row, -column)
        assert verdict.decisive
        assert verdict.slipped is bool(row or column)
        assert (places.fit(slipped) < SUSPICIOUS) is bool(row or column)


def test_one_picture_is_enough_to_know_the_next_by():
    lattice, refined = pictures(REAL, 2)
    verdict = learned(lattice, refined[:1]).compare(refined[1].shifted(1, -1, lattice))
    assert (verdict.row, verdict.column, verdict.decisive) == (-1, 1, True)


def test_where_all_places_look_alike_nothing_is_decided_and_nothing_contradicted():
    lattice, refined = pictures(ALIKE)
    places = learned(lattice, refined[:-1])
    for row, column in [(0, 0), (1, 0), (-2, 1)]:
        slipped = refined[-1].shifted(row, column, lattice)
        assert not places.compare(slipped).decisive
        assert places.fit(slipped) > CONTRADICTION


def test_an_empty_map_and_one_of_other_places_say_nothing():
    lattice, refined = pictures(REAL, 2)
    empty, elsewhere = PlaceMap(lattice), learned(lattice, [refined[0].shifted(60, 0, lattice)])
    for places in (empty, elsewhere):
        assert places.compare(refined[1]) is None
        assert places.fit(refined[1]) == 0.0


def test_places_beyond_the_map_are_left_out():
    lattice, refined = pictures(REAL, 2)
    beyond = refined[0].shifted(10**6, -(10**6), lattice)
    places = learned(lattice, [beyond])
    assert places.compare(beyond) is None
    assert places.fit(refined[1]) == 0.0


def test_a_slip_out_of_reach_is_contradicted_but_not_mended():
    lattice, refined = pictures(STANDING_OFF, size_px=(640, 320), pitch_px=22.0)
    slipped = refined[-1].shifted(0, WINDOW + 3, lattice)
    places = learned(lattice, refined[:-1])
    assert places.fit(slipped) < SUSPICIOUS
    assert not places.compare(slipped).decisive
