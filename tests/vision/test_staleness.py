"""A zoom, or another lens, that nobody told of: the pictures themselves speak against the calibration."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import NOMINAL
from service.vision.camera import TsaiLens
from service.vision.measurement import Doubt, Lock
from service.vision.staleness import ENOUGH, EVERY
from tests.scenes.rendered import PERIOD_NS, camera_of, looking, measurer_of, optics_of, sheet_of, unknown_camera, view

LOOK = replace(NOMINAL, hose=False, lane_rows=0)
SIZE = (640, 480)
SOON = EVERY * ENOUGH


def still(optics, tilt_deg=9.0):
    tubes = view("system80").sheet.lattice
    return view(tubes, LOOK, optics=optics, pose=looking(tilt_deg), sheet=sheet_of(tubes, LOOK))


def told(measurer, picture, count, first=0):
    """Doubts of the pictures, the same again and again."""
    frames = [measurer.measure(picture.image, (first + i) * PERIOD_NS, "progressive")[0] for i in range(count)]
    assert all(m.pose is not None for m in frames)
    return [m.doubt for m in frames]


@pytest.fixture(scope="module")
def optics():
    return optics_of(SIZE, bend=0.01, pitch_px=40.0)


@pytest.fixture(scope="module")
def zoomed(optics):
    return replace(optics, focal_length_mm=1.1 * optics.focal_length_mm)


@pytest.mark.parametrize("tilt_deg", [1.0, 9.0])
def test_a_calibration_that_holds_is_not_doubted(optics, tilt_deg):
    v = still(optics, tilt_deg)
    assert set(told(measurer_of(v.camera, v.lattice), v, SOON + EVERY)) == {()}


def test_a_change_of_zoom_is_noticed_by_a_tilted_sheet(optics, zoomed):
    v = still(zoomed)
    doubts = told(measurer_of(camera_of(optics), v.lattice), v, SOON)
    assert doubts[-1] == (Doubt.CALIBRATION,)
    assert not any(Doubt.CALIBRATION in d for d in doubts[: SOON - 1])


def test_a_stale_calibration_makes_the_lock_partial(optics, zoomed):
    v = still(zoomed)
    measurer = measurer_of(camera_of(optics), v.lattice)
    told(measurer, v, SOON)
    assert measurer.measure(v.image, SOON * PERIOD_NS, "progressive")[0].lock is Lock.PARTIAL


def test_another_bend_of_the_lens_is_noticed_though_the_sheet_is_frontal(optics):
    v = still(optics, 0.5)
    bent = camera_of(optics, lens=TsaiLens(optics.kappa1_per_mm2 + 0.001))
    assert Doubt.CALIBRATION in told(measurer_of(bent, v.lattice), v, SOON)[-1]


def test_a_calibration_that_fits_again_is_trusted_again(optics, zoomed):
    was, v = still(optics), still(zoomed)
    measurer = measurer_of(camera_of(optics), v.lattice)
    assert Doubt.CALIBRATION in told(measurer, v, SOON)[-1]
    doubts = told(measurer, was, SOON + EVERY, first=SOON)
    assert Doubt.CALIBRATION in doubts[0]
    assert Doubt.CALIBRATION not in doubts[-1]


def test_a_camera_that_is_known_badly_is_not_contradicted_within_its_sigma(optics, zoomed):
    f = optics.focal_length_mm
    vague = camera_of(optics, parameters=("focal_length_mm",), covariance=np.array([[(0.2 * f) ** 2]]))
    v = still(zoomed)
    assert Doubt.CALIBRATION not in told(measurer_of(vague, v.lattice), v, SOON)[-1]


def test_where_nothing_is_known_nothing_can_be_stale(optics):
    v = still(optics)
    assert Doubt.CALIBRATION not in told(measurer_of(unknown_camera(optics), v.lattice), v, SOON)[-1]


def test_fields_are_held_against_it_as_well(optics, zoomed):
    v = still(zoomed, 14.0)
    measurer = measurer_of(camera_of(optics), v.lattice)
    doubts = []
    for i in range(SOON // 2 + 2):
        doubts += [m.doubt for m in measurer.measure(v.image, i * PERIOD_NS, "interlaced-top-first")]
    assert Doubt.CALIBRATION in doubts[-1]
