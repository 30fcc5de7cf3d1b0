"""What lens and range finder say at one picture, and whether lattice, lens and range finder agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.alignment.consistency import Consistency

__all__ = ["Prior", "Priors"]


@dataclass(frozen=True, slots=True)
class Prior:
    """A value with one sigma, or in words why there is none; `age_s` since it was last heard, None for never."""

    value: float | None
    sigma: float | None
    age_s: float | None
    reason: str | None

    @property
    def pair(self) -> tuple[float, float] | None:
        """Value and sigma; None where there is none."""
        return None if self.value is None or self.sigma is None else (self.value, self.sigma)

    def to_dict(self, unit: str) -> dict[str, Any]:
        """The JSON line's object; see `docs/formats.md`."""
        return {
            f"value_{unit}": self.value,
            f"sigma_{unit}": self.sigma,
            "age_s": None if self.age_s is None else round(self.age_s, 3),
            "reason": self.reason,
        }


@dataclass(frozen=True, slots=True)
class Priors:
    """At one picture.

    Attributes
    ----------
    distance
        Of the range finder: from the camera's centre to the sheet along the optical axis, mm.
    focal_length
        Of the lens's zoom position, mm.
    zoom_position, focus_position, lens_moving
        Where the lens stands, in its own counts, and whether it moves; None where it does not tell.
    calibration, calibration_reason
        Whether the camera file belongs to the lens as it stands: current | stale | unconfirmed | without lens.
    consistency
        What comes of comparing them with the lattice.
    """

    distance: Prior
    focal_length: Prior
    zoom_position: int | None
    focus_position: int | None
    lens_moving: bool | None
    calibration: str
    calibration_reason: str | None
    consistency: Consistency

    def to_dict(self) -> dict[str, Any]:
        """The JSON line's "instruments" object; see `docs/formats.md`."""
        c = self.consistency
        return {
            "distance": self.distance.to_dict("mm"),
            "focal_length": self.focal_length.to_dict("mm"),
            "zoom_position": self.zoom_position,
            "focus_position": self.focus_position,
            "lens_moving": self.lens_moving,
            "calibration": self.calibration,
            "calibration_reason": self.calibration_reason,
            "verdict": str(c.verdict),
            "odd_one_out": None if c.odd is None else str(c.odd),
            "text": c.text,
        }
