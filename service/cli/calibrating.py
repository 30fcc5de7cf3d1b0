"""What is known beforehand of a camera to be calibrated; and calibrating while the live service runs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from drivers.errors import ConfigError
from service.sinks.calibrating import CalibrationSink
from service.vision.bundle import Range

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable
    from pathlib import Path

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice

__all__ = ["calibration_sink", "focal_length_of", "range_of"]

RANGE_SIGMA_MM = 2.0
"""Of a distance that somebody measured."""
FOCAL_SIGMA = 0.03
"""Of a focal length that a lens or its maker tells, as a part of it."""


def range_of(args: argparse.Namespace) -> Range | None:
    """The distance that is known of the first picture; None where none is."""
    return None if args.range_mm is None else Range(args.range_mm[0], args.range_mm[1] or RANGE_SIGMA_MM)


def focal_length_of(args: argparse.Namespace) -> tuple[float, float] | None:
    """The focal length that is told, and its sigma, mm; None where none is."""
    if args.focal_length_mm is None:
        return None
    focal_mm, sigma_mm = args.focal_length_mm
    return focal_mm, sigma_mm or FOCAL_SIGMA * focal_mm


def calibration_sink(
    camera: Camera | None, lattice: Lattice, args: argparse.Namespace, tell: Callable[[str, str], None]
) -> CalibrationSink | None:
    """The sink that calibrates; None where the camera is known and no file is asked for.

    Where a file is asked for it is found anew: of a camera file, picture size and pixel pitch hold, the rest does not,
    but what is told on the command line.
    """
    out: Path | None = args.calibrate
    if out is not None:
        known = None if camera is None else _anew(camera)
        return CalibrationSink(
            known, lattice, out, tell, known_range=range_of(args), focal_length_mm=focal_length_of(args)
        )
    for option, value in (("--range-mm", args.range_mm), ("--focal-length-mm", args.focal_length_mm)):
        if value is not None:
            raise ConfigError(f"{option} {value[0]:g}: is for a calibration; give --calibrate FILE with it")
    if camera is not None and camera.complete:
        return None
    return CalibrationSink(camera, lattice, None, tell)


def _anew(camera: Camera) -> Camera:
    return replace(
        camera,
        focal_length_mm=None,
        lens=None,
        principal_point_px=None,
        sx=None,
        parameters=(),
        covariance=np.zeros((0, 0)),
    )
