"""Full calibration from coplanar points: least squares of the picture's residuals over pose, f, kappa1 and (Cx, Cy).

What Willson's `ccal_fo` seeks in the undistorted sensor plane is sought here in the picture, where the noise is, and
to the end of the flat valley that f, Tz and the principal point share. A plane shows its principal point by the lens's
distortion alone; so that an undistorted picture has an answer too, the point is expected near where `camera` has it,
and f near what Tsai's two stages then make of it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from service.vision.errors import DegenerateError
from service.vision.tsai import coplanar_start
from service.vision.tsai_model import CENTER_HELD, checked_points, judged, projected, weighted_jacobian
from service.vision.tsai_result import TsaiResult, with_values

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from service.vision.camera import Camera

    Array = NDArray[np.float64]

__all__ = ["calibrate_full", "tsai_polish"]

FEWEST_POINTS = 7
START_FOCAL_LENGTHS = (0.7, 1.5, 3.0, 6.0)
"""In widths of the sensor: from wide angle to tele."""
USUAL_FOCAL_LENGTH, FOCAL_LENGTH_SIGMA = 2.0, 1.5
"""What is expected where Tsai's stages fail, in widths of the sensor; one sigma of its logarithm: a factor of 4.5."""
CENTER_SIGMA = 0.15
"""How far the principal point may stand off, one sigma per axis, in picture widths."""
ITERATIONS = 300
EXACT_PX = 1e-9
"""Residuals below this are rounding."""


def calibrate_full(points_mm: Array, points_px: Array, camera: Camera) -> TsaiResult:
    """Calibrate pose, f, kappa1 and principal point from points of one plane; sx stays as `camera` has it.

    Parameters
    ----------
    points_mm
        (n, 2) sheet points, or (n, 3) of one height. The origin may be anywhere.
    points_px
        (n, 2) where they are in the picture.
    camera
        As for `calibrate_coplanar`; the principal point is sought about its.

    Raises
    ------
    DegenerateError
        The points do not determine an answer.
    """
    return _calibrate("full", points_mm, points_px, camera)


def tsai_polish(points_mm: Array, points_px: Array, camera: Camera) -> TsaiResult:
    """As `calibrate_full`, with the principal point of `camera` taken as known and nothing expected of f."""
    return _calibrate("polish", points_mm, points_px, camera)


def _calibrate(method: str, points_mm: Array, points_px: Array, camera: Camera) -> TsaiResult:
    sheet, picture = checked_points(points_mm, points_px, FEWEST_POINTS)
    tsai, center = _tsai_start(sheet, picture, camera), camera.principal_point_px or camera.middle_px
    usual_mm = USUAL_FOCAL_LENGTH * camera.image_size_px[0] * camera.pixel_pitch_mm[0]
    expected = tsai.camera if tsai else with_values(camera, usual_mm, 0.0, center)
    starts = [*([tsai] if tsai else []), *_flat_starts(sheet, picture, camera, center)]
    found = [_minimum(replace(start, method=method), sheet, picture, expected) for start in starts]
    lowest, best = min(found, key=lambda pair: pair[0], default=(math.inf, None))
    if best is None or lowest == math.inf:
        raise DegenerateError("no view of a plane resembles the points; check that both columns list the same points")
    return judged(best, sheet, picture, _expectation(best, expected)[1])


def _expectation(result: TsaiResult, expected: Camera) -> tuple[Array, Array]:
    """How far a result is from what one expects before seeing the points, in sigmas, and the derivatives of that."""
    if result.method == "polish":
        return np.zeros(0), CENTER_HELD
    width = result.camera.image_size_px[0]
    off = (np.array(result.principal_point_px) - (expected.principal_point_px or (0, 0))) / (CENTER_SIGMA * width)
    focal = math.log(result.focal_length_mm / (expected.focal_length_mm or 1.0)) / FOCAL_LENGTH_SIGMA
    slopes = np.zeros((3, 10))
    slopes[0, 6] = 1 / (result.focal_length_mm * FOCAL_LENGTH_SIGMA)
    slopes[1, 8] = slopes[2, 9] = 1 / (CENTER_SIGMA * width)
    return np.array([focal, *off]), slopes


def _tsai_start(sheet: Array, picture: Array, camera: Camera) -> TsaiResult | None:
    """Tsai's answer, with the sheet's origin where his linear stage likes it."""
    _, cy = camera.principal_point_px or camera.middle_px
    origin = sheet[np.argmax(np.abs(picture[:, 1] - cy))]
    try:
        start = coplanar_start(sheet - origin, picture, camera)
    except DegenerateError:
        return None
    return replace(start, doubts=(), translation_mm=start.translation_mm - start.rotation @ origin)


def _flat_starts(sheet: Array, picture: Array, camera: Camera, center_px: tuple[float, float]) -> Iterator[TsaiResult]:
    """What the sheet's homography makes of some f, without distortion."""
    sensor = (picture - center_px) * camera.pixel_pitch_mm / np.array([camera.sx or 1.0, 1.0])
    for widths in START_FOCAL_LENGTHS:
        f = widths * camera.image_size_px[0] * camera.pixel_pitch_mm[0]
        if pose := _pose(sheet, sensor / f):
            yield TsaiResult("tsai", with_values(camera, f, 0.0, center_px), *pose)


def _pose(sheet: Array, normalised: Array) -> tuple[Array, Array] | None:
    """Pose of the sheet from its homography to normalised coordinates, if any; the lens is left out of account."""
    middle, spread = sheet.mean(axis=0), sheet[:, :2].std()
    plane = (sheet[:, :2] - middle[:2]) / spread
    found = cv2.findHomography(plane, normalised)[0]
    if found is None or np.shape(found) != (3, 3) or not abs(np.linalg.det(found[:2, :2])) > 0:
        return None
    H = np.asarray(found, np.float64)
    H = H / math.copysign(math.sqrt(float(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))), float(H[2, 2]))
    left, _, right = np.linalg.svd(np.column_stack((H[:, :2], np.cross(H[:, 0], H[:, 1]))))
    R = left @ right
    return R, H[:, 2] * spread - R @ middle


def _minimum(start: TsaiResult, sheet: Array, picture: Array, expected: Camera) -> tuple[float, TsaiResult]:
    """Lowest cost from a start on, and where: Levenberg-Marquardt, to the last digits."""

    def cost(result: TsaiResult, residuals: Array) -> float:
        """``2 n log(mean square)``, as of a noise not known beforehand, and the expectation's squares."""
        mean_square = float((residuals**2).mean())
        if not (math.isfinite(mean_square) and result.focal_length_mm > 0):
            return math.inf
        off = _expectation(result, expected)[0]
        return residuals.size * math.log(mean_square + EXACT_PX**2) + float((off**2).sum())

    result, damping = start, 1e-3
    residuals = projected(result, sheet) - picture
    lowest = cost(result, residuals)
    for _ in range(ITERATIONS if math.isfinite(lowest) else 0):
        noise_px = math.sqrt(float((residuals**2).mean()) + EXACT_PX**2)
        off, slopes = _expectation(result, expected)
        J = weighted_jacobian(result, sheet, noise_px * slopes)
        aim = -np.append(residuals, noise_px * off)
        gain = 0.0
        while not gain > 0 and damping < 1e12:
            trial = _moved(result, _damped_step(J, aim, damping))
            there = projected(trial, sheet) - picture
            gain = lowest - cost(trial, there)
            damping *= 10
        if gain > 0:
            result, residuals, lowest, damping = trial, there, lowest - gain, max(damping / 100, 1e-15)
        if gain < 1e-11:
            break
    return lowest, result


def _damped_step(J: Array, aim: Array, damping: float) -> Array:
    """Least-squares step of Marquardt's damped system, (10,), each column in its own scale."""
    scale = np.linalg.norm(J, axis=0)
    damped = np.vstack((J / scale, math.sqrt(damping) * np.eye(len(scale))))
    step = np.zeros(10)
    step[: len(scale)] = np.linalg.lstsq(damped, np.append(aim, np.zeros(len(scale))))[0] / scale
    return step


def _moved(result: TsaiResult, step: Array) -> TsaiResult:
    """Result after a step of `jacobian`'s parameters."""
    cx, cy = result.principal_point_px
    return replace(
        result,
        rotation=cv2.Rodrigues(step[:3])[0] @ result.rotation,
        translation_mm=result.translation_mm + step[3:6],
        camera=with_values(
            result.camera,
            result.focal_length_mm + step[6],
            result.kappa1_per_mm2 + step[7],
            (cx + step[8], cy + step[9]),
        ),
    )
