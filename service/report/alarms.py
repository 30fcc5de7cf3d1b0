"""The session's alarms, put together again from its events: raised, cleared, acknowledged, which came first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

__all__ = ["RecordedAlarm", "recorded_alarms"]

MOST_ALARMS: Final = 2000


@dataclass(slots=True)
class RecordedAlarm:
    """An alarm from when it was raised until it left the list.

    Attributes
    ----------
    key, reason
        What was wrong.
    raised_utc
        None: before the recording began.
    value, limit, unit
        The figure when it was raised, and what it must not pass, where it is one.
    first
        Whether it was the first since the list was last empty: the others are often its consequence.
    times
        How often it was raised.
    cleared_utc, acknowledged_utc, by
        When its cause was gone, for the last time; when somebody saw it, and who. None: never in this session.
    """

    key: str
    reason: str
    raised_utc: str | None
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    first: bool = False
    times: int = 1
    cleared_utc: str | None = None
    acknowledged_utc: str | None = None
    by: str = ""

    @property
    def over(self) -> bool:
        """Whether it left the list."""
        return self.cleared_utc is not None and self.acknowledged_utc is not None


def recorded_alarms(events: Iterable[Mapping[str, Any]]) -> list[RecordedAlarm]:
    """Follow the alarms through a session's events, in the order in which they were raised."""
    listed: dict[str, RecordedAlarm] = {}
    found: list[RecordedAlarm] = []
    for event in events:
        if event.get("kind") == "alarm":
            key = str(event.get("key"))
            alarm = _followed(event, listed.get(key), first=not listed)
            if key not in listed and len(found) < MOST_ALARMS:
                found.append(alarm)
            listed[key] = alarm
            if alarm.over:
                del listed[key]
    return found


def _followed(event: Mapping[str, Any], known: RecordedAlarm | None, *, first: bool) -> RecordedAlarm:
    """The alarm after an event."""
    utc = str(event.get("utc"))
    alarm = known or RecordedAlarm(
        str(event.get("key")), str(event.get("text", "")).partition(": ")[2], None, first=first
    )
    match event.get("change"):
        case "raised":
            alarm.times += alarm.raised_utc is not None
            alarm.raised_utc = alarm.raised_utc or utc
            alarm.value, alarm.limit, alarm.unit = event.get("value"), event.get("limit"), str(event.get("unit") or "")
            alarm.cleared_utc = alarm.acknowledged_utc = None
        case "cleared":
            alarm.cleared_utc = utc
        case "acknowledged":
            alarm.acknowledged_utc, alarm.by = utc, str(event.get("operator") or "")
        case _:
            pass
    return alarm
