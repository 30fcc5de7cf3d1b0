"""One line of the result log: what the service says of one frame, or of one field of it."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from service.vision.camera import OpenCVLens, TsaiLens
from service.vision.measurement import Lock, Measurement, Origin, Pose, TubeState, angles_deg

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from service.alignment.priors import Priors
    from service.alignment.result import Alignment
    from service.sinks.session.memory import Memory

__all__ = ["SCHEMA", "FrameResult"]

SCHEMA = 1
_STATES = {s.value: s.name.lower() for s in TubeState}
_ORIGINS = {o.value: o.name.lower() for o in Origin}


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """A measurement with where it came from; what sinks receive.

    Attributes
    ----------
    source, sequence, timestamp_ns, generation
        The frame's.
    measurement
        What vision said.
    names
        One name, or None, a tube; empty where no anchor names them.
    alignment
        How the guide stands to its tube; None where none is set up.
    instruments
        What lens and range finder say; None where there is neither.
    outside
        What the result rests on besides frames and configuration, and took effect with it, in JSON's own types: what
        the operator chose ("anchors", "target"), what the instruments said ("readings"). Not part of the line.
    memory
        What was remembered before its frame, where a recording that begins asks for it. Not part of the line.
    """

    source: str
    sequence: int
    timestamp_ns: int
    generation: int
    measurement: Measurement
    names: Sequence[str | None] = ()
    alignment: Alignment | None = None
    instruments: Priors | None = None
    outside: Mapping[str, Any] | None = None
    memory: Memory | None = None

    def to_dict(self) -> dict[str, Any]:
        """The line as JSON's own types; see `docs/formats.md`."""
        m = self.measurement
        return {
            "schema": SCHEMA,
            "source": self.source,
            "sequence": self.sequence,
            "timestamp_ns": self.timestamp_ns,
            "field": m.field,
            "lock": str(m.lock),
            "reason": m.reason,
            "doubt": [str(d) for d in m.doubt],
            "tubes": self._tubes(),
            "pose": None if m.pose is None or m.lock is Lock.NONE else _pose(m.pose),
            "alignment": None if self.alignment is None else self.alignment.to_dict(),
            **({} if self.instruments is None else {"instruments": self.instruments.to_dict()}),
            "elapsed_ms": {k: round(v, 3) for k, v in m.elapsed_ms.items()},
        }

    def to_json(self) -> str:
        """The line, without its line end."""
        return json.dumps(self.to_dict(), separators=(",", ":"), allow_nan=False)

    def _tubes(self) -> list[dict[str, Any]]:
        t = self.measurement.tubes
        names = self.names or [None] * len(t)
        columns = zip(
            t.row.tolist(), t.column.tolist(), t.center_px.tolist(), t.sigma_px.tolist(), t.origin.tolist(),
            t.state.tolist(), names, strict=True,
        )  # fmt: skip
        return [
            {"row": r, "column": c, "x_px": round(x, 4), "y_px": round(y, 4), "sigma_px": round(s, 4),
             "origin": _ORIGINS[o], "state": _STATES[k], "name": name}
            for r, c, (x, y), s, o, k, name in columns
        ]  # fmt: skip


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _pose(pose: Pose) -> dict[str, Any]:
    camera, s = pose.camera, pose.sigma
    out: dict[str, Any] = {
        "rotation": pose.rotation.tolist(),
        "translation_mm": pose.translation_mm.tolist(),
        "angles_deg": list(angles_deg(pose.rotation)),
        "tz_mm": pose.tz_mm,
        "distance_mm": pose.distance_mm,
        "tilt_deg": pose.tilt_deg,
        "sigma": {
            k: _finite(getattr(s, k)) for k in ("tz_mm", "distance_mm", "tilt_deg", "lateral_mm", "focal_length_mm")
        },
        "focal_length_mm": camera.focal_length_mm,
        "principal_point_px": list(camera.principal_point_px or camera.middle_px),
    }
    if isinstance(camera.lens, OpenCVLens):
        out["opencv_distortion"] = list(camera.lens.coefficients)
    else:
        out["kappa1_per_mm2"] = (camera.lens or TsaiLens()).kappa1_per_mm2
    out["reprojection_error_px"] = pose.reprojection_error_px
    return out
