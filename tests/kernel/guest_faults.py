"""Every fault that vivid can be told to have, and pulling it out while it streams."""

import itertools
import threading
import time

import pytest

from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceNotFoundError,
    DeviceProtocolError,
)
from drivers.grabber import GrabberState
from drivers.sequence import SEQUENCE_NUMBERS
from tests.kernel.conftest import read_until, reopened, replugged, streaming

# -- frames ------------------------------------------------------------------------------------------------------------


def test_dropped_frames_are_gaps_and_every_number_is_accounted_for(vivid, grabber):
    grabber.open().start()
    frames = [grabber.read(10.0)]
    vivid.set("Percentage of Dropped Buffers", 50)
    frames += [grabber.read(10.0) for _ in range(25)]
    numbers = {f.sequence for f in frames}
    assert grabber.counters.lost >= 5
    assert len(numbers) + grabber.counters.lost == max(numbers) - min(numbers) + 1


def test_a_frame_marked_as_bad_has_a_defect(vivid, grabber):
    streaming(grabber)
    vivid.set("Inject V4L2_BUF_FLAG_ERROR")
    frames = [grabber.read(10.0) for _ in range(15)]
    bad = [f for f in frames if f.defect]
    assert [f.defect for f in bad] == ["the device marked it as bad"]
    assert grabber.counters.corrupt == 1
    assert grabber.state is GrabberState.STREAMING


def test_numbers_go_on_past_their_wrap(vivid, grabber):
    vivid.set("Wrap Sequence Number")
    grabber.open().start()
    numbers = [grabber.read(10.0).sequence]
    while numbers[-1] < SEQUENCE_NUMBERS + 3:
        numbers.append(grabber.read(10.0).sequence)
    assert numbers[0] < SEQUENCE_NUMBERS
    assert all(0 <= b - a < 60 for a, b in itertools.pairwise(numbers))
    assert len(set(numbers)) + grabber.counters.lost == numbers[-1] - numbers[0] + 1


@pytest.mark.parametrize("bits", [1, 2], ids=["64 bit", "32 bit"])
def test_times_of_another_clock_are_not_believed(vivid, grabber, bits):
    vivid.set("Wrap Timestamp", bits)
    grabber.open().start()
    frames = [grabber.read(10.0) for _ in range(8)]
    vivid.set("Wrap Timestamp", 0)
    assert {f.received_ns - f.timestamp_ns for f in frames} == {20_000_000}, "when it came, less the second field"
    assert {f.defect for f in frames} == {None}


def test_a_reader_who_pauses_gets_the_oldest_frames_or_the_newest_as_asked(vivid):
    with vivid.grabber(buffers=4) as grabber:
        first = grabber.start().read(10.0)
        time.sleep(0.6)
        kept = [grabber.read(10.0) for _ in range(4)]
        assert kept[0].sequence - first.sequence <= 3
        assert kept[0].received_ns - kept[0].timestamp_ns > 200e6
    with vivid.grabber(buffers=4, newest=True) as grabber:
        grabber.start().read(10.0)
        time.sleep(0.6)
        stale, fresh = grabber.read(10.0), grabber.read(10.0)
        assert fresh.sequence - stale.sequence > 4, "the buffers were full; what came after was lost"
        assert grabber.counters.lost > 4


# -- requests ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("button", ["Inject VIDIOC_REQBUFS Error", "Inject VIDIOC_STREAMON Error"])
def test_a_start_that_fails_is_told_and_may_be_tried_again(vivid, grabber, button):
    grabber.open()
    vivid.set(button)
    with pytest.raises(DeviceProtocolError, match="cannot start"):
        grabber.start()
    assert grabber.state is GrabberState.OPEN
    assert grabber.grab(10.0).defect is None


def test_a_buffer_that_is_not_taken_back_ends_the_stream(vivid, grabber):
    streaming(grabber)
    vivid.set("Inject VIDIOC_QBUF Error")
    read_until(grabber, DeviceProtocolError)
    assert grabber.state is GrabberState.FAULTED
    grabber.close()
    assert grabber.open().grab(10.0).defect is None


def test_a_fatal_error_is_told_once_and_healed_by_opening_again(vivid, grabber):
    streaming(grabber)
    vivid.set("Inject Fatal Streaming Error")
    read_until(grabber, DeviceProtocolError)
    grabber.close()
    streaming(grabber)
    assert grabber.read(10.0).generation == 2


def test_two_grabbers_cannot_stream_from_one_device_and_the_second_is_told_by_whom(vivid, grabber):
    streaming(grabber)
    with pytest.raises(DeviceBusyError, match=r"in use by .*\(pid \d+\)"):
        vivid.grabber().open()
    assert grabber.read(10.0).defect is None


def test_a_source_that_changes_its_pictures_is_noticed_and_followed(vivid, grabber):
    grabber.open().select_input("HDMI 0")
    grabber.start()
    grabber.read(10.0)
    vivid.set("DV Timings Signal Mode", 4)
    vivid.set("DV Timings", 4)
    read_until(grabber, DeviceProtocolError)
    assert grabber.source_changes >= 1
    grabber.close()
    assert grabber.open().grab(10.0).size_px == (720, 576)


# -- gone --------------------------------------------------------------------------------------------------------------


def test_a_device_that_disconnects_is_noticed_and_is_back_once_it_was_closed(vivid, grabber):
    streaming(grabber)
    vivid.set("Disconnect")
    read_until(grabber, DeviceDisconnectedError)
    grabber.stop()
    grabber.close()
    assert reopened(grabber).grab(10.0).generation == 2


def test_a_device_pulled_out_is_noticed_and_found_again(vivid, grabber, measured):
    noticed, replugged = [], []
    for _ in range(3):
        streaming(grabber)
        pulled = []
        pull = threading.Timer(0.2, lambda pulled=pulled: (pulled.append(time.monotonic()), vivid.unplug()))
        pull.start()
        read_until(grabber, DeviceDisconnectedError)
        noticed.append(time.monotonic() - pulled[0])
        pull.join()
        grabber.close()
        with pytest.raises(DeviceNotFoundError, match="is not there"):
            grabber.open()
        vivid.plug()
        began = time.monotonic()
        reopened(grabber).start().read(10.0)
        replugged.append(time.monotonic() - began)
        grabber.close()
    measured(f"unplug noticed within {max(noticed):.3f} s, first frame {max(replugged):.2f} s after the replug")


def test_twenty_replugs_while_it_streams_leave_nothing_behind(vivid, grabber):
    assert replugged(grabber, vivid.unplug, vivid.plug, times=20) < 4e6


def test_stop_and_close_end_soon_from_every_state(vivid, grabber):
    def opened():
        grabber.open()

    def begun():
        grabber.open().start()

    def faulted():
        streaming(grabber)
        vivid.set("Inject Fatal Streaming Error")
        read_until(grabber, DeviceError)

    def gone():
        streaming(grabber)
        vivid.unplug()

    for prepare in (lambda: None, opened, begun, lambda: streaming(grabber), faulted, gone):
        prepare()
        began = time.monotonic()
        grabber.stop()
        grabber.close()
        assert time.monotonic() - began < 2.0
    vivid.plug()
