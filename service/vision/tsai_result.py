"""The answer of Tsai's calibration, and the report that Willson's calibration programs print of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from service.vision.camera import TsaiLens
from service.vision.measurement import angles_deg

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.camera import Camera

__all__ = ["NO_SIGMA", "TsaiResult", "TsaiSigma", "with_values"]

TITLES = {
    "tsai": "Coplanar calibration (Tz, f, kappa1 optimization)",
    "polish": "Coplanar calibration (full optimization but for Cx, Cy)",
    "full": "Coplanar calibration (full optimization)",
}


@dataclass(frozen=True, slots=True)
class TsaiSigma:
    """One sigma of a calibration's figures, by Gauss-Newton from the residuals; zero for what was given."""

    focal_length_mm: float
    kappa1_per_mm2: float
    principal_point_px: tuple[float, float]
    tz_mm: float
    tz_over_f: float


NO_SIGMA = TsaiSigma(math.nan, math.nan, (math.nan, math.nan), math.nan, math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class TsaiResult:
    """A calibrated camera over a sheet: ``Xc = rotation @ Xsheet + translation_mm``.

    Attributes
    ----------
    method
        "tsai", "polish" or "full".
    camera
        The camera that was given, with what was found in it.
    rotation, translation_mm
        (3, 3) and (3,): camera_from_sheet.
    sum_of_squares_px2
        Of both axes' residuals in the distorted picture.
    points
        How many it rests on.
    sigma
        Of "polish" and "full". For "tsai" a lower bound: its scatter is up to twice as large.
    doubts
        What a reader should know before trusting the figures, a line each.
    """

    method: str
    camera: Camera
    rotation: NDArray[np.float64]
    translation_mm: NDArray[np.float64]
    sum_of_squares_px2: float = math.nan
    points: int = 0
    sigma: TsaiSigma = NO_SIGMA
    doubts: tuple[str, ...] = ()

    @property
    def focal_length_mm(self) -> float:
        """Effective focal length."""
        return float(self.camera.focal_length_mm or math.nan)

    @property
    def kappa1_per_mm2(self) -> float:
        """Tsai's radial term."""
        lens = self.camera.lens
        return lens.kappa1_per_mm2 if isinstance(lens, TsaiLens) else 0.0

    @property
    def principal_point_px(self) -> tuple[float, float]:
        """(Cx, Cy)."""
        return self.camera.principal_point_px or self.camera.middle_px

    @property
    def sx(self) -> float:
        """Horizontal scale, as given: coplanar points do not determine it."""
        return self.camera.sx or 1.0

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Willson's (Rx, Ry, Rz)."""
        return angles_deg(self.rotation)

    @property
    def tz_over_f(self) -> float:
        """The scale, which stands still where f and Tz wander together."""
        return float(self.translation_mm[2]) / self.focal_length_mm

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the sheet's normal, 0 to 90."""
        return math.degrees(math.atan2(math.hypot(*self.rotation[:2, 2]), abs(self.rotation[2, 2])))

    def to_dict(self) -> dict[str, Any]:
        """As JSON's own types, with the keys of `calibrate --points --json`."""
        return {
            "method": self.method,
            "focal_length_mm": self.focal_length_mm,
            "kappa1_per_mm2": self.kappa1_per_mm2,
            "translation_mm": self.translation_mm.tolist(),
            "rotation": self.rotation.tolist(),
            "angles_deg": list(self.angles_deg),
            "sx": self.sx,
            "principal_point_px": list(self.principal_point_px),
            "tz_over_f": self.tz_over_f,
            "sum_of_squares_px2": self.sum_of_squares_px2,
            "points": self.points,
        }

    def report(self) -> str:
        """Willson's printed report, and below it how far to trust it."""
        (tx, ty, tz), (rx, ry, rz), (cx, cy) = self.translation_mm, self.angles_deg, self.principal_point_px
        rms = math.sqrt(self.sum_of_squares_px2 / (2 * self.points))
        s, (scx, scy) = self.sigma, self.sigma.principal_point_px
        known_to = (
            f"f {s.focal_length_mm:.3g}, kappa1 {s.kappa1_per_mm2:.3g}, Cx {scx:.3g}, Cy {scy:.3g}, Tz {s.tz_mm:.3g}, "
            f"Tz / f {s.tz_over_f:.3g}"
        )
        return "\n".join(
            [
                TITLES[self.method],
                "",
                f"f = {self.focal_length_mm:.6f} [mm]",
                f"kappa1 = {self.kappa1_per_mm2:.6e} [1/mm^2]",
                f"Tx = {tx:.6f}, Ty = {ty:.6f}, Tz = {tz:.6f} [mm]",
                f"Rx = {rx:.6f}, Ry = {ry:.6f}, Rz = {rz:.6f} [deg]",
                "R",
                *("  ".join(f"{v:9.6f}" for v in row) for row in self.rotation),
                f"sx = {self.sx:.6f}",
                f"Cx = {cx:.6f}, Cy = {cy:.6f} [pixels]",
                f"Tz / f = {self.tz_over_f:.6f}",
                "",
                f"points = {self.points}, residual = {rms:.4g} [pixels rms per axis]",
                f"sigma: {known_to}",
                *(f"note: {doubt}" for doubt in self.doubts),
            ]
        )


def with_values(
    camera: Camera, focal_length_mm: float, kappa1_per_mm2: float, center_px: tuple[float, float]
) -> Camera:
    """Put what was found into a camera."""
    return replace(
        camera,
        focal_length_mm=focal_length_mm,
        lens=TsaiLens(kappa1_per_mm2),
        principal_point_px=center_px,
        sx=camera.sx or 1.0,
        parameters=(),
        covariance=np.zeros((0, 0)),
    )
