import pytest

from drivers.automatics import lock_automatics
from drivers.errors import DeviceStateError
from drivers.v4l2.constants import ControlId, ControlType
from tests.fakes.clock import ManualClock
from tests.fakes.kernel import fake_grabber, setting

MENU = {1: "Manual Mode", 3: "Aperture Priority Mode"}


def camera(menu=MENU, **device):
    controls = (
        setting(ControlId.EXPOSURE_AUTO, "Auto Exposure", 0, 3, 1, 3, ControlType.MENU, items=menu),
        setting(ControlId.AUTO_WHITE_BALANCE, "White Balance, Automatic", 0, 1, 1, 1, ControlType.BOOLEAN),
        setting(ControlId.FOCUS_AUTO, "Focus, Automatic Continuous", 0, 1, 1, 1, ControlType.BOOLEAN),
        setting(ControlId.BRIGHTNESS, "Brightness"),
    )
    grabber, fake = fake_grabber(ManualClock(), controls=controls, **device)
    return grabber.open(), fake


def test_what_the_device_does_by_itself_is_turned_off_and_nothing_else():
    grabber, device = camera()
    assert lock_automatics(grabber) == {"auto_exposure": 1, "auto_white_balance": 0, "auto_focus": 0}
    assert device.values[ControlId.BRIGHTNESS] == 128


def test_only_what_was_asked_for_is_turned_off_and_what_is_not_there_is_none():
    grabber, device = camera()
    assert lock_automatics(grabber, ["auto_focus", "auto_gain"]) == {"auto_focus": 0}
    assert device.values[ControlId.EXPOSURE_AUTO] == 3


def test_an_automatic_that_stays_on_is_told():
    grabber, device = camera()
    device._s_ctrl = lambda fd, a, now_ns: None
    with pytest.raises(DeviceStateError, match="auto_exposure stays on: set to 1, read back as 3"):
        lock_automatics(grabber)


def test_a_menu_without_manual_and_a_name_that_is_no_automatic_are_told():
    with pytest.raises(DeviceStateError, match="auto_exposure knows no manual: Auto"):
        lock_automatics(camera(menu={0: "Auto Mode"})[0])
    with pytest.raises(DeviceStateError, match="brightness is no automatic; known: auto_exposure"):
        lock_automatics(camera()[0], ["brightness"])
