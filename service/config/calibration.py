"""A calibration as a camera file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from service.config.cameras import CalibrationRecord, write_camera

if TYPE_CHECKING:
    from pathlib import Path

    from service.vision.selfcalibration import Calibration

__all__ = ["write_calibration"]


def write_calibration(path: Path, calibration: Calibration, utc: str) -> None:
    """Write the camera with its covariance and how it came about; raises ConfigError where that cannot be."""
    record = CalibrationRecord(calibration.reprojection_error_px, utc, calibration.frames)
    write_camera(path, calibration.camera, record)
