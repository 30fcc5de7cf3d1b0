"""What a calibration says, in words and as JSON's own types."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from service.vision.advice import missing
from service.vision.camera import OpenCVLens, TsaiLens

if TYPE_CHECKING:
    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.selfcalibration import Calibration

__all__ = ["brief", "calibration_dict", "calibration_lines"]

UNKNOWN = 0.02
"""A focal length whose sigma is more than this part of it is not called known."""


def brief(calibration: Calibration, lattice: Lattice) -> str:
    """One line: the focal length, and what to do next."""
    return f"f = {_focal(calibration.camera)} from {calibration.frames} pictures; {missing(calibration, lattice)}"


def calibration_lines(calibration: Calibration, lattice: Lattice) -> list[str]:
    """The answer for people, a line a value."""
    c = calibration.camera
    x, y = c.principal_point_px or c.middle_px
    lines = [
        f"focal length      {_focal(c)}",
        f"Tz / f            {_valued(*calibration.depth_over_focal())}",
        f"principal point   x {_valued(x, c.sigma('cx_px'))}, y {_valued(y, c.sigma('cy_px'))} px",
        f"sx                {_valued(c.sx or 1.0, c.sigma('sx'))}",
        *_lens(c),
        f"residuals         {calibration.reprojection_error_px:.3f} px rms about nominal places",
        f"tubes' scatter    {_scatter(calibration, lattice)}",
    ]
    if not calibration.solution.converged:
        lines.append("note: the solution does not stand still; take it with caution")
    return [*lines, str(missing(calibration, lattice))]


def calibration_dict(calibration: Calibration, lattice: Lattice) -> dict[str, Any]:
    """The answer for programs."""
    c, wanting = calibration.camera, missing(calibration, lattice)
    ratio, ratio_sigma = calibration.depth_over_focal()
    lens = c.lens
    return {
        "focal_length_mm": c.focal_length_mm,
        "principal_point_px": list(c.principal_point_px or c.middle_px),
        "sx": c.sx,
        "kappa1_per_mm2": lens.kappa1_per_mm2 if isinstance(lens, TsaiLens) else None,
        "opencv_distortion": list(lens.coefficients) if isinstance(lens, OpenCVLens) else None,
        "sigma": {name: c.sigma(name) for name in c.parameters},
        "tz_over_f": ratio,
        "tz_over_f_sigma": ratio_sigma,
        "reprojection_error_px": calibration.reprojection_error_px,
        "frames": calibration.frames,
        "missing": list(wanting.what),
        "remedy": wanting.remedy or None,
    }


def _focal(camera: Camera) -> str:
    f, sigma = camera.focal_length_mm or math.nan, camera.sigma("focal_length_mm")
    said = f"{_valued(f, sigma)} mm"
    if not sigma:
        return said
    return (
        f"{said} ({100 * sigma / f:.2g} %)" if sigma < UNKNOWN * f else f"NOT KNOWN: {said} ({100 * sigma / f:.2g} %)"
    )


def _lens(camera: Camera) -> list[str]:
    if not isinstance(camera.lens, OpenCVLens):
        kappa1 = camera.lens.kappa1_per_mm2 if camera.lens else 0.0
        return [f"kappa1            {_valued(kappa1, camera.sigma('kappa1_per_mm2'))} /mm^2"]
    terms = zip(("k1", "k2", "p1", "p2", "k3"), camera.lens.coefficients, strict=True)
    return [f"{name}                {_valued(value, camera.sigma(name))}" for name, value in terms if value]


def _scatter(calibration: Calibration, lattice: Lattice) -> str:
    plane, height = calibration.solution.spread.scatter * (lattice.scatter_mm, lattice.height_scatter_mm)
    return f"{plane:.3f} mm in the sheet's plane, {height:.2f} mm in height"


def _valued(value: float, sigma: float) -> str:
    """Value ± sigma, to the second figure of the sigma; a value without a sigma counts as exact."""
    if not sigma:
        return f"{value:.10g} (given)"
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{np.round(value, digits):.{digits}f} ± {sigma:.{digits}f}"
