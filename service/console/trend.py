"""The last minute, for the page's trends: kept here, so that a page opened later shows it too."""

from __future__ import annotations

import collections
import math
import threading
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.results import FrameResult

__all__ = ["FIELDS", "Trend"]

SPAN_NS = 60_000_000_000
STEP_NS = 100_000_000
"""Closer points could not be told apart on the page."""
FIELDS = ("offset_mm", "offset_sigma_mm", "tilt_deg", "tilt_sigma_deg", "distance_mm", "distance_sigma_mm")
Point: TypeAlias = tuple[float | None, ...]


class Trend:
    """Points of the last 60 s, each the time (ms, monotonic) and `FIELDS`. Callable from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._points: collections.deque[Point] = collections.deque(maxlen=SPAN_NS // STEP_NS)
        self._last_ns: int | None = None

    def add(self, time_ns: int, result: FrameResult) -> Point | None:
        """Take one frame's figures in; gives the point, or None where the last one is too near."""
        with self._lock:
            if self._last_ns is not None and 0 <= time_ns - self._last_ns < STEP_NS:
                return None
            self._last_ns = time_ns
            point = (time_ns / 1e6, *(None if not math.isfinite(v) else round(v, 4) for v in _figures(result)))
            self._points.append(point)
            return point

    def since(self, now_ns: int) -> Sequence[Point]:
        """Points of the minute before `now_ns`, the oldest first."""
        with self._lock:
            return [p for p in self._points if p[0] is not None and p[0] * 1e6 > now_ns - SPAN_NS]


def _figures(result: FrameResult) -> tuple[float, ...]:
    """Values of `FIELDS`; the tilt is the guide's to the tube, or without a guide the camera's to the sheet."""
    pose, alignment = result.measurement.pose, result.alignment
    lean = None if alignment is None else alignment.lean
    distance = (math.nan, math.nan) if pose is None else (pose.distance_mm, pose.sigma.distance_mm)
    if lean is not None:
        return (lean.distance_mm, lean.offset_sigma_mm, lean.tilt_deg, lean.tilt_sigma_deg, *distance)
    if pose is None or alignment is not None:
        return (math.nan,) * 4 + distance
    return (math.nan, math.nan, pose.tilt_deg, pose.sigma.tilt_deg, *distance)
