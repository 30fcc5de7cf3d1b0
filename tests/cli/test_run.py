"""`run` waits for what may come, and for nothing else."""

import pytest

from drivers.errors import DeviceBusyError, DeviceNotFoundError, UnsupportedFormatError
from service.cli.run import wait_for
from tests.fakes.clock import ManualClock
from tests.fakes.scripted import ScriptedGrabber


def opening(*errors):
    """A device whose first attempts to open fail so."""
    left = list(errors)

    def on_open():
        if left:
            raise left.pop(0)

    return ScriptedGrabber(on_open=on_open, clock=ManualClock())


def test_a_device_that_is_not_there_yet_is_waited_for_and_that_is_said_once(capsys):
    absent, taken = DeviceNotFoundError("fake", "is not there"), DeviceBusyError("fake", "is taken")
    grabber = opening(absent, absent, absent, taken)
    began_ns = grabber.clock.now_ns
    wait_for(grabber, 0.5)
    assert grabber.state == "closed"
    assert grabber.clock.now_ns - began_ns == 2_000_000_000
    assert capsys.readouterr().err.splitlines() == [
        "bowlsight: fake: is not there; waiting for it",
        "bowlsight: fake: is taken; waiting for it",
    ]


def test_what_waiting_cannot_help_is_raised():
    with pytest.raises(UnsupportedFormatError):
        wait_for(opening(UnsupportedFormatError("fake", "has no format")), 0.5)
