"""The alarm desk: keeps the list, tells of what comes, goes and is seen."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any, Protocol

from service.alignment.alarms import AlarmList, acknowledge, step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.alignment.alarms import Alarm, Condition

__all__ = ["AlarmDesk", "Tell"]

log = logging.getLogger(__name__)


class Tell(Protocol):
    """Who is told of what happens at the station."""

    def __call__(self, text: str, level: str, *, kind: str = "source", **more: Any) -> None:
        """Take note, at once: in words, INFO, WARN or ERROR, of which kind, and in figures what it was."""
        ...


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

    @property
    def unseen(self) -> Sequence[Alarm]:
        """What nobody has acknowledged, in the order in which it was raised."""
        return [alarm for alarm in self._list if alarm.flashes]

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
        if change == "raised":
            log.warning("%s: %s; %s", words, c.reason, c.todo)
        else:
            log.info("%s: %s", words, c.reason)
        self._tell(f"{words}: {c.reason}", level, kind="alarm", key=c.key, change=change, **figures, **more)
