import logging
import threading
from dataclasses import dataclass

import pytest

from drivers.grabber import SystemClock
from drivers.reading import Quality
from service.acquisition.poller import Heard, InstrumentPoller
from tests.fakes.scripted import PATIENCE_S


@dataclass(frozen=True)
class Said:
    value: int
    quality: Quality = Quality.GOOD
    reason: str | None = None
    time_ns: int = 0


class Instrument:
    """Gives its readings one by one, an exception being raised and a callable called; then sets `told` and waits."""

    name = "fake"

    def __init__(self, *readings):
        self.readings = list(readings)
        self.told, self.ended, self.closed = threading.Event(), threading.Event(), 0
        self.on_close = None

    def read(self):
        if not self.readings:
            self.told.set()
            assert self.ended.wait(PATIENCE_S)
            return Said(-1, Quality.BAD, "ended")
        step = self.readings.pop(0)
        step = step() if callable(step) else step
        if isinstance(step, Exception):
            raise step
        return step

    def abort(self):
        self.ended.set()

    def close(self):
        self.closed += 1
        if self.on_close:
            raise self.on_close


def polled(instrument):
    poller = InstrumentPoller(instrument, "lens", 1000, SystemClock())
    assert poller.heard == Heard()
    poller.start()
    assert instrument.told.wait(PATIENCE_S)
    poller.request_stop()
    assert poller.join(PATIENCE_S)
    return poller


BAD = Said(0, Quality.BAD, "no answer")


@pytest.mark.parametrize(
    ("readings", "heard"),
    [
        ([], Heard()),
        ([Said(1)], Heard(Said(1), Said(1))),
        ([Said(1), Said(2), Said(3)], Heard(Said(3), Said(3), Said(2))),
        ([Said(1), BAD], Heard(BAD, Said(1))),
        ([Said(1), BAD, Said(2)], Heard(Said(2), Said(2), Said(1))),
        ([BAD], Heard(BAD)),
    ],
)
def test_the_newest_and_the_last_two_good_readings_are_kept(readings, heard):
    instrument = Instrument(*readings)
    poller = polled(instrument)
    assert poller.heard == heard
    assert (poller.polls, poller.failures) == (len(readings), sum(r.quality is Quality.BAD for r in readings))
    assert instrument.closed == 1


def test_trouble_is_told_once_and_so_is_its_end(caplog):
    with caplog.at_level(logging.INFO):
        polled(Instrument(BAD, BAD, BAD, Said(1), Said(2)))
    assert caplog.text.count("the lens at fake: no answer") == 1
    assert caplog.text.count("answers again") == 1


def test_a_mistake_of_the_driver_costs_its_reading_only(caplog):
    poller = polled(Instrument(Said(1), ZeroDivisionError("oops"), Said(2)))
    assert poller.heard.newest == Said(2)
    assert (poller.polls, poller.failures) == (3, 1)
    assert "ZeroDivisionError: oops" in caplog.text


def test_a_device_that_cannot_be_closed_ends_no_less(caplog):
    instrument = Instrument()
    instrument.on_close = OSError("stuck")
    polled(instrument)
    assert "closing failed" in caplog.text


def test_a_device_stuck_in_its_read_is_told_and_left():
    entered, release = threading.Event(), threading.Event()

    def hang():
        entered.set()
        assert release.wait(PATIENCE_S)
        return Said(1)

    poller = InstrumentPoller(Instrument(hang), "lens", 10, SystemClock())
    poller.start()
    assert entered.wait(PATIENCE_S)
    poller.request_stop()
    assert not poller.join(0.05)
    assert not poller.join(-1)
    release.set()
    assert poller.join(PATIENCE_S)
    assert poller.heard == Heard()


def test_one_never_started_has_ended():
    poller = InstrumentPoller(Instrument(), "lens", 10, SystemClock())
    poller.request_stop()
    assert poller.join(0)
