"""How the live service is doing: rates, ages, counters, at one moment."""

from __future__ import annotations

import enum
import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from service.acquisition.ledger import Account
    from service.acquisition.liveness import Shown
    from service.acquisition.resources import Resources
    from service.sinks.base import SinkStats

__all__ = ["AcquisitionState", "Health", "Percentiles", "Rate", "Window"]


class AcquisitionState(enum.StrEnum):
    """Where acquisition stands, from the evidence of frames.

    CLOSED before it begins and after a stop. OPENING until the first frame. RUNNING while sound frames come, DEGRADED
    while the last one had a defect, STALLED while none comes. LOST where the device went away, FAULTED where it failed
    otherwise: for good, or until the next attempt, which BACKING_OFF waits for. ENDED where a recording was over.
    """

    CLOSED = "closed"
    OPENING = "opening"
    RUNNING = "running"
    DEGRADED = "degraded"
    STALLED = "stalled"
    LOST = "lost"
    BACKING_OFF = "backing off"
    FAULTED = "faulted"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Median and 99th percentile of the recent values; None before there is one."""

    p50: float | None = None
    p99: float | None = None


class Window:
    """The last values of something, for percentiles. Safe from any thread."""

    def __init__(self, size: int = 512) -> None:
        self._lock = threading.Lock()
        self._values: deque[float] = deque(maxlen=size)

    def add(self, value: float) -> None:
        """Take a value in."""
        with self._lock:
            self._values.append(value)

    def percentiles(self) -> Percentiles:
        """Of the values now held, by nearest rank."""
        with self._lock:
            values = sorted(self._values)
        if not values:
            return Percentiles()
        last = len(values) - 1
        return Percentiles(values[round(0.5 * last)], values[round(0.99 * last)])


class Rate:
    """How often something happens, from the times of its last occurrences. Safe from any thread."""

    def __init__(self, size: int = 64) -> None:
        self._lock = threading.Lock()
        self._times_ns: deque[int] = deque(maxlen=size)

    def add(self, time_ns: int) -> None:
        """Note one occurrence."""
        with self._lock:
            self._times_ns.append(time_ns)

    def per_second(self, now_ns: int) -> float:
        """Occurrences a second; falls towards zero while nothing happens."""
        with self._lock:
            if len(self._times_ns) < 2:
                return 0.0
            count, first, last = len(self._times_ns) - 1, self._times_ns[0], self._times_ns[-1]
        if now_ns - last > 2 * (last - first) / count:
            last = now_ns
        return count * 1e9 / max(1, last - first)


@dataclass(frozen=True, slots=True)
class Health:
    """The service at one moment.

    Attributes
    ----------
    shown
        What operators are told of the picture before them.
    state, generation
        Of acquisition; `generation` grows each time the device is started anew, or switched to another input.
    recoveries
        How often the source was got back after it had failed.
    capture_fps, result_fps
        Frames arriving and frames answered, a second.
    silent_s
        Time since the last frame; None before the first.
    interval_ms
        Between frames arriving.
    age_ms
        Age of frames, since the driver had them, when their processing starts.
    latency_ms
        From there until their results are handed on.
    measuring_s
        How long the frame in hand has been measured; None where none is.
    waiting
        Frames waiting to be measured.
    overflowed
        Frames that lossless subscribers had no room for.
    account
        The ledger.
    locks
        Pictures answered with each lock: "full", "partial", "none".
    sinks
        What each sink did with what it got.
    resources
        What the process holds.
    """

    shown: Shown
    state: AcquisitionState
    generation: int
    recoveries: int
    capture_fps: float
    result_fps: float
    silent_s: float | None
    interval_ms: Percentiles
    age_ms: Percentiles
    latency_ms: Percentiles
    measuring_s: float | None
    waiting: int
    overflowed: int
    account: Account
    locks: Mapping[str, int]
    sinks: Mapping[str, SinkStats]
    resources: Resources
