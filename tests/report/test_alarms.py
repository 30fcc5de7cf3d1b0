"""Alarms, put together again from events, are those of the list that wrote them."""

from service.alignment.alarms import Condition
from service.alignment.desk import AlarmDesk
from service.report.alarms import recorded_alarms

A, B = (Condition(key, f"{key} is wrong: why", "do it", 0.7, 0.5, "mm") for key in "ab")


class Events(list):
    def __call__(self, text, level, *, kind, **more):
        self.append(
            {"utc": f"2026-11-22T08:00:{len(self):02d}.000Z", "kind": kind, "level": level, "text": text, **more}
        )


def test_the_first_is_marked_until_the_list_is_empty():
    events = Events()
    desk = AlarmDesk(events)
    desk.look(0, [A])
    desk.look(1, [A, B])
    desk.look(2, [B])
    desk.acknowledge(3, None, "A. Tester")
    desk.look(4, [])
    desk.look(5, [B])
    found = recorded_alarms(events)
    assert [(a.key, a.first, a.over) for a in found] == [("a", True, True), ("b", False, True), ("b", True, False)]
    assert [a.reason for a in found[:2]] == ["a is wrong: why", "b is wrong: why"]
    assert (found[0].value, found[0].limit, found[0].unit, found[0].by) == (0.7, 0.5, "mm", "A. Tester")
    assert found[2].acknowledged_utc is None


def test_one_that_comes_again_before_it_was_seen_is_the_same():
    events = Events()
    desk = AlarmDesk(events)
    for now, conditions in enumerate(([A], [], [A])):
        desk.look(now, conditions)
    (alarm,) = recorded_alarms(events)
    assert (alarm.times, alarm.cleared_utc, alarm.first) == (2, None, True)


def test_one_that_stood_before_the_recording_began_is_kept():
    events = Events()
    events("alarm over: it is dark", "INFO", kind="alarm", key="a", change="cleared")
    (alarm,) = recorded_alarms(events)
    assert (alarm.raised_utc, alarm.reason, alarm.cleared_utc) == (None, "it is dark", events[0]["utc"])
