"""What a calibration does not know yet, and which move of the camera would tell it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np

from service.vision.pose import PARAMETERS, POSE, linearise
from service.vision.sites import sites_in_picture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.selfcalibration import Calibration

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Missing", "missing"]

FOCAL = 1e-3
"""The focal length is known when its sigma is this part of it: 1 mm at 1 m."""
CENTER = 5e-3
"""The same of the principal point, in picture widths."""
SX = 3e-4
TILT_DEG = 10.0
HELPS = 0.9
"""A move is worth advising that brings the worst sigma below this part of it."""
MOVES: tuple[tuple[str, tuple[float, float], float, float], ...] = (
    ("tilt the camera 10 deg about the picture's vertical, right side nearer", (0.0, TILT_DEG), 0.0, 1.0),
    ("tilt the camera 10 deg about the picture's vertical, left side nearer", (0.0, -TILT_DEG), 0.0, 1.0),
    ("tilt the camera 10 deg about the picture's horizontal, bottom nearer", (-TILT_DEG, 0.0), 0.0, 1.0),
    ("tilt the camera 10 deg about the picture's horizontal, top nearer", (TILT_DEG, 0.0), 0.0, 1.0),
    ("roll the camera 90 deg about its axis", (0.0, 0.0), 90.0, 1.0),
    ("go a quarter nearer to the sheet", (0.0, 0.0), 0.0, 0.75),
)
"""What can be done: in words; tilt from frontal about the picture's x and y, turn, deg; part of the distance."""


@dataclass(frozen=True, slots=True)
class Missing:
    """What is not known well enough, and what to do about it; both empty where all is.

    Attributes
    ----------
    what
        Parameters and how well they are known, in words.
    remedy
        The move that tells most of them.
    """

    what: tuple[str, ...] = ()
    remedy: str = ""

    def __bool__(self) -> bool:
        return bool(self.what)

    def __str__(self) -> str:
        return f"not known well enough: {', '.join(self.what)}; {self.remedy}" if self else "all is known"


def missing(calibration: Calibration, lattice: Lattice) -> Missing:
    """Say what a calibration lacks."""
    camera = calibration.camera
    wanting = _wanting(camera, camera.covariance)
    lacking = {name: ratio for name, ratio in wanting.items() if ratio > 1}
    if not lacking:
        return Missing()
    information = np.asarray(np.linalg.inv(camera.covariance), np.float64)
    after = [_worst(camera, information, _told(calibration, lattice, *move[1:])) for move in MOVES]
    best = int(np.argmin(after))
    remedy = MOVES[best][0]
    if after[best] > HELPS * max(lacking.values()):
        remedy = "move the camera along the sheet, for pictures of other tubes"
    return Missing(tuple(_said(camera, name) for name in lacking), remedy)


def _wanting(camera: Camera, covariance: Array) -> dict[str, float]:
    """By how much each parameter's sigma is above what is enough."""
    enough = {
        "focal_length_mm": FOCAL * (camera.focal_length_mm or 1.0),
        "cx_px": CENTER * camera.image_size_px[0],
        "cy_px": CENTER * camera.image_size_px[0],
        "sx": SX,
    }
    sigma = np.sqrt(np.diag(covariance))
    return {n: float(s) / enough[n] for n, s in zip(camera.parameters, sigma, strict=True) if n in enough}


def _worst(camera: Camera, information: Array, more: Array) -> float:
    """The worst parameter with more information, (k, k) both, as in `_wanting`."""
    return max(_wanting(camera, np.asarray(np.linalg.inv(information + more))).values())


def _said(camera: Camera, name: str) -> str:
    sigma = camera.sigma(name)
    if name == "focal_length_mm":
        return f"focal length (to {100 * sigma / (camera.focal_length_mm or 1.0):.2g} %)"
    if name == "sx":
        return f"sx (to {sigma:.2g})"
    return f"principal point {name[1]} (to {sigma:.2g} px)"


def _told(
    calibration: Calibration, lattice: Lattice, tilt_deg: Sequence[float], turn_deg: float, nearer: float
) -> Array:
    """What a picture from elsewhere would tell of the camera by itself, (k, k)."""
    camera, frame = calibration.camera, 0
    rotation, translation = calibration.solution.state.rotation[frame], calibration.solution.state.translation_mm[frame]
    R, t = _moved(rotation, translation, tilt_deg, turn_deg, nearer)
    sites = sites_in_picture(camera.vector(), R, t, lattice, camera.image_size_px, 0.0)
    n = len(sites)
    px, J, place = np.empty((n, 2)), np.empty((n, 2, 16)), np.empty((n, 2, 3))
    linearise(
        camera.vector(), camera.focal_length_mm or 1.0, camera.sx or 1.0, R, t, t, sites.sheet_mm, 16, px, J, place
    )
    columns = [*range(POSE), *(POSE + PARAMETERS.index(name) for name in camera.parameters)]
    rows = J[:, :, columns].reshape(2 * n, -1)
    scatter = np.array([lattice.scatter_mm, lattice.scatter_mm, lattice.height_scatter_mm])
    spread = np.sum((place * scatter) ** 2, axis=2).ravel() + np.median(calibration.bundle.covariance_px[:, [0, 2]])
    A = rows.T @ (rows / spread[:, None])
    A += np.diag(1e-12 * np.diag(A) + 1e-300)
    pose, cross = A[:POSE, :POSE], A[:POSE, POSE:]
    return np.asarray(A[POSE:, POSE:] - cross.T @ np.linalg.solve(pose, cross))


def _moved(
    rotation: Array, translation_mm: Array, tilt_deg: Sequence[float], turn_deg: float, nearer: float
) -> tuple[Array, Array]:
    """The pose of a camera that looks at the same place of the sheet, tilted, turned and nearer."""
    R, t = rotation, translation_mm
    center = -R.T @ t
    foot = center[:2] - R[2, :2] * center[2] / R[2, 2]
    depth = float(R[2, :2] @ foot + t[2])
    turn = math.atan2(R[1, 0], R[0, 0]) + math.radians(turn_deg)
    tilt = cv2.Rodrigues(np.radians([*tilt_deg, 0.0]))[0]
    there = np.ascontiguousarray(tilt @ cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0])
    return there, np.array([0.0, 0.0, nearer * depth]) - there[:, :2] @ foot
