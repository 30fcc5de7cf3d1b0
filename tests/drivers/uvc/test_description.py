"""USB video devices are described without being opened: those that no kernel driver serves."""

import os

import pytest

from drivers.access import Holder
from drivers.grabber import SignalStatus, Standard
from drivers.uvc.description import usb_grabbers
from drivers.video_device import OfferedFormat, OfferedInput
from tests.drivers.tree import put
from tests.fakes.usb import Plugged, plug_in
from tests.fakes.uvc import FakeUvcDevice


@pytest.fixture
def show(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: True)

    def show(driver="", **device):
        plug_in(tmp_path, Plugged(FakeUvcDevice(**device)), driver=driver)
        return usb_grabbers(tmp_path, tmp_path / "proc")

    return show


def test_a_device_is_described_with_all_that_a_station_file_needs(show, tmp_path):
    fds = put(tmp_path / "proc/71/fd")
    put(tmp_path / "proc/71", comm="ffmpeg")
    (fds / "5").symlink_to("/dev/bus/usb/001/004")
    ((device,)) = show(inputs=2, encodings=("YUYV", "H264", "MJPG"))
    assert (device.node, device.name) == ("/dev/bus/usb/001/004", "Lab Fake UVC grabber")
    assert device.source == "uvc:usb-1209:0001-SN1"
    assert device.inputs == tuple(
        OfferedInput(f"Composite {n}", "analogue", (Standard.NONE,), False, SignalStatus.UNKNOWN) for n in (1, 2)
    )
    assert device.formats == tuple(OfferedFormat(e, ((64, 48), (32, 24))) for e in ("YUYV", "MJPG"))
    assert device.held_by == (Holder(71, "ffmpeg"),)
    assert device.problem is None


def test_one_that_a_kernel_driver_serves_is_the_kernel_s(show):
    assert show(driver="uvcvideo") == []


def test_one_that_sends_isochronously_is_listed_with_what_helps(show):
    ((device,)) = show(bulk=False)
    assert "modprobe uvcvideo" in device.problem


def test_one_that_may_not_be_opened_names_the_rule(show, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)
    ((device,)) = show()
    assert "may not be opened by this user" in device.problem
    assert "config/deploy/70-bowlsight.rules" in device.problem


def test_one_whose_descriptors_cannot_be_read_sends_no_video(show, tmp_path):
    show()
    (tmp_path / "bus/usb/devices/1-2/descriptors").unlink()
    ((device,)) = usb_grabbers(tmp_path, tmp_path / "proc")
    assert device.problem == "sends no video"
