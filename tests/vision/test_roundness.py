"""Outlines that are round and outlines that are not."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import GENERATORS, HARD, NOMINAL
from service.vision.camera import Camera, TsaiLens
from service.vision.edges import EdgeProfile, start_profile
from service.vision.pose import NO_PRIOR
from service.vision.refinement import refine
from service.vision.roundness import out_of_round
from service.vision.stopwatch import Stopwatch
from tests.scenes import foreign
from tests.scenes.rendered import lattice_of, looking, view

REAL = replace(NOMINAL, hose=False, lane_rows=0)


def refined_of(image, camera, lattice, rotation, translation_mm, profile: EdgeProfile):
    return refine(
        image, camera, lattice, NO_PRIOR, rotation, translation_mm, profile, passes=7, watch=Stopwatch(lambda: 0)
    )


def of_a_sheet(look, tilt_deg, pitch_px, seed):
    tubes = list(GENERATORS.values())[seed]
    seen = view(tubes, look, pose=looking(tilt_deg), pitch_px=pitch_px, seed=seed, bits=16 if seed else 8)
    profile = start_profile(0.2 * pitch_px * tubes.rim_radius_mm / tubes.pitch_mm)
    refined = refined_of(seen.image, seen.camera, seen.lattice, seen.rotation, seen.translation_mm, profile)
    return out_of_round(seen.image, refined, seen.lattice)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("tilt_deg", "pitch_px"), [(0, 14.0), (0, 40.0), (50, 22.0)])
@pytest.mark.parametrize("look", [REAL, replace(HARD, hose=False)], ids=["nominal", "hard"])
def test_tube_ends_are_round(look, tilt_deg, pitch_px, seed):
    assert of_a_sheet(look, tilt_deg, pitch_px, seed) < 0.03


@pytest.mark.parametrize("side", [20, 24, 40])
def test_squares_in_their_places_are_not(side):
    """The dark squares of a chessboard, of a size with the tubes, measured at the pose that they have."""
    picture = foreign.photographed(foreign.chessboard(side), roll_deg=0.0)
    tubes = GENERATORS["model-f"]
    lattice = lattice_of(tubes, NOMINAL)
    (w, h), pitch_px = foreign.SIZE_PX, side * 2**0.5
    camera = Camera((w, h), (0.01, 0.01), 0.01 * pitch_px / tubes.pitch_mm * 500, TsaiLens(), (w / 2, h / 2))
    dark = np.array([side / 2, side / 2]) * camera.pixel_pitch_mm * 500 / camera.focal_length_mm
    turn = looking(0.0, roll_deg=45.0)[0]
    profile = start_profile(0.1 * side)
    refined = refined_of(picture, camera, lattice, turn, np.array([*dark, 500.0]), profile)
    assert refined.used.sum() > 10
    assert out_of_round(picture, refined, lattice) > 0.06


def test_tubes_of_which_none_is_whole_in_the_picture_say_nothing():
    seen = view("system80", REAL)
    profile = start_profile(2.0)
    refined = refined_of(seen.image, seen.camera, seen.lattice, seen.rotation, seen.translation_mm, profile)
    beside = replace(refined, rims=replace(refined.rims, center_px=refined.rims.center_px + 1e4))
    assert out_of_round(seen.image, beside, seen.lattice) == 0.0
