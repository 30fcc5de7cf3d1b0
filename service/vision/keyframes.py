"""Pictures that a calibration rests on: what each says, and which are worth keeping."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Keyframe", "Keyframes"]

MOST = 48
"""Pictures kept: more of them hardly tell more, and the solution's time grows with their square."""
SAME = 0.2
"""Pictures nearer than this, in the units below, say the same, and err alike."""
STEP = 0.0175, 0.0175, 10.0, 3.0, 3.0, 0.1
"""What makes one unit: slope of depth across the picture's width (2 deg at f = two widths); turn, deg; place looked
at, pitches; natural logarithm of the scale."""


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """One picture, or one field of it, in lines of the full frame.

    Attributes
    ----------
    series
        Frames of one series index the tubes alike: (row, column) is the same tube in all of them.
    row, column, sheet_mm
        (n,) int64, (n,) int64 and (n, 2): the measured tubes' lattice index and nominal place.
    center_px, covariance_px
        (n, 2) and (n, 3) xx, xy, yy: measured centres.
    light_px
        (n, 2) what uneven light may shift a centre by.
    shift_variance_px2, light_variance
        What remains unknown of what shifts all edges alike, per axis (2,), and of the light's part.
    camera, focal_sigma_mm
        The camera that the pose was found with, complete, and how well that picture alone knew its focal length.
    rotation, translation_mm
        camera_from_sheet, as that picture alone had it.
    pitch_mm
        The lattice's.
    """

    series: int
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    sheet_mm: NDArray[np.float64]
    center_px: NDArray[np.float64]
    covariance_px: NDArray[np.float64]
    light_px: NDArray[np.float64]
    shift_variance_px2: NDArray[np.float64]
    light_variance: float
    camera: Camera
    focal_sigma_mm: float
    rotation: NDArray[np.float64]
    translation_mm: NDArray[np.float64]
    pitch_mm: float

    def __len__(self) -> int:
        return len(self.row)

    @classmethod
    def of(cls, measurement: Measurement, lattice: Lattice, series: int) -> Keyframe:
        """Take what a measurement with a pose rests on."""
        view, pose = measurement.view, measurement.pose
        assert view is not None
        assert pose is not None
        measured = view.measured
        center, covariance, light = (a[measured] for a in (view.center_px, view.covariance_px, view.light_px))
        lines = np.array([1.0, 1.0 if view.parity is None else 2.0])
        row, column = view.row[measured], view.column[measured]
        variance = np.diag(view.bias_covariance)
        return cls(
            series=series,
            row=row,
            column=column,
            sheet_mm=lattice.sheet_points(row, column),
            center_px=center * lines + [0.0, view.parity or 0.0],
            covariance_px=covariance * [1.0, lines[1], lines[1] ** 2],
            light_px=light * lines,
            shift_variance_px2=variance[:2] * lines**2,
            light_variance=float(variance[3]),
            camera=pose.camera,
            focal_sigma_mm=pose.sigma.focal_length_mm,
            rotation=pose.rotation,
            translation_mm=pose.translation_mm,
            pitch_mm=lattice.pitch_mm,
        )

    def look(self) -> Array:
        """How the sheet is looked at, (6,), in units of `STEP`: only what a picture shows whatever its focal length."""
        R, t = self.rotation, self.translation_mm
        widths = (self.camera.focal_length_mm or 1.0) / (self.camera.image_size_px[0] * self.camera.pixel_pitch_mm[0])
        slope = R[:2, 2] / R[2, 2] / widths
        center = -R.T @ t
        foot = (center[:2] - R[2, :2] * center[2] / R[2, 2]) / self.pitch_mm
        turn = math.degrees(math.atan2(R[1, 0], R[0, 0]))
        return np.array([*slope, turn, *foot, math.log(widths / float(R[:, 2] @ t))]) / STEP


class Keyframes:
    """The pictures kept: as unlike each other as may be, up to `most`.

    Of two that say the same, the one that shows more tubes stays; where there are too many, one of the two most alike
    goes. The first stays in any case.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._kept: list[Keyframe] = []
        self._looks = np.zeros((0, len(STEP)))

    def __len__(self) -> int:
        return len(self._kept)

    def __iter__(self) -> Iterator[Keyframe]:
        return iter(self._kept)

    def add(self, keyframe: Keyframe) -> bool:
        """Take a picture in where it is worth it; whether it was."""
        look = keyframe.look()
        off = _apart(self._looks - look)
        nearest = int(np.argmin(off)) if len(off) else 0
        if len(off) and off[nearest] < SAME:
            if nearest == 0 or len(keyframe) <= len(self._kept[nearest]):
                return False
            self._kept[nearest], self._looks[nearest] = keyframe, look
            return True
        self._kept.append(keyframe)
        self._looks = np.vstack([self._looks, look])
        return len(self._kept) <= self._most or self._drop_one()

    def _drop_one(self) -> bool:
        """Let one of the two most alike go; whether it was not the last one taken in."""
        off = _apart(self._looks[:, None] - self._looks)
        np.fill_diagonal(off, np.inf)
        pair = np.unravel_index(int(np.argmin(off)), off.shape)
        goes = max((int(i) for i in pair if i), key=lambda i: -len(self._kept[i]))
        last = goes == len(self._kept) - 1
        del self._kept[goes]
        self._looks = np.delete(self._looks, goes, axis=0)
        return not last


def _apart(difference: Array) -> Array:
    """Distance between looks, (..., 6) their difference; a full turn is none."""
    turn = 360.0 / STEP[2]
    difference[..., 2] -= turn * np.rint(difference[..., 2] / turn)
    return np.asarray(np.sqrt(np.sum(difference**2, axis=-1)))
