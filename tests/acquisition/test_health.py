import logging

import pytest

from service.acquisition.health import Percentiles, Rate, Window
from service.acquisition.repeated import RepeatedLog
from tests.fakes.clock import ManualClock


def test_percentiles_are_of_the_last_values_only():
    window = Window(101)
    assert window.percentiles() == Percentiles(None, None)
    for value in [1e9] * 50 + list(range(101)):
        window.add(value)
    assert window.percentiles() == Percentiles(50, 99)
    window = Window()
    window.add(3.0)
    assert window.percentiles() == Percentiles(3.0, 3.0)


def test_a_rate_is_exact_while_things_happen_and_falls_when_they_stop():
    rate = Rate()
    assert rate.per_second(0) == 0
    for i in range(26):
        rate.add(i * 40_000_000)
    assert rate.per_second(1_010_000_000) == pytest.approx(25)
    assert rate.per_second(26_000_000_000) == pytest.approx(25 / 26)


def test_repeated_warnings_are_counted_not_printed(caplog):
    clock = ManualClock()
    repeated = RepeatedLog(logging.getLogger("test"), clock, every_s=10)
    for _ in range(4):
        repeated.warning("torn", "frame torn")
    repeated.warning("late", "frame late")
    clock.advance(10)
    repeated.warning("torn", "frame torn")
    assert caplog.messages == ["frame torn", "frame late", "frame torn (and 3 more like it)"]
