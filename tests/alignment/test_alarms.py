from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from service.alignment.alarms import AlarmList, Condition, acknowledge, step

S = 1_000_000_000
OFFSET = Condition("offset", "the guide is off the tube", "move the guide", 0.8, 0.5, "mm")
TILT = Condition("tilt", "the guide leans", "move the guide", 1.2, 1.0, "deg")
SLOW = replace(OFFSET, key="no-lock", after_s=0.5)


def run(*looks):
    """The list after looks of (second, conditions), or of (second, "ack")."""
    listed = AlarmList()
    for second, what in looks:
        at = int(second * S)
        listed = acknowledge(listed, at) if what == "ack" else step(listed, at, what)
    return listed


def keys(listed):
    return [a.condition.key for a in listed]


def test_nothing_wrong_lists_nothing():
    assert len(run((0, []), (1, []))) == 0


def test_an_alarm_tells_reason_value_limit_time_and_what_to_do():
    (alarm,) = run((3, [OFFSET]))
    c = alarm.condition
    assert (c.reason, c.value, c.limit, c.unit, c.todo) == (
        "the guide is off the tube",
        0.8,
        0.5,
        "mm",
        "move the guide",
    )
    assert (alarm.raised_ns, alarm.flashes, alarm.active) == (3 * S, True, True)


def test_the_value_follows_while_the_alarm_stands():
    (alarm,) = run((0, [OFFSET]), (1, [replace(OFFSET, value=0.9)]))
    assert (alarm.condition.value, alarm.raised_ns) == (0.9, 0)


def test_acknowledged_is_not_cleared():
    (alarm,) = run((0, [OFFSET]), (1, "ack"), (2, [OFFSET]))
    assert (alarm.active, alarm.flashes, alarm.acknowledged_ns) == (True, False, S)


def test_cleared_is_not_acknowledged():
    (alarm,) = run((0, [OFFSET]), (1, []), (2, []))
    assert (alarm.active, alarm.flashes, alarm.cleared_ns) == (False, True, S)


def test_it_leaves_the_list_once_both_in_either_order():
    assert len(run((0, [OFFSET]), (1, "ack"), (2, []))) == 0
    assert len(run((0, [OFFSET]), (1, []), (2, "ack"))) == 0


def test_one_alarm_can_be_acknowledged_alone():
    listed = acknowledge(run((0, [OFFSET, TILT])), S, "tilt")
    assert [(a.condition.key, a.flashes) for a in listed] == [("offset", True), ("tilt", False)]
    assert acknowledge(listed, S, "nothing of that name") == listed


def test_raised_again_it_flashes_again_and_counts():
    (alarm,) = run((0, [OFFSET]), (1, []), (2, [OFFSET]))
    assert (alarm.times, alarm.raised_ns, alarm.cleared_ns, alarm.flashes) == (2, 2 * S, None, True)
    (alarm,) = run((0, [OFFSET]), (1, "ack"), (2, []), (3, [OFFSET]))
    assert (alarm.times, alarm.flashes) == (1, True)


def test_an_acknowledgement_is_of_what_was_raised_then():
    (alarm,) = run((0, [OFFSET]), (1, []), (2, [OFFSET]), (3, "ack"), (4, [OFFSET]))
    assert (alarm.acknowledged_ns, alarm.active) == (3 * S, True)


def test_what_came_first_is_kept_until_the_list_is_empty():
    listed = run((0, [OFFSET]), (1, [OFFSET, TILT]), (2, "ack"), (3, [TILT]))
    assert keys(listed) == ["tilt"]
    assert (listed.first_out.condition.key, listed.first_out.raised_ns) == ("offset", 0)
    listed = step(listed, 4 * S, [])
    assert listed.first_out is None
    assert step(listed, 5 * S, [TILT]).first_out.condition.key == "tilt"


def test_a_list_that_empties_as_another_alarm_comes_begins_with_that_one():
    assert run((0, [OFFSET]), (1, "ack"), (2, [TILT])).first_out.condition.key == "tilt"


def test_of_conditions_that_come_together_the_first_named_is_the_first():
    assert run((0, [TILT, OFFSET])).first_out.condition.key == "tilt"


def test_a_condition_must_hold_for_its_time():
    assert keys(run((0, [SLOW]), (0.4, [SLOW]))) == []
    assert keys(run((0, [SLOW]), (0.4, []), (0.5, [SLOW]), (0.9, [SLOW]))) == []
    assert keys(run((0, [SLOW]), (0.5, [SLOW]))) == ["no-lock"]
    listed = run((0, [SLOW]), (0.5, [SLOW]), (1, []), (1.2, [SLOW]))
    assert [a.active for a in listed] == [False]
    assert [a.active for a in step(listed, int(1.7 * S), [SLOW])] == [True]


conditions = st.lists(st.sampled_from([OFFSET, TILT, SLOW]), max_size=3, unique=True)


@given(st.lists(st.one_of(conditions, st.just("ack")), max_size=20))
def test_whatever_happens_no_alarm_is_lost_unseen(looks):
    listed, now, wrong = AlarmList(), 0, []
    for what in looks:
        now += S // 4
        before = listed
        if what == "ack":
            listed = acknowledge(listed, now)
            assert all(not a.flashes and a.active for a in listed)
            continue
        wrong = what
        listed = step(listed, now, wrong)
        lost = set(keys(before)) - set(keys(listed))
        assert all(not before.alarms[key].flashes for key in lost)
        assert {c.key for c in wrong if not c.after_s} <= {a.condition.key for a in listed if a.active}
        assert {a.condition.key for a in listed if a.active} <= {c.key for c in wrong}
        assert (listed.first_out is None) == (len(listed) == 0)
