import numpy as np
import pytest

from service.vision.camera import Camera, TsaiLens
from service.vision.lattice import Arrangement, Lattice
from service.vision.pose import fit_pose, prior_of
from service.vision.projection import project

LATTICE = Lattice(Arrangement.TRIANGULAR, 25.4, 8.46, 9.53, scatter_mm=0.05)
UNKNOWN = Camera((640, 240), (0.005625, 0.01125))
SHEET = np.array([
    [495.3, -2001.7], [635.0, -1935.7], [342.9, -1561.8], [406.4, -1539.8],
    [152.4, -1407.8], [482.6, -1363.8], [241.3, -1341.8], [101.6, -1231.8],
])  # fmt: skip
ROTATION = np.array([[0.95908, 0.14919, -0.24063], [-0.15762, 0.98737, -0.01610], [0.23519, 0.05337, 0.97048]])
T = np.array([-80.5, 53.9, 359.9])


def test_a_solution_never_steps_behind_the_camera():
    """With everything behind it, all centres are set aside, which cost less than the odd camera that it began with."""
    began = Camera(
        (640, 240), (0.005625, 0.01125), 1.512, TsaiLens(0.00382), (496.9, 630.3), 1.0,
    )  # fmt: skip
    seen = project(began.vector(), ROTATION, T, SHEET)
    assert np.isfinite(seen).all()
    covariance = np.tile([1.0, 0.15, 0.25], (len(SHEET), 1))
    for seed in range(30):
        away = np.random.default_rng(seed).normal(0, 0.4, seen.shape)
        fit = fit_pose(SHEET, seen + away, covariance, began, ROTATION, T, LATTICE, prior_of(UNKNOWN, 1.84))
        assert np.isfinite(fit.covariance).all()
        assert np.isfinite(fit.residual_px).all(axis=1).sum() > len(SHEET) / 2


def test_a_solution_may_start_with_most_points_behind_the_camera():
    """So does a steep pose told under a tele lens, begun anew under a usual one."""
    camera = Camera((640, 480), (0.005, 0.005), 6.4, TsaiLens(), (319.5, 239.5))
    across = np.arange(-4, 5) * LATTICE.pitch_mm
    sheet = np.array([[x, y] for x in across for y in across])
    steep = np.array([[1.0, 0, 0], [0, 0.5, -(0.75**0.5)], [0, 0.75**0.5, 0.5]])
    seen = project(camera.vector(), steep, np.array([0.0, 0, 250]), sheet)
    covariance = np.tile([0.01, 0.0, 0.01], (len(sheet), 1))
    fit = fit_pose(sheet, seen, covariance, camera, steep, np.array([0.0, 0, -30]), LATTICE, prior_of(camera))
    assert np.isfinite(fit.covariance).all()
    assert np.isfinite(fit.translation_mm).all()


@pytest.mark.parametrize(
    ("stray", "count", "least", "most"), [(0.5, 12, 0.5, 0.8), (0.5, 2, 0.7, 1.0), (2.0, 12, 1.7, 2.4)]
)
def test_sigmas_follow_how_far_centres_stray_but_few_centres_are_not_believed_to_stray_less(stray, count, least, most):
    camera = Camera((640, 480), (0.005, 0.005), 6.4, TsaiLens(), (319.5, 239.5))
    across = np.arange(-count / 2, count / 2 + 1) * LATTICE.pitch_mm
    sheet = np.array([[x, y] for x in across for y in across])
    T_far = np.array([0.0, 0.0, 700.0])
    seen = project(camera.vector(), np.eye(3), T_far, sheet)
    covariance = np.tile([0.3**2, 0.0, 0.3**2], (len(sheet), 1))
    exact = fit_pose(sheet, seen, covariance, camera, np.eye(3), T_far, LATTICE, prior_of(camera))
    known = np.linalg.inv(exact.covariance) * exact.unit
    assumed_px = np.hypot(0.3, LATTICE.scatter_mm * 1280 / 700)
    ratios = []
    for seed in range(20):
        away = np.random.default_rng(seed).normal(0, stray * assumed_px, seen.shape)
        fit = fit_pose(sheet, seen + away, covariance, camera, np.eye(3), T_far, LATTICE, prior_of(camera))
        ratios.append(np.sqrt(np.trace(fit.covariance @ known) / 6))
    assert least < np.median(ratios) < most
