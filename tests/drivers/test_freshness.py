"""A picture is old by its own time, or where it had been waiting for us."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.freshness import Freshness

PERIOD_NS = 40_000_000


def ms(*values):
    return [round(v * 1e6) for v in values]


@given(st.integers(0, 500), st.lists(st.integers(0, 59), min_size=1, max_size=20))
def test_pictures_of_a_steady_delay_and_some_jitter_are_all_fresh_but_for_those_from_before(delay_ms, jitters):
    freshness = Freshness(PERIOD_NS, 0)
    for number, jitter in enumerate(jitters):
        stamp_ns, now_ns = ms(40 * number, 40 * number + delay_ms + jitter)
        assert freshness.is_fresh(stamp_ns, now_ns, now_ns)
        freshness.take(now_ns)
    assert not freshness.is_fresh(stamp_ns, *ms(40 * number + delay_ms + 60 + 101, 40 * number + delay_ms + 60 + 101))


def test_what_was_taken_before_it_was_wanted_is_old():
    freshness = Freshness(PERIOD_NS, 0)
    freshness.want(1_000_000_000)
    assert not freshness.is_fresh(*ms(959, 1000, 1001))
    assert freshness.is_fresh(*ms(961, 1000, 1001))


def test_without_a_time_what_comes_at_once_after_a_pause_is_old_and_what_is_waited_for_is_not():
    freshness = Freshness(PERIOD_NS, 0)
    assert not freshness.is_fresh(None, *ms(0, 1))
    assert freshness.is_fresh(None, *ms(1, 41))
    freshness.take(*ms(41))
    assert freshness.is_fresh(None, *ms(80, 81)), "no pause"
    freshness.take(*ms(81))
    assert not freshness.is_fresh(None, *ms(500, 501))
    assert freshness.is_fresh(None, *ms(501, 512))


def test_a_repetition_has_the_same_time_or_none_and_the_same_picture():
    one, other = np.zeros((2, 2), np.uint8), np.ones((2, 2), np.uint8)
    for first, second, repeats in [
        ((one, 5), (one.copy(), 5), True),
        ((one, None), (one.copy(), None), True),
        ((one, 5), (one.copy(), 6), False),
        ((one, None), (other, None), False),
        ((one, 5), (other, 5), False),
    ]:
        freshness = Freshness(PERIOD_NS, 0)
        assert not freshness.repeats(*first)
        assert freshness.repeats(*second) is repeats
