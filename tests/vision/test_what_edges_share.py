"""What all edges of a picture have in common: what of it is taken out, and what is told in sigma."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.rendering import Renderer, add_noise, quantised
from drivers.scene import GENERATORS, HARD, NOMINAL
from service.vision.estimates import TELLING_PX, TELLING_SCATTERS, estimates
from service.vision.measurement import Lock, Origin
from service.vision.refinement import projected
from service.vision.stopwatch import Stopwatch
from service.vision.systematics import edge_bias, lit_walls
from service.vision.tracking import Tracker
from tests.scenes.rendered import View, errors_of, looking, optics_of, sheet_of, view

CURVE = 0.45
"""Exponent of BT.709's curve."""
LIT = replace(NOMINAL, hose=False, lane_rows=0, wall=0.05)


def coded(look, seed, bits=8):
    """A picture through a camera that codes light as cameras do."""
    tubes = GENERATORS["system80"]
    optics, sheet, pose = (
        optics_of(pitch_mm=tubes.pitch_mm),
        sheet_of(tubes, look, seed=seed),
        looking(18.0, 50.0 * seed),
    )
    light = Renderer(optics, sheet, look, np.random.default_rng([seed, 2])).draw(*pose)
    grey = np.asarray(np.clip(light, 0, 1) ** CURVE, np.float32)
    noisy = add_noise(grey, look, np.random.default_rng([seed, 3]))
    return View(quantised(noisy, bits), optics, sheet, look, *pose)


def rms_px(views):
    return float(np.sqrt(np.mean(np.concatenate([errors_of(v, v.measure()).measured_px.ravel() for v in views]) ** 2)))


def test_a_cameras_curve_does_not_shift_the_edges_of_tubes_whose_walls_are_lit():
    """0.20 px where grey values are taken for light."""
    assert rms_px([coded(replace(LIT, wall=0.2), seed) for seed in range(4)]) < 0.16


def test_sixteen_bits_are_straightened_as_eight_are():
    fine, coarse = coded(LIT, 1, bits=16), coded(LIT, 1)
    a, b = fine.measure().tubes, coarse.measure().tubes
    assert (a.row.tolist(), a.column.tolist()) == (b.row.tolist(), b.column.tolist())
    assert np.abs(a.center_px - b.center_px).max() < 0.05


def test_what_lit_walls_may_do_grows_with_their_light_and_with_blur_but_not_beyond_reason():
    place, before = np.tile([[1.5, 0.0, 0.3], [0.0, 1.5, 0.0]], (4, 1, 1)), np.tile([0.01, 0.0, 0.02], (4, 1))
    gain, bore = np.array([80.0, 80.0, 80.0, 1.0]), np.array([0.0, 20.0, 40.0, 200.0])
    field, covariance = lit_walls(gain, bore, before, place, 1.5, 0.8)
    assert (field[:, 1] == 0.0).all()
    assert field[0, 0] == 0.0
    assert field[2, 0] == pytest.approx(2 * field[1, 0])
    assert field[3, 0] < 10 * field[1, 0]
    assert lit_walls(gain, bore, before, place, 1.5, 1.6)[0] == pytest.approx(2 * field)
    assert covariance - before == pytest.approx(np.column_stack([field[:, 0] ** 2, 0 * gain, 0 * gain]))


def test_blur_makes_depth_less_certain_and_places_not():
    covariance = np.tile([0.01, 0.0, 0.01], (4, 1))
    sharp, blurred = (np.diag(edge_bias(covariance, 1.5, width).covariance) for width in (0.6, 3.0))
    assert blurred[2] > 2 * sharp[2]
    assert blurred[:2] == pytest.approx(sharp[:2])


def test_a_rim_that_tells_nothing_of_its_tube_does_not_make_it_a_measured_one():
    look = replace(HARD, hose=False, lane_rows=0, ambient=0.0)
    seen = view(look=look, size_px=(480, 360), pitch_px=30.0, seed=2)
    refined = Tracker(seen.camera, seen.lattice).step(seen.image, None, 0, Stopwatch(lambda: 0)).refined
    _, tubes = estimates(refined, seen.lattice, seen.camera, None)
    told = tubes.origin == Origin.MEASURED
    weak = refined.used & ~told
    assert weak.any()
    assert told.sum() > 50
    own = np.sqrt((refined.rims.covariance_px[:, 0] + refined.rims.covariance_px[:, 2]) / 2)
    limit = max(TELLING_PX, TELLING_SCATTERS * 1.01 * look.scatter_mm * np.hypot(*refined.place[0, 0, :2]))
    assert own[told].max() < limit
    nominal, _ = projected(refined.fit.camera, refined.fit.rotation, refined.fit.translation_mm, refined.sites.sheet_mm)
    assert tubes.center_px[weak] == pytest.approx(nominal[weak])
    m = seen.measure()
    assert m.lock is not Lock.NONE
    assert errors_of(seen, m).false == 0
