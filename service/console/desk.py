"""The alarm desk: looks at what is wrong now, keeps the list, tells of what comes, goes and is seen."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from service.alignment.alarms import AlarmList, Condition, acknowledge, step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.alignment.alarms import Alarm
    from service.console.watched import SourceStatus, Tell

__all__ = ["AlarmDesk", "alarm_dict", "source_conditions"]

WHAT_TO_DO = {
    "NO SIGNAL": "check camera, lamp and cable, and which input is chosen; stop moving",
    "FROZEN": "stop moving: the picture is not live; check the grabber",
    "STALE": "stop moving: the picture is old; check grabber and cable",
    "RECONNECTING": "stop moving; it is looked for by itself; check its cable",
    "ENDED": "stop moving; start the service again",
}


def source_conditions(kind: str, status: SourceStatus) -> Sequence[Condition]:
    """What is wrong with the source; that a recording is over is no alarm."""
    word = status.liveness
    if word not in WHAT_TO_DO or (word == "ENDED" and kind == "REPLAY"):
        return ()
    reason = f"{word}: {status.reason}" if status.reason else word
    return (Condition(f"source {word.lower()}", reason, WHAT_TO_DO[word]),)


class AlarmDesk:
    """Keeps the alarm list. Callable from any thread.

    Parameters
    ----------
    tell
        Told of every alarm that is raised, clears or is acknowledged.
    """

    def __init__(self, tell: Tell) -> None:
        self._lock = threading.Lock()
        self._list = AlarmList()
        self._tell = tell

    @property
    def list(self) -> AlarmList:
        """The list as it is now."""
        return self._list

    def look(self, now_ns: int, conditions: Sequence[Condition]) -> AlarmList:
        """Follow what is wrong now."""
        with self._lock:
            before, self._list = self._list, step(self._list, now_ns, conditions)
            after = self._list
        for alarm in after:
            old = before.alarms.get(alarm.condition.key)
            if alarm.active and (old is None or not old.active):
                self._say("alarm", alarm, "raised", "WARN")
        for old in before:
            new = after.alarms.get(old.condition.key)
            if old.active and (new is None or not new.active):
                self._say("alarm over", old, "cleared", "INFO")
        return after

    def acknowledge(self, now_ns: int, key: str | None, operator: str) -> bool:
        """Note that an alarm, or all, was seen; False where there is no such one that still wants to be."""
        with self._lock:
            seen = [a for a in self._list if a.flashes and key in (None, a.condition.key)]
            self._list = acknowledge(self._list, now_ns, key)
        by = f" by {operator}" if operator else ""
        for alarm in seen:
            self._say(f"alarm acknowledged{by}", alarm, "acknowledged", "INFO", operator=operator)
        return bool(seen)

    def _say(self, words: str, alarm: Alarm, change: str, level: str, **more: str) -> None:
        c = alarm.condition
        figures = {"value": c.value, "limit": c.limit, "unit": c.unit}
        self._tell(f"{words}: {c.reason}", level, kind="alarm", key=c.key, change=change, **figures, **more)


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
