"""Tsai's camera over a plane: how it projects, and how well points determine it.

R. Y. Tsai, "A versatile camera calibration technique", IEEE J. Robotics and Automation RA-3, 1987; with Willson's
horizontal scale sx.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from service.vision.errors import DegenerateError
from service.vision.projection import project
from service.vision.tsai_result import TsaiResult, TsaiSigma

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

__all__ = ["CENTER_HELD", "checked_points", "jacobian", "judged", "projected", "weighted_jacobian"]

ROUNDING_PX = 1e-6
"""Points are never known better than this: what even so little noise leaves open is degenerate, noise-free or not."""
CENTER_HELD = np.zeros((0, 8))
"""Expectation of one who knows the principal point, and nothing else."""
DOUBTFUL = 0.05
UNDETERMINED = 1.3
"""Relative sigmas of f beyond which an answer says so, and beyond which there is none."""
OUTLYING = 6.0
"""Times the median distance; noise gets to 3."""


def checked_points(
    points_mm: NDArray[np.float64], points_px: NDArray[np.float64], minimum: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sheet points, (n, 3) mm of one height, and picture points, (n, 2) px, fit for calibration.

    Raises
    ------
    DegenerateError
        Too few, not finite, not of one height, or on a line.
    """
    sheet = np.asarray(points_mm, np.float64)
    picture = np.ascontiguousarray(points_px, np.float64)
    if sheet.ndim != 2 or sheet.shape[1] not in (2, 3) or picture.shape != (len(sheet), 2):
        raise ValueError(f"points_mm {sheet.shape} and points_px {picture.shape} must be (n, 2 or 3) and (n, 2)")
    sheet = np.column_stack((sheet, np.zeros((len(sheet), 3 - sheet.shape[1]))))
    if bad := np.flatnonzero(~np.isfinite(np.column_stack((sheet, picture))).all(axis=1)).tolist():
        raise DegenerateError(f"point {bad[0] + 1} of {len(sheet)} is not finite; leave it out")
    if (different := len(np.unique(sheet, axis=0))) < minimum:
        raise DegenerateError(f"{different} different points; give at least {minimum}")
    if np.ptp(sheet[:, 2]) > 1e-6:
        raise DegenerateError(f"zw runs from {sheet[:, 2].min():g} to {sheet[:, 2].max():g}; give points of one plane")
    for points, where, least in ((sheet, "sheet", 1e-6), (picture, "picture", 1e-3)):
        widths = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if not widths[1] > least * widths[0]:
            raise DegenerateError(f"the points lie on one line of the {where}; give points of several rows")
    return sheet, picture


def projected(result: TsaiResult, sheet_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Picture points, (n, 2) px, of sheet points, (n, 3) mm; NaN rows behind the camera or beyond the lens's fold."""
    return np.asarray(project(result.camera.vector(), result.rotation, result.translation_mm, sheet_mm))


def jacobian(result: TsaiResult, sheet_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivatives of `projected`, (n, 2, 10): turn (rad, camera frame), translation, f, kappa1, Cx, Cy."""
    f, kappa1 = result.focal_length_mm, result.kappa1_per_mm2
    scale = np.array([result.sx, 1.0]) / result.camera.pixel_pitch_mm
    turned = sheet_mm @ result.rotation.T
    x, y, z = (turned + result.translation_mm).T
    distorted = (projected(result, sheet_mm) - result.principal_point_px) / scale
    r2 = (distorted**2).sum(axis=1)

    undistorted = np.zeros((len(sheet_mm), 2, 8))
    undistorted[:, 0, 3] = undistorted[:, 1, 4] = f / z
    undistorted[:, 0, 5], undistorted[:, 1, 5] = -f * x / z**2, -f * y / z**2
    undistorted[:, :, :3] = np.cross(turned[:, None, :], undistorted[:, :, 3:6])
    undistorted[:, 0, 6], undistorted[:, 1, 6] = x / z, y / z
    undistorted[:, :, 7] = -distorted * r2[:, None]

    # undistorted = distorted (1 + kappa1 r_d^2), solved for the change of distorted
    slope = (1 + kappa1 * r2)[:, None, None] * np.eye(2) + 2 * kappa1 * distorted[:, :, None] * distorted[:, None, :]
    out = np.zeros((len(sheet_mm), 2, 10))
    out[:, :, :8] = scale[:, None] * np.linalg.solve(slope, undistorted)
    out[:, 0, 8] = out[:, 1, 9] = 1.0
    return out


def judged(
    result: TsaiResult,
    sheet_mm: NDArray[np.float64],
    points_px: NDArray[np.float64],
    expectation: NDArray[np.float64] = CENTER_HELD,
) -> TsaiResult:
    """Complete a result with its residuals and sigmas.

    Parameters
    ----------
    expectation
        As `weighted_jacobian` takes it.

    Raises
    ------
    DegenerateError
        The answer does not project the points at all, or f is not determined.
    """
    residuals = projected(result, sheet_mm) - points_px
    if lost := int(np.isnan(residuals).any(axis=1).sum()):
        raise DegenerateError(
            f"the answer (f = {result.focal_length_mm:.4g} mm, kappa1 = {result.kappa1_per_mm2:.4g}, Tz = "
            f"{result.translation_mm[2]:.4g} mm) cannot picture {lost} of {len(residuals)} points; check their order, "
            f"the pixel pitch and the principal point{_way_out(result)}"
        )
    total = float((residuals**2).sum())
    noise_px = math.sqrt(max(total / max(residuals.size - expectation.shape[1], 1), ROUNDING_PX**2))
    sigma = _sigma(result, weighted_jacobian(result, sheet_mm, noise_px * expectation), noise_px)
    if not sigma.focal_length_mm < UNDETERMINED * result.focal_length_mm:
        raise DegenerateError(
            f"f and Tz cannot be told apart: f = {result.focal_length_mm:.4g} mm, sigma {sigma.focal_length_mm:.3g}, "
            f"at a tilt of {result.tilt_deg:.2f} deg (only Tz / f = {result.tz_over_f:.4f} is known); tilt the camera "
            f"by 7 deg or more, give more points, check the principal point{_way_out(result)}"
        )
    result = replace(result, sum_of_squares_px2=total, points=len(sheet_mm), sigma=sigma)
    return replace(result, doubts=(*result.doubts, *_doubts(result, np.linalg.norm(residuals, axis=1))))


def _doubts(result: TsaiResult, distances_px: NDArray[np.float64]) -> Iterator[str]:
    relative = result.sigma.focal_length_mm / result.focal_length_mm
    if relative > DOUBTFUL:
        yield (
            f"f and Tz are known to {100 * relative:.0f} % only (tilt {result.tilt_deg:.1f} deg), though Tz / f is not "
            "touched by that; tilt the camera further or give f"
        )
    worst = int(np.argmax(distances_px))
    if distances_px[worst] > max(OUTLYING * float(np.median(distances_px)), 0.01):
        yield f"point {worst + 1} lies {distances_px[worst]:.3g} px off, far more than the others; check it"
    if result.rotation[2, 2] < 0:
        yield "the sheet's Z axis points towards the camera; mirror yw if it should point away"


def _way_out(result: TsaiResult) -> str:
    return "" if result.method == "full" else ", or use the full method"


def weighted_jacobian(
    result: TsaiResult, sheet_mm: NDArray[np.float64], expectation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`jacobian` as a matrix, with the rows of an expectation below it.

    `expectation`, (m, 8 or 10), says what is known beforehand of `jacobian`'s parameters, in the unit of the noise;
    with 8 columns the principal point is held.
    """
    J = jacobian(result, sheet_mm).reshape(-1, 10)
    return np.vstack((J[:, : expectation.shape[1]], expectation))


def _sigma(result: TsaiResult, J: NDArray[np.float64], noise_px: float) -> TsaiSigma:
    scale = np.linalg.norm(J, axis=0)
    _, s, axes = np.linalg.svd(J / scale, full_matrices=False)
    root = np.zeros((10, len(s)))
    with np.errstate(divide="ignore", invalid="ignore"):
        root[: len(s)] = (axes.T / s) / scale[:, None] * noise_px
    f, tz = result.focal_length_mm, float(result.translation_mm[2])
    deviation = np.linalg.norm(root, axis=1).tolist()
    return TsaiSigma(
        focal_length_mm=deviation[6],
        kappa1_per_mm2=deviation[7],
        principal_point_px=(deviation[8], deviation[9]),
        tz_mm=deviation[5],
        tz_over_f=float(np.linalg.norm(root[5] / f - root[6] * tz / f**2)),
    )
