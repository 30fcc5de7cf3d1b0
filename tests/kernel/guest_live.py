"""The live service on the kernel's own driver: everything that befalls the board is told, and got over, by itself."""

import time

import pytest

from service.acquisition.live import LiveService
from service.acquisition.liveness import Liveness
from service.acquisition.recovery import Supervision
from service.config.supervision import SupervisionSettings
from tests.fakes.scripted import FakeMeasurer

PATIENT = SupervisionSettings(stall_s=3.0, first_frame_s=10.0, hung_s=20.0, late_s=30.0, frozen_restart_s=600.0)
"""An emulated machine on a busy one stands still for seconds."""
PATIENCE_S = 30.0


class Watched:
    """The service on the board, and what it told."""

    def __init__(self, vivid):
        vivid.set("OSD Text Mode", 0)  # a picture that changes
        self.told = []
        self.service = LiveService(
            vivid.grabber(size_px=(720, 576)),
            lambda _: FakeMeasurer(),
            supervision=Supervision(PATIENT, remake=vivid.grabber),
            tell=lambda text, _: self.told.append(text),
        )

    def until(self, what):
        """Wait until something holds of the service's health; gives how long that took, s."""
        began = time.monotonic()
        while not what(health := self.service.health()):
            assert time.monotonic() - began < PATIENCE_S, (health, self.told)
            assert not self.service.wait(0.01), self.service.failure
        return time.monotonic() - began

    def until_shown(self, liveness):
        return self.until(lambda h: h.shown.liveness is liveness)

    def until_recovered(self, times):
        return self.until(lambda h: h.recoveries == times and h.shown.liveness is Liveness.LIVE)


@pytest.fixture
def watched(vivid):
    made = Watched(vivid)
    with made.service:
        made.service.start()
        made.until_shown(Liveness.LIVE)
        yield made
        began = time.monotonic()
        made.service.stop()
        assert time.monotonic() - began < 2.0
    account = made.service.health().account
    assert account.balanced(), account
    assert made.service.stuck == []


def test_unplugged_and_plugged_in_again(vivid, watched, measured):
    vivid.unplug()
    noticed_s = watched.until_shown(Liveness.RECONNECTING)
    before = watched.service.health().generation
    vivid.plug()
    again_s = watched.until_recovered(1)
    assert watched.service.health().generation > before
    assert any("looking for it" in text for text in watched.told)
    measured(f"live: unplug shown within {noticed_s:.3f} s, live again {again_s:.2f} s after the replug")


def test_a_fatal_error_of_the_stream(vivid, watched):
    vivid.set("Inject Fatal Streaming Error")
    watched.until_recovered(1)
    assert any("opening it again" in text for text in watched.told)


def test_a_device_that_the_driver_gives_up(vivid, watched):
    vivid.set("Disconnect")
    watched.until_recovered(1)


def test_a_signal_that_goes_and_comes_back(vivid, watched):
    for mode in (1, 2):
        vivid.set("Standard Signal Mode", mode)
        watched.until_shown(Liveness.NO_SIGNAL)
        vivid.set("Standard Signal Mode", 0)
        watched.until_shown(Liveness.LIVE)
    assert watched.service.health().recoveries == 0
    assert any("no signal" in text for text in watched.told)


def test_an_input_switched_while_it_is_watched(watched):
    second = watched.service.inputs[1]
    before = watched.service.health().generation
    watched.service.select_input(second)
    watched.until(lambda h: h.generation > before and h.shown.liveness is Liveness.LIVE)
    assert watched.service.input == second
    assert any(f"switched to input {second}" in text for text in watched.told)
