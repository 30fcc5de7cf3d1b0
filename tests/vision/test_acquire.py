"""The first picture: nothing to go by but lattice and camera; and pictures on which nothing must be found."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import ABSENT, GENERATORS, HARD, NOMINAL
from service.vision.camera import Camera, TsaiLens
from service.vision.lattice import Arrangement
from service.vision.measurement import Lock
from tests.scenes import foreign
from tests.scenes.rendered import (
    ARRANGEMENTS,
    PLAIN,
    errors_of,
    film,
    lattice_of,
    looking,
    measurer_of,
    sheet_of,
    view,
)

REAL = replace(NOMINAL, hose=False, lane_rows=0)
SMALL = {"size_px": (240, 180), "pitch_px": 24.0}


def rms_px(errors):
    return float(np.sqrt(np.mean(errors.measured_px**2)))


def found_rightly(seen, *, worst_px=0.25, camera=None):
    """Measure; all that is said must be true."""
    m = seen.measure(camera)
    assert m.lock is not Lock.NONE, m.reason
    e = errors_of(seen, m)
    assert e.index_share == 1.0
    assert e.missed == 0
    assert rms_px(e) < worst_px
    return m, e


@pytest.mark.parametrize("tubes", [*GENERATORS.values(), *ARRANGEMENTS.values()], ids=[*GENERATORS, *ARRANGEMENTS])
def test_every_generator_and_arrangement_is_found(tubes):
    m, e = found_rightly(view(tubes, REAL, **SMALL))
    assert m.lock is Lock.FULL
    assert len(e.measured_px) > 50


@pytest.mark.parametrize("tilt_deg", [0, 12, 25, 40, 55])
@pytest.mark.parametrize("roll_deg", [0, 77, -140])
def test_from_straight_on_to_aslant_at_any_turn(tilt_deg, roll_deg):
    seen = view(look=REAL, pose=looking(tilt_deg, roll_deg=roll_deg), **SMALL)
    m, _ = found_rightly(seen)
    assert m.pose.tilt_deg == pytest.approx(tilt_deg, abs=0.4)


@pytest.mark.parametrize("pitch_px", [12, 17, 24, 34, 48])
def test_tubes_of_any_size_in_the_picture(pitch_px):
    found_rightly(view(look=REAL, size_px=(240, 180), pitch_px=float(pitch_px)))


@pytest.mark.parametrize("opencv", [False, True])
@pytest.mark.parametrize("bend", [-0.05, 0.1, 0.25])
def test_lenses_that_bend(bend, opencv):
    found_rightly(view(look=REAL, bend=bend, opencv=opencv, **SMALL))


@pytest.mark.parametrize(
    "look",
    [replace(REAL, ambient=0.0, spot=0.15), replace(HARD, hose=False, ambient=0.0, spot=0.2), NOMINAL],
    ids=["half dark", "hard", "lane and hose"],
)
def test_dark_parts_lanes_and_hoses_are_bridged(look):
    seen = view(look=look, size_px=(320, 240), pitch_px=30.0, seed=3)
    _, e = found_rightly(seen)
    assert len(e.inferred_px) > 2
    assert np.sqrt(np.mean(e.inferred_px**2)) < 0.5


def test_sixteen_bits_say_what_eight_do():
    eight, sixteen = (found_rightly(view(look=REAL, bits=bits, **SMALL))[0] for bits in (8, 16))
    assert abs(eight.pose.distance_mm - sixteen.pose.distance_mm) < 0.3 * eight.pose.sigma.distance_mm
    assert sixteen.lock is Lock.FULL


@pytest.mark.parametrize("size_px", [(120, 90), (96, 72), (80, 60)])
def test_small_pictures_with_a_dozen_tubes_do(size_px):
    m, e = found_rightly(view(look=REAL, size_px=size_px, pitch_px=20.0))
    assert len(e.measured_px) >= 8
    assert abs(e.distance_mm[0]) < 4 * e.distance_mm[1]
    assert len(m.tubes) < 40


@pytest.mark.parametrize("shape", [(1, 1), (1, 500), (500, 1), (2, 3), (12, 16), (30, 40), (20, 320)])
@pytest.mark.parametrize("field", ["progressive", "unknown", "top", "interlaced-bottom-first"])
def test_pictures_too_small_for_a_pattern_are_answered_with_a_reason(shape, field):
    seen = view(look=REAL, **SMALL)
    camera = replace(seen.camera, image_size_px=shape[::-1], principal_point_px=None)
    noise = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    answers = measurer_of(camera, seen.lattice).measure(noise, 0, field)
    assert answers
    for m in answers:
        assert (m.lock, m.pose, len(m.tubes)) == (Lock.NONE, None, 0)
        assert m.reason


def blank(grey):
    return np.full((180, 240), grey, np.uint8)


def stripes():
    return np.where(np.mgrid[:180, :240][1] // 12 % 2, 200, 30).astype(np.uint8)


def checks():
    y, x = np.mgrid[:180, :240] // 12
    return np.where((x + y) % 2, 200, 30).astype(np.uint8)


def noise():
    return np.random.default_rng(0).integers(0, 256, (180, 240), np.uint8)


def negative():
    return 255 - view(look=PLAIN, **SMALL).image


@pytest.mark.parametrize(
    "picture", [blank(0), blank(128), blank(255), stripes(), checks(), noise(), negative()],
    ids=["black", "grey", "white", "stripes", "checks", "noise", "negative"],
)  # fmt: skip
def test_what_is_no_tubesheet_is_not_taken_for_one(picture):
    seen = view(look=PLAIN, **SMALL)
    m = measurer_of(seen.camera, seen.lattice).measure(picture, 0, "progressive")[0]
    assert m.lock is Lock.NONE
    assert m.reason
    assert m.doubt == ()


FOREIGN = {
    **{f"chessboard {side}": foreign.chessboard(side) for side in (12, 16, 24, 36, 56)},
    "small board": foreign.board(24, 9, 6),
    "large board": foreign.board(40, 7, 5),
    **{f"squares {p}": foreign.squares(p, 0.65 * p) for p in (24, 40)},
    "staggered squares": foreign.squares(24, 16, staggered=0.5),
    "grid lines": foreign.grid_lines(24),
    "bricks": foreign.bricks(60, 24),
    "square bricks": foreign.bricks(40, 40),
    "white tiles": foreign.bricks(40, 40, dark=False),
    "diamonds": foreign.dots(30, 12, triangular=True, corners=4),
    "dots far too small": foreign.dots(40, 5, triangular=False),
    "rings": foreign.rings(24),
    "writing": foreign.writing(24),
}


@pytest.mark.parametrize(("tilt_deg", "known"), [(0, True), (25, False), (50, False)])
@pytest.mark.parametrize("pattern", FOREIGN.values(), ids=FOREIGN)
def test_other_regular_patterns_are_not_taken_for_a_sheet_of_any_generator(pattern, tilt_deg, known):
    """Squares stand on a lattice of tubes, and a square lattice seen aslant is a triangular one: shape tells."""
    picture = foreign.photographed(pattern, tilt_deg)
    camera = Camera(foreign.SIZE_PX, (0.005, 0.005))
    if known:
        camera = replace(camera, focal_length_mm=2.24, lens=TsaiLens(), principal_point_px=camera.middle_px)
    for tubes in GENERATORS.values():
        m = measurer_of(camera, lattice_of(tubes, NOMINAL)).measure(picture, 0, "progressive")[0]
        assert m.lock is Lock.NONE
        assert m.reason


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("tubes", "told"), [("model-f", Arrangement.TRIANGULAR), ("system80", Arrangement.SQUARE)])
def test_the_wrong_arrangement_is_refused(tubes, told, seed):
    seen = view(tubes, REAL, seed=seed, **SMALL)
    assert seen.measure(lattice=replace(seen.lattice, arrangement=told)).lock is Lock.NONE


@pytest.mark.parametrize("factor", [0.5, 1.25])
def test_tube_ends_of_the_wrong_size_are_refused(factor):
    seen = view(look=REAL, **SMALL)
    wrong = replace(seen.lattice, rim_radius_mm=factor * seen.lattice.rim_radius_mm, outer_radius_mm=12.0)
    m = seen.measure(lattice=wrong)
    assert m.lock is Lock.NONE
    assert m.reason


def test_too_few_tubes_are_said_to_be_too_few():
    m = view(look=REAL, sheet=sheet_of(GENERATORS["system80"], reach=1), **SMALL).measure()
    assert m.lock is Lock.NONE
    assert "tubes are seen" in m.reason


def test_beside_the_plate_no_tube_is_said_to_be_measured():
    """Half of the picture shows bare plate: places there may be told, but not as measured."""
    sheet = sheet_of(GENERATORS["system80"])
    bare = sheet.centers_mm[..., 0] > 30.0
    seen = view(look=REAL, sheet=replace(sheet, states=np.where(bare, ABSENT, sheet.states)), **SMALL)
    _, e = found_rightly(seen)
    assert e.false <= 2


def test_the_same_picture_gives_the_same_answer_to_the_last_bit():
    seen = film([looking(6.0)], look=REAL, **SMALL)[0]
    one, two = seen.measure(), seen.measure()
    assert np.array_equal(one.tubes.center_px, two.tubes.center_px)
    assert np.array_equal(one.pose.covariance, two.pose.covariance)
