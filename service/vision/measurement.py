"""What one picture says: tubes, pose, lock. Types only."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.view import View

__all__ = ["Doubt", "Lock", "Measurement", "Origin", "Pose", "PoseSigma", "TubeState", "Tubes", "angles_deg"]


class Lock(enum.StrEnum):
    """FULL: pose and index are trusted. PARTIAL: locked, with a doubt. NONE: nothing is said, and why."""

    FULL = "full"
    PARTIAL = "partial"
    NONE = "none"


class Doubt(enum.StrEnum):
    """What a partial lock is unsure of."""

    INDEX = "index"
    SCALE = "scale"
    FOCUS = "focus"
    LIGHT = "light"
    CALIBRATION = "calibration"


class Origin(enum.IntEnum):
    """Whether a tube's place was measured on this picture or follows from the others."""

    INFERRED = 0
    MEASURED = 1


class TubeState(enum.IntEnum):
    """What stands at a lattice place."""

    UNKNOWN = 0
    OPEN = 1
    PLUGGED = 2
    ABSENT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Tubes:
    """Lattice places in the picture, one a row of every array.

    Attributes
    ----------
    row, column
        (n,) int32 lattice index.
    center_px
        (n, 2) float64, (x, y): where the centre of the tube-end circle projects; lines of the full frame, also for a
        field.
    sigma_px
        (n,) float64, one sigma per axis: of the actual tube where measured, of the nominal place where inferred.
    origin, state
        (n,) uint8 of `Origin`, `TubeState`.
    """

    row: NDArray[np.int32]
    column: NDArray[np.int32]
    center_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    origin: NDArray[np.uint8]
    state: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.row)

    def take(self, which: NDArray[np.bool_]) -> Tubes:
        """A selection, by a mask (n,)."""
        return Tubes(
            self.row[which], self.column[which], self.center_px[which], self.sigma_px[which], self.origin[which],
            self.state[which],
        )  # fmt: skip

    @classmethod
    def none(cls) -> Tubes:
        """No tubes at all."""
        i, u = np.zeros(0, np.int32), np.zeros(0, np.uint8)
        return cls(i, i, np.zeros((0, 2)), np.zeros(0), u, u)


@dataclass(frozen=True, slots=True)
class PoseSigma:
    """One sigma of what a pose says, with all that is not known of camera, pitch and tube places in it."""

    tz_mm: float
    distance_mm: float
    tilt_deg: float
    lateral_mm: float
    focal_length_mm: float


def angles_deg(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Willson's (Rx, Ry, Rz) of ``R = Rz @ Ry @ Rx``, deg."""
    ry = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    rx = math.atan2(rotation[2, 1], rotation[2, 2])
    rz = math.atan2(rotation[1, 0], rotation[0, 0])
    return math.degrees(rx), math.degrees(ry), math.degrees(rz)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where the sheet stands in front of the camera: ``Xc = rotation @ Xsheet + translation_mm``.

    Attributes
    ----------
    rotation, translation_mm
        (3, 3) and (3,): camera_from_sheet.
    camera
        The camera it was found with; what was unknown of it is estimated here. Always that of the full frame.
    covariance
        (6, 6) of a small turn (rad, camera frame, left of `rotation`) and of `translation_mm`; everything in it.
    sigma
        One sigma of the derived figures.
    reprojection_error_px
        RMS per axis of the measured tubes about the nominal lattice.
    """

    rotation: NDArray[np.float64]
    translation_mm: NDArray[np.float64]
    camera: Camera
    covariance: NDArray[np.float64]
    sigma: PoseSigma
    reprojection_error_px: float

    @property
    def tz_mm(self) -> float:
        """Tsai's Tz: depth of the lattice origin."""
        return float(self.translation_mm[2])

    @property
    def distance_mm(self) -> float:
        """Distance of the camera's centre from the sheet along its normal."""
        return float(self.rotation[:, 2] @ self.translation_mm)

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the sheet's normal."""
        return math.degrees(math.atan2(math.hypot(self.rotation[0, 2], self.rotation[1, 2]), self.rotation[2, 2]))

    @property
    def axis_foot_mm(self) -> NDArray[np.float64]:
        """Where the optical axis meets the sheet, (X, Y) mm in the sheet frame."""
        axis = self.rotation[2]
        center = -self.rotation.T @ self.translation_mm
        return np.asarray(center[:2] - axis[:2] * center[2] / axis[2])


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """The pipeline's answer to one picture: a frame, or one field of it.

    Attributes
    ----------
    field
        "progressive", "top" or "bottom".
    lock, reason, doubt
        How far to trust it; `reason` in words where `lock` is NONE.
    tubes, pose
        `pose` is None exactly where `lock` is NONE.
    time_ns
        When this picture was exposed: the frame's time, or half a frame later for its second field.
    elapsed_ms
        What each stage took: "detect", "lattice", "pose", ..., "total".
    view
        What the rims themselves said; None without a pose.
    index
        Number of the lattice index of `tubes`: in pictures of the same one, a place is the same tube. One that is in
        doubt has a number of its own, and where it is found to be right, or mended, the number it had before.
    """

    field: str
    lock: Lock
    reason: str | None
    doubt: tuple[Doubt, ...]
    tubes: Tubes
    pose: Pose | None
    time_ns: int
    elapsed_ms: dict[str, float] = dataclass_field(default_factory=dict)
    view: View | None = None
    index: int = 0
