"""A USB grabber with four inputs on the kernel's own uvcvideo: pictures, inputs, faults, plugging."""

import grp
import os
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.discovery import usb_grabbers, video_devices
from drivers.errors import DeviceBusyError, DeviceDisconnectedError, DeviceError, DeviceNotFoundError
from drivers.frame import Field
from drivers.grabber import GrabberState
from drivers.identity import find_usb_devices, find_video_nodes
from drivers.opening import bus_reset, open_grabber
from tests.fakes.uvc import PROCESSING_UNIT, number_in, numbered
from tests.kernel.conftest import USB, read_until, reopened, replugged, settled, streaming


@pytest.fixture
def grabber(usb_socket):
    made = open_grabber(f"v4l2:{USB}?encoding=YUYV")
    yield made
    made.close()


def frames(grabber, count):
    return [grabber.read(10.0) for _ in range(count)]


def assert_sound(frame, channel=0):
    number, seen_channel = number_in(frame.pixels)
    assert (frame.defect, seen_channel) == (None, channel)
    np.testing.assert_array_equal(frame.pixels, numbered(number, channel, frame.size_px))


def test_it_is_listed_with_four_inputs_and_the_line_to_open_it(usb_socket):
    ((device,)) = [d for d in video_devices() if d.identity == USB]
    assert (device.driver, device.problem) == ("uvcvideo", None)
    assert len(device.inputs) == 4
    assert [f.encoding for f in device.formats] == ["YUYV", "MJPG"]
    assert usb_grabbers() == [], "the kernel serves it"
    with open_grabber(f"{device.source}?encoding=YUYV") as grabber:
        assert_sound(grabber.grab(10.0))


def test_the_udev_rule_gives_the_usb_device_to_group_video(usb_socket):
    node = Path(find_usb_devices(USB)[0].node)
    assert grp.getgrgid(node.stat().st_gid).gr_name == "video"
    assert node.stat().st_mode & 0o777 == 0o660


def test_frames_are_numbered_timed_and_sound(grabber):
    grabber.open().start()
    got = frames(grabber, 8)
    for frame in got:
        assert_sound(frame)
        assert frame.field is Field.PROGRESSIVE
        assert frame.timestamp_ns <= frame.received_ns
    numbers = [f.sequence for f in got]
    assert len(set(numbers)) + grabber.counters.lost == numbers[-1] - numbers[0] + 1


def test_so_are_those_of_a_jpeg_stream_of_another_size(usb_socket):
    with open_grabber(f"v4l2:{USB}?encoding=MJPG&size=320x240") as grabber:
        grabber.start()
        got = frames(grabber, 4)
    assert {(f.size_px, f.defect) for f in got} == {((320, 240), None)}
    known = cv2.GaussianBlur(numbered(usb_socket.plugged.frames - 1, 0, (320, 240)), (0, 0), 3)
    assert abs(got[-1].pixels.std() / known.std() - 1) < 0.2, "the same noise, but for the compression"


def test_four_inputs_are_switched_while_streaming(grabber):
    grabber.open().start()
    names = [i.name for i in grabber.inputs]
    for channel in (1, 2, 3, 0):
        grabber.select_input(names[channel])
        assert grabber.input == names[channel]
        settled(lambda channel=channel: number_in(grabber.read(10.0).pixels)[1] == channel, "the other input's picture")
    assert grabber.state is GrabberState.STREAMING


def test_settings_are_changed_and_read_back(usb_socket, grabber):
    grabber.open()
    ((brightness,)) = [c for c in grabber.controls() if c.name == "brightness"]
    assert (brightness.minimum, brightness.maximum, brightness.default) == (0, 255, 128)
    assert grabber.set_control("brightness", 200) == grabber.control("brightness") == 200
    assert usb_socket.device.values[PROCESSING_UNIT, 2] == 200


@pytest.mark.parametrize("fault", ["err", "short"])
def test_a_bad_frame_is_dropped_by_the_kernel_and_leaves_a_gap(usb_socket, grabber, fault):
    usb_socket.device.faults.update({4: fault, 6: fault})
    grabber.open().start()
    got = frames(grabber, 8)
    for frame in got:
        assert_sound(frame)
    assert not {4, 6} & {number_in(f.pixels)[0] for f in got}
    assert grabber.counters.lost >= 2


@pytest.mark.parametrize("fault", ["stall", "hang"])
def test_a_stream_that_stands_still_is_noticed_and_a_new_start_heals_it(usb_socket, grabber, fault):
    streaming(grabber)
    if fault == "stall":
        usb_socket.plugged.halted = True
    else:
        usb_socket.plugged.hung = True
    read_until(grabber, DeviceError)
    if grabber.state is GrabberState.STREAMING:
        grabber.stop()
        grabber.start()
    else:
        grabber.close()
        grabber.open().start()
    settled(lambda: grabber.read(10.0).defect is None, "a sound frame")


def test_unplugged_it_is_noticed_and_found_again_under_another_node(usb_socket, grabber, measured):
    streaming(grabber)
    before, pulled = grabber.node, []
    with open(before) as still_open:  # somebody else's program, which has not noticed yet  # noqa: PTH123
        pull = threading.Timer(0.2, lambda: (pulled.append(time.monotonic()), usb_socket.unplug()))
        pull.start()
        read_until(grabber, DeviceDisconnectedError)
        noticed_s = time.monotonic() - pulled[0]
        pull.join()
        grabber.close()
        with pytest.raises(DeviceNotFoundError, match="is not there"):
            grabber.open()
        usb_socket.plug()
        began = time.monotonic()
        reopened(grabber).start()
        assert_sound(grabber.read(10.0))
        assert grabber.node != before
        assert os.fstat(still_open.fileno())
    measured(f"unplug noticed within {noticed_s:.3f} s, first frame {time.monotonic() - began:.2f} s after the replug")


def test_a_reset_of_the_bus_ends_the_stream_and_it_comes_back(grabber, measured):
    streaming(grabber)
    began = time.monotonic()
    bus_reset(grabber.name)()
    took_s = time.monotonic() - began
    read_until(grabber, DeviceDisconnectedError)
    grabber.close()
    settled(lambda: find_video_nodes(USB), "the video nodes are back")
    assert_sound(reopened(grabber).grab(10.0))
    measured(f"a reset took {took_s:.2f} s")


def test_twenty_replugs_while_it_streams_leave_nothing_behind(usb_socket, grabber, measured):
    memory = replugged(grabber, usb_socket.unplug, usb_socket.plug, times=20)
    measured(f"20 replugs: {memory / 1e6:+.2f} MB")
    assert memory < 4e6


# -- other ways to it --------------------------------------------------------------------------------------------------


def test_what_the_kernel_serves_is_left_to_it(usb_socket):
    with pytest.raises(DeviceBusyError, match=f'uvcvideo; set device = "v4l2:{USB}"'):
        open_grabber(f"uvc:{USB}").open()


def test_opencv_reads_it_as_the_fallback(usb_socket):
    with open_grabber(f"opencv:{USB}?encoding=YUYV&size=160x120") as grabber:
        grabber.start()
        got = frames(grabber, 6)
        numbers = [number_in(f.pixels)[0] for f in got]
        assert numbers == sorted(set(numbers)), "each another one"
        assert {(f.sequence, f.defect, f.size_px) for f in got} == {(None, None, (160, 120))}
        time.sleep(1.5)
        sent = usb_socket.plugged.frames
        assert number_in(grabber.read(10.0).pixels)[0] >= sent - 3, "old ones are passed over"
        assert grabber.counters.suspected >= 1


def test_opencv_unplugged_is_noticed_and_found_again(usb_socket):
    with open_grabber(f"opencv:{USB}") as grabber:
        grabber.start()
        grabber.read(10.0)
        usb_socket.unplug()
        read_until(grabber, DeviceDisconnectedError)
        grabber.close()
        usb_socket.plug()
        assert reopened(grabber).grab(10.0).defect is None
