"""The sheet moved too far for its edges to be followed: the shift of up to half a pitch that brings bores onto dark."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import HARD, NOMINAL
from service.vision.search import search_shift
from tests.scenes.rendered import ARRANGEMENTS, PLAIN, looking, view

SMALL = {"size_px": (240, 180), "pitch_px": 24.0}
REAL = replace(NOMINAL, hose=False, lane_rows=0)


def off_pitches(seen, shift_pitches):
    """How far from the truth a pose is, in pitches, that was so far off and then was searched for."""
    pitch = seen.lattice.pitch_mm
    before = seen.translation_mm + seen.rotation[:, :2] @ (pitch * np.asarray(shift_pitches))
    after = search_shift(seen.image, seen.camera.vector(), seen.rotation, before, seen.lattice)
    left = seen.rotation.T @ (after - seen.translation_mm) / pitch
    assert abs(left[2]) < 1e-9
    return np.hypot(*left[:2])


@pytest.mark.parametrize("shift", [(0, 0), (0.3, 0), (0, -0.4), (-0.28, 0.28), (0.4, 0.1)])
@pytest.mark.parametrize("look", [PLAIN, REAL, replace(HARD, hose=False, ambient=0.2)], ids=["plain", "real", "hard"])
def test_a_shift_is_found_to_a_twelfth_of_a_pitch(look, shift):
    assert off_pitches(view(look=look, **SMALL), shift) < 0.09


@pytest.mark.parametrize("tubes", ARRANGEMENTS.values(), ids=ARRANGEMENTS)
def test_in_every_arrangement(tubes):
    assert off_pitches(view(tubes, REAL, **SMALL), (0.25, -0.2)) < 0.09


def test_one_glare_does_not_decide():
    seen = view(look=PLAIN, **SMALL)
    picture = seen.image.copy()
    picture[60:120, 60:120] = 255
    assert off_pitches(replace(seen, image=picture), (0.3, 0.1)) < 0.09


def test_sixteen_bits_too():
    assert off_pitches(view(look=REAL, bits=16, **SMALL), (0.3, 0.1)) < 0.09


@pytest.mark.parametrize("grey", [0, 200])
def test_where_nothing_is_seen_any_shift_within_reach_does(grey):
    seen = view(look=PLAIN, **SMALL)
    assert off_pitches(replace(seen, image=np.full_like(seen.image, grey)), (0, 0)) <= 0.5 * 2**0.5 + 1e-9


def test_where_there_is_no_place_to_look_at_nothing_is_moved():
    seen = view(look=PLAIN, **SMALL)
    away = seen.translation_mm * [1, 1, 0.02]
    kept = search_shift(seen.image[:3, :3].copy(), seen.camera.vector(), seen.rotation, away, seen.lattice)
    assert np.array_equal(kept, away)


def test_a_tilted_camera_too():
    assert off_pitches(view(look=REAL, pose=looking(35.0), **SMALL), (0.2, 0.2)) < 0.12
