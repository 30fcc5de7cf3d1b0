"""Devices are described as they are, those among them that may not be opened too."""

import errno

import pytest

from drivers.access import Holder
from drivers.discovery import video_devices
from drivers.grabber import SignalStatus, Standard
from drivers.v4l2.constants import CapabilityFlag, InputStatus, SizeType, StandardBits
from drivers.v4l2.structs import Request
from drivers.video_device import OfferedFormat, OfferedInput
from tests.drivers.tree import put, usb_device, video_node
from tests.fakes.clock import ManualClock
from tests.fakes.kernel import FakeDevice, FakeInput, FakeKernel


@pytest.fixture
def machine(tmp_path):
    usb = usb_device(tmp_path / "sys", "1-2", serial="A1")
    video_node(tmp_path / "sys", "video0", usb / "1-2:1.0")
    video_node(tmp_path / "sys", "video1", usb / "1-2:1.0", index="1")
    descriptors = put(tmp_path / "proc/71/fd")
    put(tmp_path / "proc/71", comm="ffmpeg")
    (descriptors / "5").symlink_to("/dev/video0")
    inputs = [FakeInput("Composite", status=InputStatus.NO_SIGNAL), FakeInput("S-Video", std=int(StandardBits.PAL))]
    grabber = FakeDevice(inputs=inputs, encodings=("RGB3", "YUYV", "GREY"))
    kernel = FakeKernel(
        ManualClock(), {"/dev/video0": grabber, "/dev/video1": FakeDevice(capabilities=CapabilityFlag.STREAMING)}
    )
    return tmp_path, kernel


def listed(machine):
    folder, kernel = machine
    found = video_devices(folder / "sys", folder / "proc", kernel)
    assert kernel.fds == {}
    return found


def test_a_device_is_described_with_all_that_a_station_file_needs(machine):
    ((device),) = listed(machine)
    assert (device.node, device.name, device.driver) == ("/dev/video0", "USB Video", "fake")
    assert device.source == "v4l2:usb-534d:2109-A1"
    every = (Standard.NTSC, Standard.PAL, Standard.SECAM)
    assert device.inputs == (
        OfferedInput("Composite", "analogue", every, True, SignalStatus.NO_SIGNAL),
        OfferedInput("S-Video", "analogue", (Standard.PAL,), False, SignalStatus.UNKNOWN),
    )
    assert device.formats == (OfferedFormat("GREY", ((64, 48),)), OfferedFormat("YUYV", ((64, 48),)))
    assert device.held_by == (Holder(71, "ffmpeg"),)
    assert device.problem is None


def test_a_device_that_may_not_be_opened_is_listed_with_what_helps(machine):
    machine[1].refusals = {"/dev/video0": errno.EACCES}
    ((device),) = listed(machine)
    assert device.source == "v4l2:usb-534d:2109-A1"
    assert "may not be opened by this user; give it to group video" in device.problem
    assert device.inputs == device.formats == ()


def test_a_device_that_goes_away_while_it_is_asked_is_listed_as_gone(machine):
    folder, kernel = machine
    kernel.devices["/dev/video0"].fails = {Request.QUERYCAP: errno.ENODEV}
    ((device),) = video_devices(folder / "sys", folder / "proc", kernel)
    assert "is gone" in device.problem
    assert kernel.fds == {}


def test_a_range_of_sizes_is_told_by_its_ends(machine):
    def ranged(fd, a, now_ns):
        a.type = SizeType.STEPWISE
        a.size.min_width, a.size.min_height, a.size.max_width, a.size.max_height = 48, 32, 720, 576

    machine[1].devices["/dev/video0"]._enum_framesizes = ranged
    assert listed(machine)[0].formats[0].sizes_px == ((48, 32), (720, 576))
