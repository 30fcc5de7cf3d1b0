"""Hours in a few hundred steps: nothing short is lost, nothing is invented between."""

import numpy as np

from service.report.timeline import STEPS, Envelope, Presence, Steps, days

S = 1_000_000_000


def test_one_value_among_many_is_still_seen():
    steps = Steps.of(0, 7200 * S, 216_000)
    envelope = Envelope(steps)
    for k in range(216_000):
        envelope.add(steps.at(k * S // 30), 9.0 if k == 100_001 else 1.0 + 0.1 * (k % 2))
    times, low, high, mean = envelope.lines()
    assert len(times) == STEPS
    assert envelope.extremes == (1.0, 9.0)
    assert high.max() == 9.0
    assert low.min() == 1.0
    assert abs(np.median(mean) - 1.05) < 1e-9


def test_a_time_without_values_is_a_gap_and_not_a_line():
    steps = Steps(0, 100 * S, 100)
    envelope = Envelope(steps)
    for second in (*range(10), *range(50, 60)):
        envelope.add(second, float(second))
    times, low, _, mean = envelope.lines()
    assert np.isnan(mean).sum() == np.isnan(low).sum() == 1
    assert np.isnan(mean[10])
    assert times[10] == times[11]


def test_short_steps_without_a_value_are_no_gap():
    steps = Steps(0, 1 * S, 100)
    envelope = Envelope(steps)
    for step in range(0, 100, 4):
        envelope.add(step, 1.0)
    assert not np.isnan(envelope.lines()[3]).any()


def test_a_value_that_is_none_is_none():
    envelope = Envelope(Steps(0, S, 10))
    envelope.add(3, None)
    assert envelope.empty


def test_a_time_outside_belongs_to_the_nearest_step():
    steps = Steps(10 * S, 20 * S, 10)
    assert (steps.at(0), steps.at(10 * S), steps.at(20 * S), steps.at(99 * S)) == (0, 0, 9, 9)


def test_a_session_of_one_frame_has_a_step():
    steps = Steps.of(5 * S, 5 * S, 1)
    assert steps.count == 1
    assert steps.at(5 * S) == 0
    assert steps.middles[0] >= days(5 * S)


def test_kinds_are_spans_of_time():
    presence = Presence(Steps(0, 10 * S, 10), ("good", "bad"))
    presence.add("good", 0, 3)
    presence.add("good", 8)
    presence.add("unheard of", 1)
    second = days(S)
    np.testing.assert_allclose(presence.spans("good"), [(0, 4 * second), (8 * second, second)], atol=1e-12)
    assert presence.spans("bad") == []
