"""Cameras of which little is known: what a picture tells is told, and what it cannot tell shows in sigma and doubt."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.scene import NOMINAL
from service.vision.camera import OpenCVLens, TsaiLens
from service.vision.measurement import Doubt, Lock, TubeState
from tests.scenes.rendered import (
    camera_of,
    errors_of,
    film,
    follow,
    looking,
    measurer_of,
    optics_of,
    unknown_camera,
    view,
)

REAL = replace(NOMINAL, hose=False, lane_rows=0)
TILTS = [0, 3, 12, 25, 40]


@pytest.mark.parametrize("tilt_deg", TILTS)
@pytest.mark.parametrize("tubes", ["system80", "model-f"])
def test_tubes_are_found_as_well_without_a_camera(tubes, tilt_deg):
    seen = view(tubes, REAL, pose=looking(tilt_deg), bend=0.02)
    m = seen.measure(unknown_camera(seen.optics))
    assert m.lock is not Lock.NONE, m.reason
    e = errors_of(seen, m)
    assert e.index_share == 1.0
    assert e.missed == 0
    assert np.sqrt(np.mean(e.measured_px**2)) < 0.2


@pytest.mark.parametrize("tilt_deg", TILTS)
def test_a_distance_that_one_picture_cannot_tell_is_in_doubt_and_its_sigma_says_how_far(tilt_deg):
    seen = view(look=REAL, pose=looking(tilt_deg))
    m = seen.measure(unknown_camera(seen.optics))
    assert Doubt.SCALE in m.doubt
    assert m.lock is Lock.PARTIAL
    error, sigma = errors_of(seen, m).distance_mm
    assert sigma > 0.02 * m.pose.distance_mm
    assert abs(error) < 4 * sigma
    focal = seen.optics.focal_length_mm
    assert abs(m.pose.camera.focal_length_mm - focal) < 4 * m.pose.sigma.focal_length_mm
    if tilt_deg <= 3:
        assert m.pose.sigma.focal_length_mm > 0.1 * m.pose.camera.focal_length_mm


def test_distance_over_focal_length_is_told_even_so():
    seen = view(look=REAL, pose=looking(3.0))
    m = seen.measure(unknown_camera(seen.optics))
    true = seen.rotation[:, 2] @ seen.translation_mm / seen.optics.focal_length_mm
    assert m.pose.distance_mm / m.pose.camera.focal_length_mm == pytest.approx(true, rel=0.01)


@pytest.mark.parametrize(
    "unknown", [{"focal_length_mm": None}, {"lens": None}, {"principal_point_px": None}, {"sx": None}], ids=str
)
def test_one_thing_unknown_is_estimated_with_its_sigma(unknown):
    seen = view(look=REAL, pose=looking(12.0), bend=0.02)
    m = seen.measure(camera_of(seen.optics, **unknown))
    assert m.lock is not Lock.NONE
    assert m.pose.camera.complete
    exact = seen.measure()
    assert m.pose.sigma.distance_mm > 0.7 * exact.pose.sigma.distance_mm
    assert abs(m.pose.distance_mm - exact.pose.distance_mm) < 4 * m.pose.sigma.distance_mm


def test_what_is_told_is_kept():
    seen = view(look=REAL, pose=looking(12.0), bend=0.02)
    camera = camera_of(seen.optics, lens=None)
    pose = seen.measure(camera).pose
    assert pose.camera.focal_length_mm == camera.focal_length_mm
    assert pose.camera.principal_point_px == camera.principal_point_px
    assert pose.sigma.focal_length_mm == 0.0


def test_the_same_places_are_followed_through_a_video_with_no_camera():
    poses = [looking(10.0, at_mm=(0.2 * 25.4 * k, 0.0)) for k in range(16)]
    views = film(poses, look=REAL, size_px=(240, 180), pitch_px=24.0)
    answers = follow(views, measurer_of(unknown_camera(views[0].optics), views[0].lattice))
    assert {m.lock for m in answers} == {Lock.PARTIAL}
    assert not any(Doubt.INDEX in m.doubt for m in answers)
    true_of = {}
    for seen, m in zip(views, answers, strict=True):
        actual_px = seen.optics.project(seen.rotation, seen.translation_mm, seen.sheet.centers_mm.reshape(-1, 3))
        nearest = np.linalg.norm(m.tubes.center_px[:, None] - actual_px[None], axis=2).argmin(axis=1)
        for told, true in zip(zip(m.tubes.row.tolist(), m.tubes.column.tolist(), strict=True), nearest, strict=True):
            assert true_of.setdefault(told, true) == true
    assert len(true_of) > 1.2 * len(answers[0].tubes)


WIDE = replace(
    optics_of((640, 480), pitch_px=24.0, distance_mm=500.0, opencv=True),
    opencv_distortion=(-0.29, 0.085, 0.0, 0.0, 0.0),
)
"""A lens as OpenCV describes it, which Tsai's one term misses by 2 px at the picture's edges."""


@pytest.mark.parametrize("tilt_deg", [5.0, 14.0])
def test_tubes_are_found_to_the_edges_of_a_wide_picture_of_two_terms(tilt_deg):
    seen = view(look=REAL, optics=WIDE, pose=looking(tilt_deg, distance_mm=500.0))
    m = seen.measure(unknown_camera(WIDE))
    e = errors_of(seen, m)
    assert isinstance(m.pose.camera.lens, OpenCVLens)
    assert e.index_share == 1.0
    assert e.missed == 0
    assert len(e.measured_px) > 0.97 * np.count_nonzero(e.states[:, 1] == TubeState.OPEN)
    assert np.sqrt(np.mean(e.measured_px**2)) < 0.2
    focal, sigma = WIDE.focal_length_mm, m.pose.sigma.focal_length_mm
    assert abs(m.pose.camera.focal_length_mm - focal) < 4 * sigma < 0.3 * focal


def test_a_video_is_followed_with_the_two_terms_once_found():
    poses = [looking(10.0, distance_mm=500.0, at_mm=(2.0 * k, 0.0)) for k in range(4)]
    views = film(poses, look=REAL, optics=WIDE)
    answers = follow(views, measurer_of(unknown_camera(WIDE), views[0].lattice))
    for seen, m in zip(views, answers, strict=True):
        assert isinstance(m.pose.camera.lens, OpenCVLens)
        assert np.sqrt(np.mean(errors_of(seen, m).measured_px ** 2)) < 0.2
    assert not any(Doubt.INDEX in m.doubt for m in answers)


@pytest.mark.parametrize("bend", [0.0, 0.04, 0.25])
def test_a_lens_of_one_term_is_told_as_one(bend):
    seen = view(look=REAL, pose=looking(12.0), bend=bend)
    assert isinstance(seen.measure(unknown_camera(seen.optics)).pose.camera.lens, TsaiLens)
