"""What a page is sent of one frame: picture, marks and readings in one message, so that they cannot part.

A message is the length of its head (4 bytes, little-endian), the head (JSON, filled up with blanks to a multiple of 4),
the marks, and the picture (JPEG) to the end. Marks are nine 16-bit numbers a tube: centre and two conjugate
half-diameters of its rim, in eighths of a pixel; its kind; its lattice row and column.
"""

from __future__ import annotations

import json
import math
import struct
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from service.alignment.entry import entry_outline
from service.alignment.verdict import picture_axes
from service.sinks.viewer_status import why
from service.vision.outlines import kinds, rim_ellipses

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from service.alignment.result import Alignment
    from service.identity.counting import NamingRule
    from service.results import FrameResult
    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement, Pose

__all__ = ["MARK", "frame_head", "frame_message", "marks"]

MARK = np.dtype([("place_8px", "<i2", 6), ("kind", "<i2"), ("row", "<i2"), ("column", "<i2")])
STEPS_PER_PX = 8
FARTHEST_PX = 4000.0
ENTRY_POINTS = 24


def frame_message(head: Mapping[str, Any], placed: NDArray[np.void], picture: NDArray[np.uint8], quality: int) -> bytes:
    """Put a message together; raises ValueError where the picture cannot be coded."""
    done, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError(f"a picture of {picture.shape[1]}x{picture.shape[0]} px cannot be coded as JPEG")
    text = json.dumps({**head, "tubes": len(placed)}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return b"".join((struct.pack("<I", len(text)), text, placed.tobytes(), jpeg.tobytes()))


def marks(m: Measurement, lattice: Lattice) -> NDArray[np.void]:
    """Marks of the tubes, (n,) of `MARK`; those that cannot be drawn are left out."""
    if m.pose is None:
        return np.zeros(0, MARK)
    px = rim_ellipses(m.pose, lattice, m.tubes)
    drawn = np.isfinite(px).all(axis=1) & (np.abs(px) < FARTHEST_PX).all(axis=1)
    out = np.zeros(int(drawn.sum()), MARK)
    out["place_8px"] = np.rint(px[drawn] * STEPS_PER_PX)
    out["kind"], out["row"], out["column"] = kinds(m.tubes)[drawn], m.tubes.row[drawn], m.tubes.column[drawn]
    return out


def frame_head(result: FrameResult, rule: NamingRule, target: tuple[int, int] | None) -> dict[str, Any]:
    """The readings of a frame; lengths in mm, angles in degrees, what is not known None."""
    m = result.measurement
    return {
        "sequence": result.sequence,
        "generation": result.generation,
        "index": m.index,
        "field": m.field,
        "lock": str(m.lock),
        "why": why(m),
        "names": _names(result),
        "target": None if target is None else list(target),
        "pose": None if m.pose is None else _pose(m.pose),
        "alignment": None if result.alignment is None else _alignment(result.alignment, m.pose, rule),
        "measured_ms": _finite(m.elapsed_ms.get("total", math.nan), 1),
    }


def _names(result: FrameResult) -> dict[str, str] | None:
    """Names by place; None where nothing names the tubes."""
    if not result.names:
        return None
    t = result.measurement.tubes
    places = zip(t.row.tolist(), t.column.tolist(), result.names, strict=True)
    return {f"{row},{column}": name for row, column, name in places if name is not None}


def _finite(value: float, digits: int = 4) -> float | None:
    return round(value, digits) if math.isfinite(value) else None


def _list(values: NDArray[np.float64], digits: int = 4) -> list[Any]:
    return [_finite(v, digits) for v in values.ravel().tolist()]


def _pose(pose: Pose) -> dict[str, Any]:
    return {
        "distance_mm": _finite(pose.distance_mm),
        "distance_sigma_mm": _finite(pose.sigma.distance_mm),
        "tilt_deg": _finite(pose.tilt_deg),
        "tilt_sigma_deg": _finite(pose.sigma.tilt_deg),
        "tilt_picture_deg": _list(np.degrees(np.arctan2(pose.rotation[:2, 2], pose.rotation[2, 2]))),
        "fit_px": _finite(pose.reprojection_error_px),
    }


def _alignment(a: Alignment, pose: Pose | None, rule: NamingRule) -> dict[str, Any]:
    j, p = a.judgement, a.parallelism
    return {
        "target": a.target,
        "name": None if a.name is None else rule.full(a.name),
        "place": None if a.place is None else list(a.place),
        "state": a.state.name.lower(),
        "on_map": a.on_map,
        "map_approximate": a.map_approximate,
        "verdict": str(a.verdict),
        "quality": a.quality,
        "grade": None if j.grade is None else j.grade.name.lower(),
        "offset_grade": None if j.offset_grade is None else j.offset_grade.name.lower(),
        "tilt_grade": None if j.tilt_grade is None else j.tilt_grade.name.lower(),
        "advice": j.advice,
        "reasons": list(j.reasons),
        "help": [str(h) for h in j.helps],
        "parallelism_deg": None if p is None else _finite(p.deg),
        "parallelism_sigma_deg": None if p is None else _finite(p.sigma_deg),
        **({} if a.lean is None or pose is None else _lean(a, pose)),
    }


def _lean(a: Alignment, pose: Pose) -> dict[str, Any]:
    """Offset and lean in the picture's directions, right and down, as the operator sees them."""
    assert a.lean is not None, "asked for only where there is one"
    axes, lean = picture_axes(pose), a.lean
    out: dict[str, Any] = {
        "offset_mm": _finite(lean.distance_mm),
        "offset_sigma_mm": _finite(lean.offset_sigma_mm),
        "offset_picture_mm": _list(axes @ lean.offset_mm),
        "offset_spread_mm2": _list(axes @ lean.covariance[:2, :2] @ axes.T, 6),
        "tilt_deg": _finite(lean.tilt_deg),
        "tilt_sigma_deg": _finite(lean.tilt_sigma_deg),
        "tilt_picture_deg": _list(axes @ np.degrees(np.arctan(lean.slope))),
        "gap_mm": _finite(lean.gap_mm, 2),
    }
    if a.entry is not None:
        outline = entry_outline(pose, a.entry, ENTRY_POINTS)
        out["margin_mm"], out["margin_sigma_mm"] = _finite(a.entry.margin_mm), _finite(a.entry.margin_sigma_mm)
        out["clearance_mm"] = _finite(a.entry.clearance_mm)
        out["entry_px"] = _list(outline, 2) if np.isfinite(outline).all() else None
    return out
