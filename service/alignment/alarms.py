"""The alarm list: what is wrong, since when, what came first, who has seen it.

A pure machine of list, time and conditions. An alarm is raised when its condition has held for a while, and stays
until the condition is gone *and* somebody has acknowledged it, in either order: acknowledging clears nothing. What came
first is kept until the list is empty again: what follows is often its consequence.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

__all__ = ["Alarm", "AlarmList", "Condition", "acknowledge", "step"]


@dataclass(frozen=True, slots=True)
class Condition:
    """Something that is wrong now.

    Attributes
    ----------
    key
        What it is, the same as long as it lasts.
    reason, todo
        In words: what is wrong, and what to do about it.
    value, limit, unit
        The figure and what it must not pass, where it is one.
    after_s
        How long it must hold before it is an alarm.
    """

    key: str
    reason: str
    todo: str
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    after_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Alarm:
    """A condition that was raised.

    Attributes
    ----------
    condition
        As it was last seen.
    raised_ns
        When it was raised, last.
    active
        Whether the condition still holds.
    acknowledged_ns
        When somebody acknowledged it; None: it still wants to be seen.
    cleared_ns
        When the condition went, where it did.
    times
        How often it was raised before it left the list.
    """

    condition: Condition
    raised_ns: int
    active: bool = True
    acknowledged_ns: int | None = None
    cleared_ns: int | None = None
    times: int = 1

    @property
    def flashes(self) -> bool:
        """Whether nobody has acknowledged it."""
        return self.acknowledged_ns is None


@dataclass(frozen=True, slots=True)
class AlarmList:
    """What is listed, in the order in which it was first raised, and what is on its way.

    Attributes
    ----------
    alarms
        By key.
    since_ns
        When the conditions that are not alarms yet began.
    first_out
        What was raised first since the list was last empty, as it was then; kept even where it has left the list.
    """

    alarms: Mapping[str, Alarm] = field(default_factory=dict)
    since_ns: Mapping[str, int] = field(default_factory=dict)
    first_out: Alarm | None = None

    def __iter__(self) -> Iterator[Alarm]:
        return iter(self.alarms.values())

    def __len__(self) -> int:
        return len(self.alarms)


def step(before: AlarmList, now_ns: int, conditions: Sequence[Condition]) -> AlarmList:
    """The list after a look at what is wrong now; of conditions that come together, the first named is the first."""
    present = {c.key: c for c in conditions}
    alarms = {key: _followed(alarm, present.get(key), now_ns) for key, alarm in before.alarms.items()}
    alarms = {key: alarm for key, alarm in alarms.items() if alarm.active or alarm.flashes}
    first_out = before.first_out if alarms else None
    since_ns = {key: before.since_ns.get(key, now_ns) for key in present if key not in alarms or not alarms[key].active}
    for key, began_ns in list(since_ns.items()):
        if now_ns - began_ns >= present[key].after_s * 1e9:
            alarms[key] = _raised(alarms.get(key), present[key], now_ns)
            del since_ns[key]
    return _listed(alarms, since_ns, first_out)


def _listed(alarms: Mapping[str, Alarm], since_ns: Mapping[str, int], first_out: Alarm | None) -> AlarmList:
    return AlarmList(alarms, since_ns, (first_out or next(iter(alarms.values()))) if alarms else None)


def _followed(alarm: Alarm, condition: Condition | None, now_ns: int) -> Alarm:
    """A listed alarm, with its condition as it is now."""
    if condition is None:
        return replace(alarm, active=False, cleared_ns=now_ns) if alarm.active else alarm
    return replace(alarm, condition=condition) if alarm.active else alarm


def _raised(listed: Alarm | None, condition: Condition, now_ns: int) -> Alarm:
    """A new alarm, or one raised again that cleared without being acknowledged."""
    if listed is None:
        return Alarm(condition, now_ns)
    return replace(
        listed, condition=condition, raised_ns=now_ns, active=True, acknowledged_ns=None, cleared_ns=None,
        times=listed.times + 1,
    )  # fmt: skip


def acknowledge(before: AlarmList, now_ns: int, key: str | None = None) -> AlarmList:
    """The list after somebody has seen one alarm, or all; those whose condition is gone leave it."""
    seen = {
        k: replace(a, acknowledged_ns=now_ns) if a.flashes and key in (None, k) else a for k, a in before.alarms.items()
    }
    return _listed({k: a for k, a in seen.items() if a.active or a.flashes}, before.since_ns, before.first_out)
