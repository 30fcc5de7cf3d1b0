import math

import numpy as np
import pytest

from service.vision.camera import Camera, OpenCVLens, TsaiLens
from service.vision.lattice import Arrangement, Lattice
from service.vision.measurement import Pose, PoseSigma, Tubes
from service.vision.outlines import TubeKind, kinds, rim_ellipses, rim_outlines
from service.vision.projection import project, undistort

LATTICE = Lattice(Arrangement.TRIANGULAR, 25.4, 8.4, 9.5)


def pose(lens=None, tilt_deg=0.0, distance_mm=600.0):
    c, s = math.cos(math.radians(tilt_deg)), math.sin(math.radians(tilt_deg))
    rotation = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    camera = Camera((640, 480), (0.0056, 0.0056), 8.0, lens or TsaiLens(), (310.0, 244.0))
    sigma = PoseSigma(0.1, 0.1, 0.1, 0.1, 0.0)
    return Pose(rotation, np.array([3.0, -5.0, distance_mm]), camera, np.eye(6), sigma, 0.1)


def tubes_at(pose, rows, columns, shift_px=(0.0, 0.0)):
    row, column = np.array(rows, np.int32), np.array(columns, np.int32)
    centers = project(pose.camera.vector(), pose.rotation, pose.translation_mm, LATTICE.sheet_points(row, column))
    ones = np.ones(len(row), np.uint8)
    return Tubes(row, column, centers + shift_px, np.full(len(row), 0.05), ones, ones)


def test_seen_straight_on_a_rim_is_a_circle_of_the_right_size():
    p = pose()
    tubes = tubes_at(p, [0, 2, -3], [0, 1, 4])
    outlines = rim_outlines(p, LATTICE, tubes, 30)
    assert outlines.shape == (3, 30, 2)
    radius = np.linalg.norm(outlines - tubes.center_px[:, None], axis=2)
    np.testing.assert_allclose(radius, 8.4 * 8.0 / 0.0056 / 600, rtol=1e-12)


@pytest.mark.parametrize("lens", [TsaiLens(0.004), TsaiLens(-0.004), OpenCVLens((-0.3, 0.1, 0.001, 0.0, 0.0))])
def test_back_on_the_sheet_every_point_is_a_rim_radius_from_its_tube(lens):
    p = pose(lens, tilt_deg=25)
    outlines = rim_outlines(p, LATTICE, tubes_at(p, [0, 3], [-4, 2]))
    v = p.camera.vector()
    rays = undistort(v, outlines.reshape(-1, 2))
    rays = np.column_stack([rays, np.ones(len(rays))]) @ p.rotation  # sheet frame
    eye = -p.rotation.T @ p.translation_mm
    sheet = eye[:2] - rays[:, :2] * (eye[2] / rays[:, 2:])
    centers = LATTICE.sheet_points(np.array([0, 3]), np.array([-4, 2]))
    distance = np.linalg.norm(sheet.reshape(2, -1, 2) - centers[:, None], axis=2)
    np.testing.assert_allclose(distance, 8.4, rtol=1e-9)


def test_a_measured_tube_is_drawn_where_it_was_seen():
    p = pose(tilt_deg=10)
    nominal = rim_outlines(p, LATTICE, tubes_at(p, [1], [1]))
    seen = rim_outlines(p, LATTICE, tubes_at(p, [1], [1], shift_px=(0.7, -0.4)))
    np.testing.assert_allclose(seen - nominal, np.broadcast_to([0.7, -0.4], seen.shape), atol=1e-12)


def test_no_tubes_have_no_outlines():
    assert rim_outlines(pose(), LATTICE, Tubes.none()).shape == (0, 24, 2)


def test_behind_the_camera_there_is_nothing_to_draw():
    p = pose(distance_mm=-600.0)
    assert np.isnan(rim_outlines(p, LATTICE, tubes_at(p, [0], [0]))).all()


@pytest.mark.parametrize("lens", [TsaiLens(), TsaiLens(0.004), OpenCVLens((-0.3, 0.1, 0.001, 0.0, 0.0))])
def test_the_ellipses_follow_the_outlines_to_a_fraction_of_a_pixel(lens):
    p = pose(lens, tilt_deg=25)
    tubes = tubes_at(p, [0, 3], [-4, 2])
    outlines, ellipses = rim_outlines(p, LATTICE, tubes, 24), rim_ellipses(p, LATTICE, tubes).reshape(2, 3, 2)
    angles = np.arange(24) * (2 * math.pi / 24)
    c, u, v = ellipses[:, 0, None], ellipses[:, 1, None], ellipses[:, 2, None]
    drawn = c + u * np.cos(angles)[:, None] + v * np.sin(angles)[:, None]
    assert np.linalg.norm(drawn - outlines, axis=2).max() < 0.15
    assert np.isnan(rim_ellipses(pose(distance_mm=-600.0), LATTICE, tubes)).all()


def test_a_plug_is_drawn_as_one_whether_or_not_it_was_measured():
    tubes = Tubes(
        *(np.zeros(5, np.int32),) * 2, np.zeros((5, 2)), np.zeros(5), np.array([1, 0, 1, 0, 0], np.uint8),
        np.array([1, 0, 2, 2, 3], np.uint8),
    )  # fmt: skip
    expected = [TubeKind.MEASURED, TubeKind.PREDICTED, TubeKind.PLUGGED, TubeKind.PLUGGED, TubeKind.ABSENT]
    assert kinds(tubes).tolist() == expected
