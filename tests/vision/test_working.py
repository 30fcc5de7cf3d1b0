"""Following the sheet with a camera that nobody described, or described badly."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import NOMINAL
from service.vision.measurement import Doubt
from service.vision.stopwatch import Stopwatch
from service.vision.tracking import Tracker
from service.vision.working import WorkingCamera
from tests.scenes.rendered import PERIOD_NS, camera_of, looking, measurer_of, sheet_of, unknown_camera, view

LOOK = replace(NOMINAL, hose=False, lane_rows=0)


def seen(tilt_deg, camera=None):
    v = view("system80", LOOK, pose=looking(tilt_deg), seed=4)
    camera = camera or unknown_camera(v.optics)
    return v, Tracker(camera, v.lattice).step(v.image, None, 0, Stopwatch(lambda: 0)).refined


def test_a_known_camera_is_used_as_it_is():
    v, refined = seen(4.0)
    working = WorkingCamera.of(camera_of(v.optics), v.lattice)
    assert working.learned(refined) is working
    assert working.pose(refined) is refined.fit


def test_a_camera_once_found_stays_until_a_picture_knows_much_better():
    v, vague = seen(2.0)
    _, alike = seen(2.5)
    _, telling = seen(14.0)
    first = WorkingCamera.of(unknown_camera(v.optics), v.lattice).learned(vague)
    assert first.camera.complete
    assert first.learned(alike) is first
    better = first.learned(telling)
    assert better.uncertainty < 0.5 * first.uncertainty
    assert better.camera.focal_length_mm == pytest.approx(telling.fit.camera.focal_length_mm)
    assert better.learned(vague) is better


def test_a_picture_that_tells_nothing_of_the_focal_length_leaves_the_usual_one():
    v, refined = seen(0.5)
    working = WorkingCamera.of(unknown_camera(v.optics), v.lattice).learned(refined)
    width_mm = v.optics.width_px * v.optics.pixel_pitch_mm[0]
    assert working.camera.focal_length_mm == 2 * width_mm
    fit = working.pose(refined)
    assert np.hypot(*fit.residual_px.T).mean() < 0.3  # all the same, it fits


def test_a_badly_known_focal_length_does_not_make_the_sheet_wander():
    v, refined = seen(3.0)
    known = camera_of(v.optics)
    f = known.focal_length_mm
    known = replace(
        known, focal_length_mm=1.1 * f, parameters=("focal_length_mm",), covariance=np.array([[(0.3 * f) ** 2]])
    )
    working = WorkingCamera.of(known, v.lattice)
    assert working.learned(refined) is working
    assert working.pose(refined).camera.focal_length_mm == 1.1 * f


def test_however_far_aside_the_lattice_begins_a_picture_is_solved_for_alike():
    v, refined = seen(6.0)
    known = camera_of(v.optics)
    f = known.focal_length_mm
    known = replace(
        known, focal_length_mm=1.3 * f, parameters=("focal_length_mm",), covariance=np.array([[(0.3 * f) ** 2]])
    )
    working = WorkingCamera.of(known, v.lattice)
    near = working.pose(refined)
    for row, column in ((1000, 0), (-1000, 0), (0, 1000), (0, -1000)):
        far = working.pose(refined.shifted(row, column, v.lattice))
        assert far.pivot_mm == pytest.approx(near.pivot_mm, rel=1e-3)
        assert far.scatter_factor == pytest.approx(near.scatter_factor, rel=1e-2)


def test_the_index_holds_while_a_camera_that_nobody_knows_pans_and_tilts():
    tubes = view("system80", LOOK).sheet.lattice
    sheet = sheet_of(tubes, LOOK, seed=5)
    measurer = index = None
    for i in range(20):
        pose = looking(1.0 + 0.25 * i, 40.0, at_mm=(0.8 * i, 0.3 * i))
        v = view(tubes, LOOK, pose=pose, seed=i, sheet=sheet)
        measurer = measurer or measurer_of(unknown_camera(v.optics), v.lattice)
        m = measurer.measure(v.image, i * PERIOD_NS, "progressive")[0]
        assert m.pose is not None
        assert Doubt.INDEX not in m.doubt
        now = index_of(v, m)
        assert index is None or now == index
        index = now


def index_of(v, m):
    """Where the sheet's own (0, 0), (0, 1) and (1, 0) are in the measurement's index."""
    told = []
    for row, column in ((0, 0), (0, 1), (1, 0)):
        place = v.sheet.centers_mm[row - v.sheet.first[0], column - v.sheet.first[1]]
        px = v.optics.project(v.rotation, v.translation_mm, place)
        nearest = int(np.argmin(np.hypot(*(m.tubes.center_px - px).T)))
        told.append((m.tubes.row[nearest], m.tubes.column[nearest]))
    return told
