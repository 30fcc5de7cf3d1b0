"""How far shapes lean around a rim: with the light, as all tubes tell it, and with the view."""

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import CLEAN, NOMINAL
from service.vision.edges import EdgeProfile, start_profile
from service.vision.light import light_slopes
from service.vision.measurement import Doubt, Lock
from service.vision.rays import BASIS, ENERGY, NUMBERS, Rays
from service.vision.rim_levels import FIGURES, SHIFT, levels
from service.vision.rim_solver import solve
from service.vision.scratch import Scratch
from service.vision.shapes import SEAM_IN, SEAM_WIDTH, shapes_of
from tests.scenes.rendered import errors_of, looking, view

RADIUS = 12.0
SIZE = np.array([640.0, 480.0])
WIDTH, WALL, RAYS = 0.8, 1.4, 16


def spot(center, aspect, at=(250.0, 300.0), sigma=180.0):
    """Light of a lamp's spot at picture points, and its slope from a tube's centre to its rim, px of x."""
    off = (center - at) * [1.0, aspect]
    return 150.0 * np.exp(-0.5 * np.sum(off**2, axis=1) / sigma**2), -RADIUS * off.T / sigma**2


def places(n=120, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (n, 2)) * SIZE


def slopes(center, aspect, gain, strength):
    out = np.zeros((2, len(center)))
    light_slopes(center, aspect, gain, strength, RADIUS, out)
    return out


@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_the_slope_of_a_lamps_spot_is_told_even_where_tubes_are_too_dim_to_tell_it(aspect):
    center = places() / [1.0, aspect]
    gain, true = spot(center, aspect, at=(250.0, 300.0 / aspect))
    strength = np.where(gain > 15.0, 20.0, 3.0)
    gain[strength < 4.0] = 77.0
    assert (strength < 4.0).sum() > 8
    assert slopes(center, aspect, gain, strength) == pytest.approx(true, abs=0.003)


def test_stained_tubes_and_places_without_an_image_do_not_tell_the_light():
    center = places()
    gain, true = spot(center, 1.0)
    gain[::9] *= 0.2
    center[5] = np.nan
    found, there = slopes(center, 1.0, gain, np.full(len(center), 20.0)), np.arange(len(center)) != 5
    assert found[:, there] == pytest.approx(true[:, there], abs=0.01)
    assert (found[:, 5] == 0.0).all()


@pytest.mark.parametrize("n", [1, 5])
def test_so_few_tubes_tell_no_slope(n):
    center = places(n)
    assert (slopes(center, 1.0, spot(center, 1.0)[0], np.full(n, 20.0)) == 0.0).all()


def test_tubes_in_one_row_or_place_tell_a_finite_slope():
    for center in (np.column_stack([np.linspace(0, 600, 30), np.full(30, 100.0)]), np.full((30, 2), 100.0)):
        assert np.isfinite(slopes(center, 1.0, spot(center, 1.0)[0], np.full(30, 20.0))).all()


def shapes_along(profile: EdgeProfile):
    """Edge, what lies beyond the wall, seam and shift at a profile's samples, (4, SAMPLES)."""
    u = profile.offsets_px
    erf = np.vectorize(math.erf)
    edge = 0.5 * (1 + erf(u / WIDTH / math.sqrt(2)))
    beyond = 0.5 * (1 + erf((u - WALL) / WIDTH / math.sqrt(2)))
    seam = np.exp(-0.5 * (((u - WALL) / WIDTH + SEAM_IN) / SEAM_WIDTH) ** 2)
    return np.array([edge, beyond, seam, -np.exp(-0.5 * (u / WIDTH) ** 2) / (WIDTH * math.sqrt(2 * math.pi))])


def seen_shifts(leans, view_of, light, *, blind=False, n=80, noise=1.0):
    """Shifts, (2, n) px, that are told of tubes that stand where they should, whose shapes lean so far.

    `leans` (2, 3): of edge, beyond and seam, with view and light. `blind`: neither is told.
    """
    profile = replace(start_profile(WIDTH), learnt=True)
    functionals, shapes = shapes_of(profile, WALL)
    angle = 2 * np.pi * np.arange(RAYS) / RAYS
    normal = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([np.einsum("in,ik->kn", field, normal) for field in (view_of, light)])  # (2, RAYS, n)
    edge, beyond, seam, _ = shapes_along(profile)
    lean = np.einsum("fs,fkn->skn", np.asarray(leans), along)
    height = 100.0
    means = (1.0, 0.4, 0.3)
    grey = 10.0 + height * sum(
        (mean + by)[..., None] * shape for mean, by, shape in zip(means, lean, (edge, beyond, seam), strict=True)
    )
    grey = grey + np.random.default_rng(1).normal(0, noise, grey.shape)  # (RAYS, n, SAMPLES)
    numbers = np.zeros((NUMBERS, RAYS, n), np.float32)
    numbers[:BASIS] = np.einsum("ps,kns->pkn", functionals[:BASIS], grey)
    numbers[ENERGY] = np.einsum("s,kns->kn", functionals[BASIS], grey**2)
    numbers[ENERGY + 1] = grey[..., :3].mean(axis=-1)
    numbers[ENERGY + 2] = grey[..., -2:].mean(axis=-1)
    numbers[ENERGY + 3] = grey[..., 0] - 2 * grey[..., 1] + grey[..., 2]
    direction = np.ascontiguousarray(np.broadcast_to(normal[..., None], (2, RAYS, n)), np.float32)
    valid = np.ones((RAYS, n), np.float32)
    seen = Rays(numbers, direction, valid, np.zeros((n, 2)), grey.mean(axis=0), np.zeros(n))
    told = np.zeros((FIGURES, n))
    spread = levels(numbers, valid, shapes.first, shapes.edge, told)
    seeing = np.zeros((2, 2, n)) if blind else np.array([view_of, light])
    solve(seen, shapes, 2.0 * spread, seeing[0], seeing[1], told, Scratch())
    return told[SHIFT : SHIFT + 2]


def part_along(shift, field):
    """How much of a field the shifts hold: shift per unit of it."""
    return float(np.sum(shift * field) / np.sum(field**2))


def field_of(size, n=80):
    return size * np.random.default_rng(3).uniform(-1, 1, (2, n))


def test_weld_beads_that_lean_with_the_view_are_not_taken_for_depth():
    """Beads are bright on the side that faces the lamp."""
    toward, level = field_of(0.3), np.zeros((2, 80))
    leans = [[0.0, 0.6, 0.6], [0.0, 0.0, 0.0]]
    without, found = (part_along(seen_shifts(leans, toward, level, blind=b), toward) for b in (True, False))
    assert without > 0.05
    assert abs(found) < 0.2 * without


def test_edges_that_lean_with_the_light_are_not_taken_for_shifts():
    level, light = np.zeros((2, 80)), field_of(0.15)
    leans = [[0.0, 0.0, 0.0], [1.1, 0.5, 0.0]]
    without, found = (part_along(seen_shifts(leans, level, light, blind=b), light) for b in (True, False))
    assert without < -0.1
    assert abs(found) < 0.4 * abs(without)


def test_distance_is_right_in_light_that_falls_off_steeply():
    """A spot a fifth as wide as the picture: 0.44 mm too near where leans were taken for shifts."""
    look = replace(NOMINAL, hose=False, lane_rows=0, wall=0.0, ambient=0.0, spot=0.2)
    off = []
    for seed in range(6):
        seen = view(look=look, seed=seed, pose=looking(8.0, 60.0 * seed), pitch_px=28.0)
        off.append(errors_of(seen, seen.measure()).distance_mm[0])
    assert abs(np.mean(off)) < 0.25


def test_even_light_and_a_clean_plate_are_measured_as_before():
    seen = view(look=replace(CLEAN, wall=0.0), pose=looking(12.0))
    e = errors_of(seen, seen.measure())
    assert np.sqrt(np.mean(e.measured_px**2)) < 0.04


def test_a_profile_sampled_as_a_narrower_one_is_the_same_edge():
    wide = EdgeProfile(0.4, 3.0, start_profile().template, learnt=True, blur_px=3.0)
    narrow = wide.narrowed(2.0)
    assert (narrow.position_px, narrow.width_px, narrow.learnt) == (0.4, 2.0, True)
    assert narrow.template == pytest.approx(np.interp(narrow.offsets_px, wide.offsets_px, wide.template))
    assert narrow.template[0] > wide.template[0]


def test_tubes_too_small_to_look_across_their_blurred_edges_are_out_of_focus():
    """Their edge is taken for narrower than it is: that must not hide how blurred it was."""
    seen = view(look=replace(CLEAN, blur_px=3.0), size_px=(320, 240), pitch_px=22.0)
    told = seen.measure()
    assert told.lock is not Lock.NONE
    assert Doubt.FOCUS in told.doubt
