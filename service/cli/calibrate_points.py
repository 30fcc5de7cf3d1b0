"""`bowlsight calibrate --points`: Tsai's calibration from a file of points, and Willson's report of it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from drivers.errors import CalibrationError, ConfigError
from service.cli.outputs import check_outputs
from service.config.cameras import read_camera, write_atomically
from service.config.points import read_points
from service.vision.errors import DegenerateError
from service.vision.tsai import calibrate_coplanar
from service.vision.tsai_full import calibrate_full

__all__ = ["METHODS", "run_points"]

METHODS = {"tsai": calibrate_coplanar, "full": calibrate_full}


def run_points(points: Path, camera: Path, method: str = "tsai", json_out: str | None = None) -> int:
    """Calibrate from a point file and print the report, or the answer as JSON where `json_out` is "-".

    Any other `json_out` names a file to write the JSON to, beside the report.

    Raises
    ------
    ConfigError
        A file is not readable or not sound, or the method unknown.
    CalibrationError
        The points do not determine an answer.
    """
    if method not in METHODS:
        raise ConfigError(f"--method {method}: unknown; it must be one of {', '.join(METHODS)}")
    out = None if json_out in (None, "-") else Path(json_out)
    check_outputs([out] if out else [], [points, camera])
    known = read_camera(camera)
    sheet_mm, points_px = read_points(points)
    try:
        result = METHODS[method](sheet_mm, points_px, known)
    except DegenerateError as error:
        raise CalibrationError(f"{points}: {error}") from error
    text = json.dumps(result.to_dict(), indent=2, allow_nan=False)
    if json_out == "-":
        print(text)
        for doubt in result.doubts:
            print(f"{points}: note: {doubt}", file=sys.stderr)
        return 0
    if out is not None:
        write_atomically(out, text + "\n")
    print(result.report())
    return 0
