"""The readings beside the picture, as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from service.vision.measurement import Lock, Origin, TubeState

if TYPE_CHECKING:
    from service.results import FrameResult
    from service.vision.measurement import Measurement, Tubes

__all__ = ["reading", "status_text", "why"]


def why(m: Measurement) -> str | None:
    """Say why the lock is not full; None where it is."""
    if m.lock is Lock.NONE:
        return m.reason or "no reason given"
    return ", ".join(m.doubt) + " in doubt" if m.doubt else None


def reading(value: float, sigma: float, unit: str) -> str:
    """Write a value with its sigma to two digits of the sigma, such as ``1265.32 ± 0.31 mm``."""
    if not math.isfinite(sigma) or sigma <= 0:
        return f"{value:.2f} {unit}, sigma {'unknown' if sigma != 0 else '0'}"
    digits = min(4, max(0, 1 - math.floor(math.log10(sigma))))
    return f"{value:.{digits}f} ± {sigma:.{digits}f} {unit}"


def status_text(result: FrameResult, title: str = "") -> str:
    """Say in Markdown what was measured on one frame."""
    m = result.measurement
    said = why(m)
    lines = [f"**{title}**"] if title else []
    lines.append(f"# Lock {m.lock}" + (f": {said}" if said else ""))
    about = [f"frame {result.sequence}" + ("" if m.field == "progressive" else f", {m.field} field")]
    if (p := m.pose) is not None:
        lines.append(f"# {reading(p.distance_mm, p.sigma.distance_mm, 'mm')} distance")
        lines.append(f"# {reading(p.tilt_deg, p.sigma.tilt_deg, 'deg')} tilt")
        lines.append(_tubes(m.tubes))
        about[:0] = [f"fit {p.reprojection_error_px:.2f} px rms", f"sideways ± {p.sigma.lateral_mm:.2f} mm"]
    if "total" in m.elapsed_ms:
        about.append(f"measured in {m.elapsed_ms['total']:.0f} ms")
    lines.append("; ".join(about))
    return "\n\n".join(lines)


def _tubes(tubes: Tubes) -> str:
    measured = np.count_nonzero(tubes.origin == Origin.MEASURED)
    special = {s.name.lower(): np.count_nonzero(tubes.state == s) for s in (TubeState.PLUGGED, TubeState.ABSENT)}
    among = ", ".join(f"{count} {name}" for name, count in special.items() if count)
    return f"{measured} measured, {len(tubes) - measured} predicted" + (f"; among them {among}" if among else "")
