"""Guide files: camera_from_guide as `align-setup` measures it, or as a drawing gives it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from service.alignment.geometry import GuideAxis
from service.config.cameras import write_atomically
from service.config.table import Table, read_toml

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from service.alignment.setup import GuideSetup

__all__ = ["read_guide", "write_guide"]


def read_guide(path: Path) -> GuideAxis:
    """Read a guide file; raises ConfigError where a key is missing, unknown or impossible."""
    t = read_toml(path)
    if ("mouth_mm" in t) == ("point_mm" in t):
        raise t.error(
            "mouth_mm", "give either mouth_mm, the middle of the guide's mouth, or point_mm, another point on its axis"
        )
    at_mouth = "mouth_mm" in t
    point = np.array(t.numbers("mouth_mm" if at_mouth else "point_mm", 3))
    axis = np.array(t.numbers("axis", 3))
    length = float(np.linalg.norm(axis))
    if not length > 0:
        raise t.error("axis", "must be a direction: (x, y, z) out of the guide's mouth, towards the sheet")
    covariance = _covariance(t)
    for key in ("points", "residual_mm", "expected_mm", "depth_mm"):
        t.number(key, None, minimum=0)
    for key in ("measured_utc", "source", "camera"):
        t.text(key, None)
    t.finish()
    return GuideAxis(point, axis / length, covariance, at_mouth=at_mouth)


def _covariance(t: Table) -> NDArray[np.float64]:
    if "covariance" in t:
        for key in ("axis_sigma_deg", "point_sigma_mm"):
            if key in t:
                raise t.error(key, "give either this or covariance, not both")
        matrix = np.array(t.matrix("covariance", 6))
        symmetric = np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12 * np.abs(matrix).max())
        if not symmetric or np.linalg.eigvalsh(matrix).min() < -1e-9 * np.abs(matrix).max():
            raise t.error("covariance", "must be symmetric and positive")
        return np.asarray((matrix + matrix.T) / 2)
    turn = math.radians(t.number("axis_sigma_deg", above=0, maximum=90))
    shift = t.number("point_sigma_mm", above=0)
    return np.diag([turn**2] * 3 + [shift**2] * 3)


def write_guide(path: Path, setup: GuideSetup, utc: str, source: str, camera: str) -> None:
    """Write a guide file whole or not at all."""
    guide = setup.guide
    document: dict[str, Any] = {
        "mouth_mm" if guide.at_mouth else "point_mm": guide.point_mm.tolist(),
        "axis": guide.direction.tolist(),
        "covariance": guide.covariance.tolist(),
        "measured_utc": utc,
        "source": source,
        "camera": camera,
        "points": setup.points,
        "residual_mm": round(setup.residual_mm, 4),
        "expected_mm": round(setup.expected_mm, 4),
        "depth_mm": round(setup.depth_mm, 1),
    }
    head = (
        "# camera_from_guide, for [alignment] guide of a station file: mm in the camera frame, x right, y down, z\n"
        "# forward. covariance: of a small turn (rad) and of the point.\n"
    )
    if not guide.at_mouth:
        head += "# Where the guide's mouth is was not measured: the station file must give gap_mm.\n"
    write_atomically(path, head + tomli_w.dumps(document))
