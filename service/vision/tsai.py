"""Tsai's coplanar calibration, step for step as Willson's `ccal` does it.

Linear stage for R, Tx, Ty from the radial alignment constraint; then (Tz, f, kappa1) by Levenberg-Marquardt on the
distances in the undistorted sensor plane. A distance shows the optimiser half of its curvature, so that steps overshoot
and the last bit can decide where, up to 2e-3 off the minimum, it stops. Sums are therefore taken in Willson's
order, and MINPACK is run with his tolerances and difference steps: the answer is his to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import leastsq

from service.vision.errors import DegenerateError
from service.vision.tsai_model import checked_points, judged
from service.vision.tsai_result import TsaiResult, TsaiSigma, with_values

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera

    Array = NDArray[np.float64]

__all__ = ["TsaiResult", "TsaiSigma", "calibrate_coplanar", "coplanar_start"]

FEWEST_POINTS = 5
UNEXPLAINED = 0.3
"""Share of the picture's x that the linear stage may leave unexplained. Up to here simulated answers are as good as
with the best origin; a world origin on the camera's x axis gives 0.7 and answers wrong by 10 %."""
PARALLEL, NEARLY_PARALLEL = 2.0, 5.0
"""Sigmas by which the tilt's cosine is off 1, below which there is no answer, and below which it comes with a doubt:
noise alone, which always tilts, gets to 2 in one of seven sets and to 5 in none."""
EDGE_ON = 1e-3
DIFFERENCE_STEP = 1e-8


def calibrate_coplanar(points_mm: Array, points_px: Array, camera: Camera) -> TsaiResult:
    """Calibrate from points of one plane, with the principal point and sx of `camera` as they are.

    Parameters
    ----------
    points_mm
        (n, 2) sheet points, or (n, 3) of one height.
    points_px
        (n, 2) where they are in the picture.
    camera
        Gives pixel pitch, sx (1 if unknown) and principal point (the picture's middle if unknown).

    Raises
    ------
    DegenerateError
        The points do not determine an answer; see `coplanar_start` and `judged`.
    """
    sheet, picture = checked_points(points_mm, points_px, FEWEST_POINTS)
    return judged(coplanar_start(sheet, picture, camera), sheet, picture)


def coplanar_start(sheet_mm: Array, points_px: Array, camera: Camera) -> TsaiResult:
    """`calibrate_coplanar` of checked points, (n, 3) mm and (n, 2) px, without judging the answer.

    Raises
    ------
    DegenerateError
        The sheet's origin stands on the camera's x axis, the sheet is parallel to the picture, or f and Tz come out
        with different signs.
    """
    (dx, dy), sx, (cx, cy) = camera.pixel_pitch_mm, camera.sx or 1.0, camera.principal_point_px or camera.middle_px
    sensor = np.array([dx * (points_px[:, 0] - cx) / sx, dy * (points_px[:, 1] - cy)])
    x, y = sheet_mm[:, :2].T.copy()
    rotation, tx, ty, significance = _aligned(x, y, sensor)
    (r1, r2, _), (r4, r5, _), (r7, r8, _) = rotation
    seen = np.array([r1 * x + r2 * y + tx, r4 * x + r5 * y + ty, r7 * x + r8 * y])
    (f, tz), _ = _least_squares(np.column_stack((seen[1], -sensor[1])), seen[2] * sensor[1])
    if f < 0:  # the other of the two rotations that agree with the linear stage
        rotation[:2, 2] *= -1
        rotation[2, :2] *= -1
        seen[2] *= -1
        f, tz = -f, -tz
    f, tz, kappa1 = _refined(seen, sensor, [f, tz, 0.0])
    if not (f > 0 and tz > 0):
        raise DegenerateError(
            f"f = {f:.4g} mm and Tz = {tz:.4g} mm must both be positive; the points are not one view of a plane, or "
            "leave f open: check their order, handedness and the principal point, or use the full method"
        )
    translation = np.array([tx, ty, tz]) - rotation[:, 2] * sheet_mm[0, 2]
    result = TsaiResult("tsai", with_values(camera, f, kappa1, (cx, cy)), rotation, translation)
    if significance < NEARLY_PARALLEL:
        doubt = f"the tilt of {result.tilt_deg:.1f} deg may be noise ({significance:.1f} sigma), and f and Tz with it"
        result = replace(result, doubts=(doubt,))
    return result


def _aligned(x: Array, y: Array, sensor: Array) -> tuple[Array, float, float, float]:
    """R, Tx, Ty and the tilt's significance from radial alignment.

    Camera point and picture point lie in one direction from the optical axis.

    Solves ``Yd (r1 x + r2 y + Tx) = Xd (r4 x + r5 y + Ty)`` divided by Ty, which then follows from R's orthogonality:
    the 2 x 2 corner of a rotation has 1 for its larger singular value.
    """
    xd, yd = sensor
    M = np.column_stack((yd * x, yd * y, yd, -xd * x, -xd * y))
    u, inverse = _least_squares(M, xd)
    unexplained = float(np.linalg.norm(M @ u - xd))
    if not unexplained < UNEXPLAINED * float(np.linalg.norm(xd)):
        raise DegenerateError(
            "the linear stage does not explain the points: the sheet's origin is pictured on or near the row of the "
            "principal point (Ty = 0), or the points are in a wrong order; move the origin by some pitches along yw "
            "and xw, or use the full method"
        )
    corner = np.array([[u[0], u[1]], [u[3], u[4]]])
    variance = unexplained**2 / max(len(xd) - 5, 1)
    significance = _tilt_significance(corner, inverse[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])] * variance)
    squares, determinant = _sum(corner.ravel() ** 2), u[0] * u[4] - u[3] * u[1]
    det2 = determinant * determinant
    ty = math.sqrt((squares - math.sqrt(max(0.0, squares * squares - 4 * det2))) / (2 * det2))
    if (xd * (u[0] * x + u[1] * y + u[2]) + yd * (u[3] * x + u[4] * y + 1)).sum() < 0:
        ty = -ty  # or the points would be pictured on the far side of the axis
    R = np.empty((3, 3))
    R[:2, :2] = corner * ty
    R[:2, 2] = np.sqrt(np.maximum(0.0, 1 - R[:2, 0] ** 2 - R[:2, 1] ** 2))
    if R[0, 0] * R[1, 0] + R[0, 1] * R[1, 1] > 0:
        R[1, 2] *= -1
    R[2] = np.cross(R[0], R[1])
    return R, float(u[2] * ty), ty, significance


def _tilt_significance(corner: Array, covariance: Array) -> float:
    """Sigmas by which the tilt's cosine is off 1; `covariance`, (4, 4), is of the corner's elements in their order."""
    left, (larger, smaller), right = np.linalg.svd(corner)
    cosine = smaller / larger
    slope = (np.outer(left[:, 1], right[1]) - cosine * np.outer(left[:, 0], right[0])).ravel() / larger
    sigma = max(math.sqrt(max(float(slope @ covariance @ slope), 0.0)), 1e-13)
    if not cosine > EDGE_ON:
        raise DegenerateError(f"the sheet is seen edge-on (cosine of the tilt {cosine:.2g}); check the points' order")
    if not 1 - cosine > PARALLEL * sigma:
        raise DegenerateError(
            f"the sheet looks parallel to the picture (cosine of the tilt {cosine:.6f}, sigma {sigma:.2g}): f and Tz "
            "cannot be told apart; tilt the camera by 7 deg or more against the sheet, or give more points"
        )
    return float((1 - cosine) / sigma)


def _refined(seen: Array, sensor: Array, start: list[float]) -> tuple[float, float, float]:
    """F, Tz, kappa1 by least distances in the undistorted sensor plane; `seen`, (3, n), is xc, yc and zc - Tz."""
    (xc, yc, depth), (xd, yd) = seen, sensor
    r2 = xd * xd + yd * yd

    def distances(p: Array) -> Array:
        zc, stretch = depth + p[1], 1 + p[2] * r2
        return np.asarray(np.hypot(p[0] * xc / zc - xd * stretch, p[0] * yc / zc - yd * stretch))

    def slopes(p: Array) -> Array:
        here = distances(p)
        steps = np.where(p == 0, 1.0, np.abs(p)) * DIFFERENCE_STEP
        return np.array([(distances(p + step) - here) / step.sum() for step in np.diag(steps)])

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        f, tz, kappa1 = leastsq(
            distances, start, Dfun=slopes, col_deriv=True, full_output=True,
            ftol=1e-5, xtol=1e-7, gtol=0.0, maxfev=3000,
        )[0]  # fmt: skip
    return float(f), float(tz), float(kappa1)


def _sum(terms: Array) -> Array:
    """Sum along the first axis, one after the other: numpy's own adds in pairs."""
    return np.asarray(np.cumsum(terms, axis=0)[-1])


def _least_squares(M: Array, b: Array) -> tuple[Array, Array]:
    """``(M^T M)^-1 M^T b``, and ``(M^T M)^-1``."""
    inverse = _inverse(_sum(M[:, :, None] * M[:, None, :]))
    return _sum(_sum(inverse.T[:, None, :] * M.T[:, :, None]) * b[:, None]), inverse


def _inverse(matrix: Array) -> Array:
    """Inverse by Gauss-Jordan elimination with full pivoting."""
    a, size = matrix.copy(), len(matrix)
    swaps: list[tuple[int, int, int]] = []
    for k in range(size):
        i, j = (k + int(v) for v in np.unravel_index(np.argmax(np.abs(a[k:, k:])), (size - k, size - k)))
        swaps.append((k, i, j))
        a[[k, i]] = a[[i, k]]
        a[:, [k, j]] = a[:, [j, k]]
        pivot, row = a[k, k], a[k].copy()
        if pivot == 0:
            raise DegenerateError("the points leave the linear stage open; give points of several rows and columns")
        column = a[:, k] / pivot
        row[k] = column[k] = 0.0
        a -= np.outer(column, row)
        a[:, k], a[k] = -column, row / pivot
        a[k, k] = 1 / pivot
    for k, i, j in reversed(swaps):
        a[:, [k, i]] = a[:, [i, k]]
        a[[k, j]] = a[[j, k]]
    return a
