"""The same USB grabber without a kernel driver, read from user space through libusb."""

import itertools
import threading
import time

import numpy as np
import pytest

from drivers.discovery import usb_grabbers
from drivers.errors import (
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceTimeoutError,
    UnsupportedFormatError,
)
from drivers.grabber import GrabberState
from drivers.opening import bus_reset, open_grabber
from tests.fakes.uvc import PROCESSING_UNIT, number_in, numbered
from tests.kernel.conftest import USB, read_until, reopened, replugged, settled, streaming


@pytest.fixture
def grabber(bare_socket):
    made = open_grabber(f"uvc:{USB}")
    yield made
    made.close()


def frames(grabber, count):
    return [grabber.read(10.0) for _ in range(count)]


def assert_sound(frame, channel=0):
    number, seen_channel = number_in(frame.pixels)
    assert (frame.defect, seen_channel) == (None, channel)
    np.testing.assert_array_equal(frame.pixels, numbered(number, channel, frame.size_px))


def test_it_is_listed_and_opens_by_its_line(bare_socket):
    ((device,)) = usb_grabbers()
    assert (device.source, device.problem) == (f"uvc:{USB}", None)
    assert len(device.inputs) == 4
    with open_grabber(device.source) as grabber:
        assert_sound(grabber.grab(10.0))


def test_frames_are_numbered_timed_and_sound_round_after_round(grabber):
    grabber.open()
    for _ in range(2):
        grabber.start()
        got = frames(grabber, 8)
        grabber.stop()
        for frame in got:
            assert_sound(frame)
            assert 0 <= frame.received_ns - frame.timestamp_ns < 1e9
        assert [f.sequence for f in got] == list(range(8))
        assert all(a.timestamp_ns < b.timestamp_ns for a, b in itertools.pairwise(got))


def test_so_are_those_of_a_jpeg_stream_of_another_size(bare_socket):
    with open_grabber(f"uvc:{USB}?encoding=MJPG&size=320x240") as grabber:
        grabber.start()
        for frame in frames(grabber, 4):
            assert (frame.size_px, frame.defect) == ((320, 240), None)


def test_four_inputs_are_switched_while_streaming(grabber):
    grabber.open().start()
    for channel in (1, 2, 3, 0):
        grabber.select_input(f"Composite {channel + 1}")
        assert grabber.input == f"Composite {channel + 1}"
        settled(lambda channel=channel: number_in(grabber.read(10.0).pixels)[1] == channel, "the other input's picture")


def test_settings_are_changed_and_read_back(bare_socket, grabber):
    grabber.open()
    ((brightness,)) = [c for c in grabber.controls() if c.name == "brightness"]
    assert (brightness.minimum, brightness.maximum, brightness.default) == (0, 255, 128)
    assert grabber.set_control("brightness", 200) == grabber.control("brightness") == 200
    assert bare_socket.device.values[PROCESSING_UNIT, 2] == 200


def test_bad_frames_are_told(bare_socket, grabber):
    bare_socket.device.faults.update({2: "err", 4: "short", 6: "no_eof"})
    grabber.open().start()
    got = frames(grabber, 8)
    assert [f.sequence for f in got] == list(range(8))
    assert [f.sequence for f in got if f.defect] == [2, 4]
    assert grabber.counters.corrupt == 2


def test_a_stall_is_told_and_healed_by_opening_again(bare_socket, grabber):
    streaming(grabber)
    bare_socket.plugged.halted = True
    read_until(grabber, DeviceProtocolError)
    assert grabber.state is GrabberState.FAULTED
    grabber.close()
    assert_sound(grabber.open().grab(10.0))


def test_a_device_that_hangs_times_out_and_a_new_start_heals_it(bare_socket, grabber):
    streaming(grabber)
    bare_socket.plugged.hung = True
    read_until(grabber, DeviceTimeoutError)
    grabber.stop()
    grabber.start()
    assert_sound(grabber.read(10.0))


def test_unplugged_it_is_noticed_and_found_again_at_another_address(bare_socket, grabber, measured):
    streaming(grabber)
    before, pulled = grabber.node, []
    pull = threading.Timer(0.2, lambda: (pulled.append(time.monotonic()), bare_socket.unplug()))
    pull.start()
    read_until(grabber, DeviceDisconnectedError)
    measured(f"unplug noticed within {time.monotonic() - pulled[0]:.3f} s")
    pull.join()
    grabber.close()
    with pytest.raises(DeviceNotFoundError, match="is not there"):
        grabber.open()
    bare_socket.plug()
    assert_sound(reopened(grabber).grab(10.0))
    assert grabber.node != before


def test_a_reset_while_it_streams_is_survived(grabber):
    streaming(grabber)
    bus_reset(grabber.name)()
    read_until(grabber, (DeviceDisconnectedError, DeviceProtocolError, DeviceTimeoutError))
    grabber.close()


def test_eight_replugs_while_it_streams_leave_nothing_behind(bare_socket, grabber, measured):
    memory = replugged(grabber, bare_socket.unplug, bare_socket.plug, times=8)
    measured(f"8 replugs: {memory / 1e6:+.2f} MB")
    assert memory < 4e6


def test_a_device_that_sends_isochronously_is_refused_with_what_to_do(usb_bus):
    usb_bus.socket(driven=False, bulk=False)
    with pytest.raises(UnsupportedFormatError, match="modprobe uvcvideo"):
        open_grabber(f"uvc:{USB}").open()
