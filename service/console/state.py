"""What pages are told besides the pictures, a few times a second: source, alarms, target, recording."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.grabber import Clock
    from service.alignment.alarms import Alarm
    from service.alignment.aligner import Aligner
    from service.alignment.desk import AlarmDesk
    from service.console.operations import Operations
    from service.console.trend import Trend
    from service.console.watched import About, Watched
    from service.sinks.session.control import SessionControl

__all__ = ["StateTeller"]


class StateTeller:
    """Looks at the station, and says how it does."""

    def __init__(
        self,
        about: About,
        watched: Watched,
        operations: Operations,
        desk: AlarmDesk,
        trend: Trend,
        aligner: Aligner | None,
        recorder: SessionControl | None,
        clock: Clock,
    ) -> None:
        self._about, self._watched, self._operations, self._desk = about, watched, operations, desk
        self._trend, self._aligner, self._recorder = trend, aligner, recorder
        self._clock = clock

    def hello(self, *, may_control: bool) -> dict[str, Any]:
        """What a page is told when it opens."""
        a, rule, now_ns = self._about, self._about.rule, self._clock.monotonic_ns()
        return {
            "type": "hello",
            "kind": a.kind,
            "source": a.source,
            "generator": a.generator,
            "naming": rule.naming.value,
            "steam_generator": rule.steam_generator,
            "leg": None if rule.leg is None else str(rule.leg),
            "rows_grow": None if rule.rows_grow is None else str(rule.rows_grow),
            "columns_grow": None if rule.columns_grow is None else str(rule.columns_grow),
            "map": None if rule.map is None else {"name": rule.map.name, "approximate": rule.map.approximate},
            "bands": self._bands(),
            "viewer_url": a.viewer_url(),
            "may_control": may_control,
            "epoch_ms": time.time_ns() / 1e6 - now_ns / 1e6,
            "trend": [list(point) for point in self._trend.since(now_ns)],
        }

    def _bands(self) -> dict[str, float] | None:
        if self._aligner is None:
            return None
        b = self._aligner.settings.bands
        return {
            "offset_normal_mm": b.offset_normal_mm,
            "offset_advisory_mm": b.offset_advisory_mm,
            "offset_sigma_mm": b.offset_sigma_mm,
            "tilt_normal_deg": b.tilt_normal_deg,
            "tilt_advisory_deg": b.tilt_advisory_deg,
            "tilt_sigma_deg": b.tilt_sigma_deg,
            "parallelism_normal_deg": b.parallelism_normal_deg,
            "clearance_mm": self._aligner.settings.geometry.clearance_mm,
        }

    def look(self) -> dict[str, Any]:
        """Say how the station does now."""
        now_ns, status = self._clock.monotonic_ns(), self._watched.status()
        alarms = self._desk.list
        first = alarms.first_out
        return {
            "type": "state",
            "now_ms": now_ns / 1e6,
            "liveness": status.liveness,
            "reason": status.reason,
            "since_ms": None if status.since_ns is None else status.since_ns / 1e6,
            "capture_fps": round(status.capture_fps, 1),
            "result_fps": round(status.result_fps, 1),
            "dropped": status.dropped,
            "bad": status.bad,
            "inputs": list(status.inputs),
            "input": status.input,
            "target": str(self._operations.target),
            **self._operations.naming(),
            "recording": self._recording(),
            "alarms": [alarm_dict(a, now_ns) for a in alarms],
            "first_out": None if first is None else alarm_dict(first, now_ns),
        }

    def _recording(self) -> dict[str, Any] | None:
        if self._recorder is None:
            return None
        s = self._recorder.state
        return {
            "on": s.folder is not None,
            "session": None if s.folder is None else s.folder.name,
            "failure": s.failure,
            "frames": s.frames,
            "evidence": s.evidence,
            "overflowed": s.overflowed,
        }


def alarm_dict(alarm: Alarm, now_ns: int) -> dict[str, Any]:
    """An alarm as the page gets it."""
    c = alarm.condition
    return {
        "key": c.key,
        "reason": c.reason,
        "todo": c.todo,
        "value": None if c.value is None else round(c.value, 4),
        "limit": c.limit,
        "unit": c.unit,
        "age_s": round((now_ns - alarm.raised_ns) / 1e9, 1),
        "raised_ms": alarm.raised_ns / 1e6,
        "active": alarm.active,
        "acknowledged": not alarm.flashes,
        "times": alarm.times,
    }
