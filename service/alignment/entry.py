"""Where the probe would hit the sheet, and whether it would go in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.projection import project

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.alignment.geometry import Lean, StationGeometry, TubeEnd
    from service.vision.measurement import Pose

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Entry", "entry", "entry_outline"]


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """The probe, pushed straight out of the guide, in the sheet's plane.

    Attributes
    ----------
    center_mm
        (2,) middle of the ellipse that it cuts, in the sheet frame.
    semi_axes_mm
        Half the ellipse's length and width.
    angle_deg
        Direction of its length in the sheet's axes, from X towards Y.
    clearance_mm
        Of the probe in the tube, radial.
    margin_mm, margin_sigma_mm
        What the entry rule leaves: clearance - (e + g tan(theta)), for a square nose. Below 0 it touches.
    """

    center_mm: NDArray[np.float64]
    semi_axes_mm: tuple[float, float]
    angle_deg: float
    clearance_mm: float
    margin_mm: float
    margin_sigma_mm: float


def entry(lean: Lean, tube: TubeEnd, geometry: StationGeometry) -> Entry:
    """Where the probe hits, and by what margin it goes in: e + g tan(theta) <= (ID - OD) / 2.

    e is the offset at the guide's mouth, g the gap, theta the tilt: the worst case of the offset at the sheet, whatever
    way the two lean.
    """
    s, g = lean.slope, lean.gap_mm
    at_mouth = lean.offset_mm - g * s
    e, tan = float(np.hypot(*at_mouth)), float(np.hypot(*s))
    along, down = _directions(at_mouth, s)
    by_all = np.concatenate([-along, g * along - g * down, [float(along @ s) - tan]])
    radius = geometry.probe_diameter_mm / 2
    return Entry(
        center_mm=tube.center_mm + lean.offset_mm,
        semi_axes_mm=(radius * math.hypot(1.0, tan), radius),
        angle_deg=math.degrees(math.atan2(s[1], s[0])),
        clearance_mm=geometry.clearance_mm,
        margin_mm=geometry.clearance_mm - e - g * tan,
        margin_sigma_mm=math.sqrt(float(by_all @ lean.covariance @ by_all)),
    )


def _directions(offset: Array, slope: Array) -> tuple[Array, Array]:
    """Unit vectors along both; along the other, or X, where one is too short to have a direction."""
    a, b = float(np.hypot(*offset)), float(np.hypot(*slope))
    tiny, x = 1e-9, np.array([1.0, 0.0])
    along = offset / a if a > tiny else slope / b if b > tiny else x
    return along, slope / b if b > tiny else along


def entry_outline(pose: Pose, found: Entry, n: int = 48) -> Array:
    """The ellipse in the picture, (n, 2) px of the full frame, for drawing; NaN where the lens model has no answer."""
    angles, turn = np.arange(n) * (2 * math.pi / n), math.radians(found.angle_deg)
    a, b = found.semi_axes_mm
    x, y = a * np.cos(angles), b * np.sin(angles)
    c, s = math.cos(turn), math.sin(turn)
    outline_mm = found.center_mm + np.stack([c * x - s * y, s * x + c * y], axis=-1)
    return np.asarray(project(pose.camera.vector(), pose.rotation, pose.translation_mm, outline_mm))
