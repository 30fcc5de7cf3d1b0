"""Settings of a USB video device: ranges, reading back, automatics, and what a device gets wrong."""

import math

import pytest

from drivers.automatics import lock_automatics
from drivers.errors import DeviceStateError
from tests.fakes.clock import ManualClock
from tests.fakes.usb import fake_uvc_grabber
from tests.fakes.uvc import PROCESSING_UNIT

CAMERA_TERMINAL = 1
SETTINGS = {
    (PROCESSING_UNIT, 2): (2, -64, 64, 4, 0),
    (PROCESSING_UNIT, 4): (2, 10, 100, 1, 20),
    (PROCESSING_UNIT, 11): (1, 0, 1, 1, 1),
    (CAMERA_TERMINAL, 2): (1, 1, 8, 0b1001, 8),
    (CAMERA_TERMINAL, 4): (4, 1, 10_000, 1, 157),
    (CAMERA_TERMINAL, 8): (1, 0, 1, 1, 1),
}


@pytest.fixture
def fake(tmp_path):
    def make(**options):
        options = {"camera": True, "settings_there": dict(SETTINGS)} | options
        grabber, plugged = fake_uvc_grabber(ManualClock(), tmp_path, **options)
        grabber.open()
        made.append(grabber)
        return grabber, plugged.device

    made = []
    yield make
    for grabber in made:
        grabber.close()


def test_settings_have_the_names_and_ranges_that_they_have_everywhere(fake):
    grabber, _ = fake()
    told = {c.name: c for c in grabber.controls()}
    assert list(told) == ["brightness", "gain", "auto_white_balance", "auto_exposure", "exposure_time", "auto_focus"]
    brightness, exposure = told["brightness"], told["auto_exposure"]
    assert (brightness.minimum, brightness.maximum, brightness.step, brightness.default) == (-64, 64, 4, 0)
    assert told["exposure_time"].unit == "100 us"
    assert exposure.choices == ("", "Manual Mode", "", "Aperture Priority Mode")
    assert exposure.default == grabber.control("auto_exposure") == 3


def test_they_are_set_to_the_nearest_that_can_be_and_read_back(fake):
    grabber, device = fake()
    for asked, taken in [(-7, -8), (-999, -64), (63.9, 64), (0, 0)]:
        assert grabber.set_control("brightness", asked) == grabber.control("brightness") == taken
    assert grabber.set_control("auto_exposure", 2) == 1, "of those on offer"
    grabber.set_control("exposure_time", 5000)
    assert device.values[CAMERA_TERMINAL, 4] == 5000


def test_automatics_are_locked(fake):
    grabber, device = fake()
    assert lock_automatics(grabber) == {"auto_exposure": 1, "auto_white_balance": 0, "auto_focus": 0}
    assert device.values[CAMERA_TERMINAL, 2] == 1, "manual, as the class has it"


def test_what_a_device_announces_and_does_not_know_is_left_out(fake):
    grabber, _ = fake(refused={(0, PROCESSING_UNIT, 4)})
    assert "gain" not in [c.name for c in grabber.controls()]


def test_so_is_what_has_an_impossible_range(fake):
    grabber, _ = fake(settings_there={(PROCESSING_UNIT, 4): (2, 100, 10, 1, 20)})
    assert grabber.controls() == ()


def test_what_the_device_refuses_is_told(fake):
    grabber, device = fake()
    grabber.controls()
    device.refused.add((0, CAMERA_TERMINAL, 4))
    with pytest.raises(DeviceStateError, match="refuses exposure_time = 3; is an automatic in charge"):
        grabber.set_control("exposure_time", 3)
    with pytest.raises(DeviceStateError, match="no number"):
        grabber.set_control("gain", math.nan)
    with pytest.raises(DeviceStateError, match="has no control warp"):
        grabber.control("warp")
