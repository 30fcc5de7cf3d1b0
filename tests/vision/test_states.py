"""Open, plugged, absent: what stands at each place, or that it cannot be told."""

from collections import Counter
from dataclasses import replace

import pytest

from drivers.scene import CLEAN, HARD, NOMINAL
from service.vision.measurement import TubeState
from tests.scenes.rendered import errors_of, view

O, P, A, U = TubeState.OPEN, TubeState.PLUGGED, TubeState.ABSENT, TubeState.UNKNOWN
MANY = {"plugged": 0.15, "absent": 0.1, "hose": False, "lane_rows": 0}
LIGHTS = {
    "clean": replace(CLEAN, **MANY),
    "nominal": replace(NOMINAL, **MANY),
    "dim walls": replace(NOMINAL, **MANY, wall=0.05),
    "hard": replace(HARD, **MANY),
    "dark": replace(NOMINAL, **MANY, ambient=0.0, spot=0.2),
}


@pytest.fixture(scope="module")
def told():
    """(told, true) counted over three pictures of every light."""
    pairs = {}
    for name, look in LIGHTS.items():
        pairs[name] = Counter()
        for seed in range(3):
            seen = view(look=look, seed=seed)
            pairs[name].update((TubeState(a), TubeState(b)) for a, b in errors_of(seen, seen.measure()).states.tolist())
    return pairs


def share(counts, said, true):
    return sum(counts[s, true] for s in said) / sum(n for (_, t), n in counts.items() if t == true)


@pytest.mark.parametrize("light", LIGHTS)
def test_open_tubes_are_told_open_and_hardly_ever_anything_else(told, light):
    assert share(told[light], [O, U], O) > 0.98
    assert share(told[light], [O], O) > 0.9


@pytest.mark.parametrize("light", LIGHTS)
def test_a_plug_is_not_taken_for_an_open_tube(told, light):
    assert share(told[light], [O], P) < 0.1
    assert share(told[light], [P, U], P) > 0.75


@pytest.mark.parametrize("light", LIGHTS)
def test_where_there_is_no_tube_none_is_told_open(told, light):
    assert share(told[light], [O], A) < 0.05
    assert share(told[light], [A, U], A) > 0.8


def test_in_good_light_everything_is_told_and_right(told):
    assert all(said == true for said, true in told["clean"])


def test_in_the_dark_it_is_said_that_it_cannot_be_told():
    look = replace(NOMINAL, hose=False, lane_rows=0, ambient=0.0, spot=0.12, absent=0.0, plugged=0.0)
    states = errors_of(seen := view(look=look), seen.measure()).states
    assert (states[:, 0] == U).sum() > 5
    assert ((states[:, 0] == O) | (states[:, 0] == U)).mean() > 0.95
