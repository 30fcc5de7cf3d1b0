"""How parallel the arm is to the sheet, averaged over a time in which not everything averages out.

What is new in each frame, the noise of its edges, averages out. What all frames have in common does not: calibration,
camera_from_guide, where the real tube ends stand, the light's common shift.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.alignment.geometry import LEAST_COSINE, cross, length_sigma
from service.vision.measurement import Origin
from service.vision.pose import linearise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.alignment.geometry import StationGeometry
    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement, Pose, Tubes

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["ArmSlope", "Averaged", "SlopeWindow", "arm_slope", "frame_covariance"]

MOST_FRAMES = 240
"""Kept in a window: one second at the highest frame rates."""
LEAST_TUBES = 6


@dataclass(frozen=True, slots=True, eq=False)
class ArmSlope:
    """How the arm's normal leans against the sheet's in one picture.

    Attributes
    ----------
    slope
        (2,) in the sheet's axes.
    covariance
        (2, 2), all in it.
    own
        (2, 2): the part of it that is this picture's alone.
    """

    slope: NDArray[np.float64]
    covariance: NDArray[np.float64]
    own: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Averaged:
    """Parallelism over a window: angle and one sigma, deg; how many pictures and how long it took them."""

    deg: float
    sigma_deg: float
    frames: int
    span_s: float


def arm_slope(measurement: Measurement, lattice: Lattice, geometry: StationGeometry) -> ArmSlope | None:
    """Slope of the arm in one locked picture; None where it stands across the sheet."""
    pose = measurement.pose
    assert pose is not None, "a lock has a pose"
    normal = pose.rotation.T @ geometry.arm_normal
    if not normal[2] > LEAST_COSINE:
        return None
    s = normal[:2] / normal[2]
    by_turn = np.hstack([np.eye(2), -s[:, None]]) / normal[2] @ pose.rotation.T @ cross(geometry.arm_normal)
    of_both = pose.covariance[:3, :3] + geometry.guide.covariance[:3, :3]
    own = frame_covariance(pose, measurement.tubes, lattice)[:3, :3]
    return ArmSlope(s, by_turn @ of_both @ by_turn.T, by_turn @ own @ by_turn.T)


def frame_covariance(pose: Pose, tubes: Tubes, lattice: Lattice) -> Array:
    """What of a pose's covariance, (6, 6), is new in its picture: the noise of the measured centres.

    A centre's own posterior variance v, without what the pose adds, is s c / (s + c), s being the tubes' scatter and c
    its noise; so the noise's share of what the solution weighs it with, s + c, is v / s.
    """
    used = tubes.origin == Origin.MEASURED
    n = int(used.sum())
    if n < LEAST_TUBES or lattice.scatter_mm == 0.0:
        return np.zeros((6, 6))
    sheet = lattice.sheet_points(tubes.row[used].astype(np.int_), tubes.column[used].astype(np.int_))
    px, J, place = np.empty((n, 2)), np.empty((n, 2, 6)), np.empty((n, 2, 3))
    t = pose.translation_mm
    linearise(pose.camera.vector(), 1.0, 1.0, pose.rotation, t, t, sheet, 6, px, J, place)
    of_place = np.array([lattice.scatter_mm, lattice.scatter_mm, lattice.height_scatter_mm])
    scatter = (place**2 @ of_place**2).mean(axis=1)
    of_pose = ((J @ pose.covariance) * J).sum(axis=(1, 2)) / 2
    share = np.clip((tubes.sigma_px[used] ** 2 - of_pose) / scatter, 0.0, 0.98)
    weight = (1 - share) / scatter
    rows = J.reshape(2 * n, 6)
    inverse = np.linalg.inv((rows.T * np.repeat(weight, 2)) @ rows)
    noise = (rows.T * np.repeat(weight * share, 2)) @ rows
    return np.asarray(inverse @ noise @ inverse)


class SlopeWindow:
    """The arm's slopes of the last second, or of another time."""

    def __init__(self, span_s: float) -> None:
        self._span_ns = int(span_s * 1e9)
        self._kept: deque[tuple[int, ArmSlope]] = deque(maxlen=MOST_FRAMES)

    def clear(self) -> None:
        """Forget all: what comes next has nothing to do with it."""
        self._kept.clear()

    def add(self, time_ns: int, slope: ArmSlope) -> Averaged:
        """Take one picture in, let old ones go, and average."""
        if self._kept and time_ns <= self._kept[-1][0]:
            self.clear()  # time ran back: a recording began again
        self._kept.append((time_ns, slope))
        while time_ns - self._kept[0][0] > self._span_ns:
            self._kept.popleft()
        return self._average()

    def _average(self) -> Averaged:
        slopes = np.array([s.slope for _, s in self._kept])
        mean = slopes.mean(axis=0)
        all_in = np.mean([s.covariance for _, s in self._kept], axis=0)
        own = np.mean([s.own for _, s in self._kept], axis=0)
        own = own * _believed(own, all_in, slopes)
        covariance = all_in - own * (1 - 1 / len(slopes))
        angle = math.atan(float(np.hypot(*mean)))
        sigma = length_sigma(mean, covariance) * math.cos(angle) ** 2
        span_s = (self._kept[-1][0] - self._kept[0][0]) / 1e9
        return Averaged(math.degrees(angle), math.degrees(sigma), len(slopes), span_s)


def _believed(own: Array, all_in: Array, slopes: Array) -> float:
    """The share of `own` to believe: no more than there is in all, nor than differs from picture to picture.

    Successive differences see only what is new in each picture; a slow motion of the arm hardly shows in them.
    """
    stated = float(np.trace(own))
    if len(slopes) < 2 or stated <= 0.0:
        return 0.0
    differing = float((np.diff(slopes, axis=0) ** 2).sum(axis=1).mean()) / 2
    most = float(np.linalg.eigvals(np.linalg.pinv(all_in) @ own).real.max())
    return min(1.0, differing / stated, 1.0 / max(most, 1e-9))
