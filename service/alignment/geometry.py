"""The station's geometry, and where it puts the guide's axis on the sheet.

The camera and the guide tube are fixed to one arm: the guide's axis is a fixed line in the camera frame, known with a
covariance. The pose of the sheet then tells where that line meets the plane of the tube ends and how it leans.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.measurement import Origin
from service.vision.pose import linearise

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement, Pose

    Array: TypeAlias = NDArray[np.float64]

__all__ = [
    "LEAST_COSINE", "GuideAxis", "Lean", "StationGeometry", "TubeEnd", "compare", "cross", "guide_foot", "length_sigma",
    "tube_end",
]  # fmt: skip

LEAST_OWN = 0.25
"""Of a measured centre's variance, what is its own at the least."""
LEAST_COSINE = 0.1
"""Of the angle between guide and tube: beyond 84 deg no guide is meant for this sheet."""


@dataclass(frozen=True, slots=True, eq=False)
class GuideAxis:
    """camera_from_guide: the axis of the guide tube in the camera frame.

    Attributes
    ----------
    point_mm
        (3,) a point on it: the middle of the guide's mouth where `at_mouth`, else any.
    direction
        (3,) unit vector out of the mouth, towards the sheet.
    covariance
        (6, 6) of a small turn (rad, camera frame) and of `point_mm`. What turns about the axis, or moves a point that
        is not the mouth along it, changes nothing.
    at_mouth
        Whether `point_mm` is the middle of the mouth: then the gap is measured in every picture.
    """

    point_mm: NDArray[np.float64]
    direction: NDArray[np.float64]
    covariance: NDArray[np.float64]
    at_mouth: bool


@dataclass(frozen=True, slots=True, eq=False)
class StationGeometry:
    """What is fixed on the arm, and what goes into the tube.

    Attributes
    ----------
    guide
        The guide tube's axis.
    probe_diameter_mm, tube_diameter_mm
        Outer diameter of the probe, inner diameter of the tube.
    gap_mm, gap_sigma_mm
        From the guide's mouth to the sheet along its normal, where the tool holds it and `guide` does not tell it.
    arm_normal
        (3,) unit vector at a right angle to the arm, camera frame: what is to be parallel to the sheet's normal.
    """

    guide: GuideAxis
    probe_diameter_mm: float
    tube_diameter_mm: float
    gap_mm: float | None
    gap_sigma_mm: float
    arm_normal: NDArray[np.float64]

    @property
    def clearance_mm(self) -> float:
        """Radial clearance of the probe in the tube."""
        return (self.tube_diameter_mm - self.probe_diameter_mm) / 2


@dataclass(frozen=True, slots=True, eq=False)
class TubeEnd:
    """Where a tube's axis meets the sheet.

    Attributes
    ----------
    row, column
        Lattice place.
    center_mm
        (2,) in the sheet frame.
    covariance
        (2, 2) of `center_mm`: of its own, what the pose adds is not in it.
    measured
        Whether it was seen in this picture; else it is where the lattice has it, with the tubes' scatter.
    """

    row: int
    column: int
    center_mm: NDArray[np.float64]
    covariance: NDArray[np.float64]
    measured: bool


@dataclass(frozen=True, slots=True, eq=False)
class Lean:
    """How the guide's axis lies to a tube's, which is taken for parallel to the sheet's normal.

    Attributes
    ----------
    offset_mm
        (2,) from the tube's axis to the guide's, in the sheet's plane and axes.
    slope
        (2,) how the guide's axis runs on in the sheet's axes, mm per mm of depth.
    gap_mm
        From the guide's mouth to the sheet, along the normal.
    covariance
        (5, 5) of (offset, slope, gap).
    parts
        What each source adds to it, (5, 5) each: "pose", "guide", "tube", "pitch".
    """

    offset_mm: NDArray[np.float64]
    slope: NDArray[np.float64]
    gap_mm: float
    covariance: NDArray[np.float64]
    parts: Mapping[str, NDArray[np.float64]]

    @property
    def offset_sigma_mm(self) -> float:
        """One sigma of the offset, per axis."""
        return math.sqrt(float(np.trace(self.covariance[:2, :2])) / 2)

    @property
    def distance_mm(self) -> float:
        """Length of the offset."""
        return float(np.hypot(*self.offset_mm))

    @property
    def tilt_deg(self) -> float:
        """Angle between the two axes."""
        return math.degrees(math.atan(float(np.hypot(*self.slope))))

    @property
    def tilt_sigma_deg(self) -> float:
        """One sigma of the tilt."""
        return math.degrees(
            length_sigma(self.slope, self.covariance[2:4, 2:4]) * math.cos(math.radians(self.tilt_deg)) ** 2
        )


def length_sigma(vector: Array, covariance: Array) -> float:
    """One sigma of a plane vector's length: along it, or per axis where it is too short to have a direction."""
    squared = float(vector @ vector)
    if squared > 4 * float(np.linalg.eigvalsh(covariance)[-1]):
        return math.sqrt(float(vector @ covariance @ vector) / squared)
    return math.sqrt(float(np.trace(covariance)) / 2)


def cross(v: Array) -> Array:
    """Matrix of ``v x``."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def guide_foot(pose: Pose, guide: GuideAxis) -> Array | None:
    """Where the guide's axis meets the sheet, (2,) mm in the sheet frame; None where it does not run towards it."""
    point = pose.rotation.T @ (guide.point_mm - pose.translation_mm)
    direction = pose.rotation.T @ guide.direction
    if not direction[2] > LEAST_COSINE:
        return None
    return np.asarray(point[:2] - direction[:2] * (point[2] / direction[2]))


def tube_end(measurement: Measurement, place: tuple[int, int], lattice: Lattice) -> TubeEnd:
    """Where a tube is, from its nominal place and from how far beside it this picture shows it.

    A tube end that stands higher looks displaced along the view, too: what is seen is shared between the place and the
    height by their scatters.
    """
    pose, tubes = measurement.pose, measurement.tubes
    assert pose is not None, "a lock has a pose"
    row, column = place
    nominal = lattice.sheet_points(np.array([row]), np.array([column]))
    scatter = lattice.scatter_mm**2 * np.eye(2)
    seen = np.flatnonzero((tubes.row == row) & (tubes.column == column) & (tubes.origin == Origin.MEASURED))
    if not len(seen) or lattice.scatter_mm == 0.0:
        return TubeEnd(row, column, nominal[0], scatter, measured=bool(len(seen)))
    i = int(seen[0])
    px, by_place, R, t = np.empty((1, 2)), np.empty((1, 2, 3)), pose.rotation, pose.translation_mm
    linearise(pose.camera.vector(), 1.0, 1.0, R, t, t, nominal, 6, px, np.empty((1, 2, 6)), by_place)
    mm_per_px = np.linalg.inv(by_place[0, :, :2])
    by_height = mm_per_px @ by_place[0, :, 2] * lattice.height_scatter_mm
    gain = scatter @ np.linalg.inv(scatter + np.outer(by_height, by_height))
    center = nominal[0] + gain @ mm_per_px @ (tubes.center_px[i] - px[0])
    spread = _own_variance_px2(pose, nominal[0], float(tubes.sigma_px[i])) * mm_per_px @ mm_per_px.T
    covariance = scatter - gain @ scatter + gain @ spread @ gain.T
    return TubeEnd(row, column, center, np.asarray((covariance + covariance.T) / 2), measured=True)


def _own_variance_px2(pose: Pose, place_mm: Array, sigma_px: float) -> float:
    """Variance per axis of a measured centre about where the pose has it: `Tubes.sigma_px` has the pose's share in it.

    That share is how sure the place is across the view; along it, an unknown focal length hides what moves no pixel.
    """
    to_place = pose.rotation[:, :2] @ place_mm
    by_pose = np.hstack([-cross(to_place), np.eye(3)])[:2]
    px_per_mm = pose.camera.vector()[0] / (to_place + pose.translation_mm)[2]
    of_pose = float(np.trace(by_pose @ pose.covariance @ by_pose.T)) / 2 * px_per_mm**2
    return float(max(sigma_px**2 - of_pose, LEAST_OWN * sigma_px**2))


def compare(pose: Pose, lattice: Lattice, geometry: StationGeometry, tube: TubeEnd) -> Lean | None:
    """How the guide's axis lies to a tube's, by first-order propagation of all that is uncertain.

    Pose: a small turn w and shift of camera_from_sheet. Guide: a small turn and shift in the camera frame. Pitch: the
    sheet and its distance grow alike, about the camera. None where the guide does not run towards the sheet.
    """
    R, t, guide = pose.rotation, pose.translation_mm, geometry.guide
    m, d = R.T @ (guide.point_mm - t), R.T @ guide.direction
    if not d[2] > LEAST_COSINE:
        return None
    s = d[:2] / d[2]
    chain = _by_line(m, d)
    by_pose, by_guide = (chain @ by for by in _by_pose_and_guide(R, t, guide))
    by_pitch = chain[:, :3] @ (-R.T @ t) - np.concatenate([tube.center_mm, np.zeros(3)])
    pitch = lattice.pitch_sigma_mm / lattice.pitch_mm
    of_tube = np.zeros((5, 5))
    of_tube[:2, :2] = tube.covariance
    parts = {
        "pose": by_pose @ pose.covariance @ by_pose.T,
        "guide": by_guide @ guide.covariance @ by_guide.T,
        "tube": of_tube,
        "pitch": np.outer(by_pitch, by_pitch) * pitch**2,
    }
    gap, covariance = float(-m[2]), np.asarray(sum(parts.values()), np.float64)
    if geometry.gap_mm is not None:
        gap = geometry.gap_mm
        covariance[4, :] = covariance[:, 4] = 0.0
        covariance[4, 4] = geometry.gap_sigma_mm**2
    return Lean(
        offset_mm=m[:2] - s * m[2] - tube.center_mm,
        slope=s,
        gap_mm=gap,
        covariance=covariance,
        parts=parts,
    )


def _by_pose_and_guide(R: Array, t: Array, guide: GuideAxis) -> tuple[Array, Array]:
    """Derivatives of the axis' point and direction in the sheet frame, (6, 6): by the pose, and by the guide."""
    to_point, turning = cross(guide.point_mm - t), R.T @ cross(guide.direction)
    none = np.zeros((3, 3))
    by_pose = np.block([[R.T @ to_point, -R.T], [turning, none]])
    by_guide = np.block([[none, R.T], [-turning, none]])
    return by_pose, by_guide


def _by_line(m: Array, d: Array) -> Array:
    """Derivative, (5, 6), of (offset, slope, gap) by point `m` and direction `d` of the axis in the sheet frame."""
    s = d[:2] / d[2]
    along = np.hstack([np.eye(2), -s[:, None]])
    chain = np.zeros((5, 6))
    chain[:2, :3], chain[:2, 3:] = along, -m[2] / d[2] * along
    chain[2:4, 3:], chain[4, 2] = along / d[2], -1.0
    return chain
