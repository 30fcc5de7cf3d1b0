"""Calibrating while the live service runs: whether, from what, and where to."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from service.sinks.calibrating import CalibrationSink

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice

__all__ = ["calibration_sink"]


def calibration_sink(
    camera: Camera | None, lattice: Lattice, out: Path | None, tell: Callable[[str, str], None]
) -> CalibrationSink | None:
    """The sink that calibrates; None where the camera is known and no file is asked for.

    Where a file is asked for it is found anew: of a camera file, picture size and pixel pitch hold, the rest does not.
    """
    if out is not None:
        return CalibrationSink(None if camera is None else _anew(camera), lattice, out, tell)
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
