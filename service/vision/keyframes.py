"""Pictures that a calibration rests on: what each says, and how much it would add to the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Keyframe"]


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
        )
