"""What drivers of the kernel were seen to do, one by one, and what the grabber makes of it."""

import errno
import itertools

import numpy as np
import pytest

from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceStateError,
    DeviceTimeoutError,
)
from drivers.frame import Field
from drivers.grabber import FieldMode, GrabberState, SignalStatus, Standard
from drivers.sequence import SEQUENCE_NUMBERS
from drivers.v4l2.constants import InputStatus, StandardBits
from drivers.v4l2.grabber import V4l2Grabber
from drivers.v4l2.structs import Request
from tests.drivers.tree import usb_device, video_node
from tests.fakes.clock import ManualClock
from tests.fakes.kernel import FakeDevice, FakeInput, FakeKernel, fake_grabber, picture, timings


@pytest.fixture
def clock():
    return ManualClock()


def started(clock, *, grabber=None, **device):
    made, fake = fake_grabber(clock, grabber=grabber, **device)
    made.open().start()
    return made, fake


# -- 1: unplugged ------------------------------------------------------------------------------------------------------


def test_an_unplugged_device_is_noticed_at_once_and_leaves_nothing_behind(clock):
    grabber, device = started(clock, faults={3: "gone"})
    for _ in range(3):
        grabber.read(1.0)
    before_ns = clock.now_ns
    with pytest.raises(DeviceDisconnectedError, match="unplugged"):
        grabber.read(10.0)
    assert clock.now_ns - before_ns <= 50e6
    assert grabber.state is GrabberState.FAULTED
    grabber.stop()
    grabber.close()
    grabber.close()
    assert grabber._system.fds == {}
    assert all(memory.closed for memory in device.mapped)


@pytest.mark.parametrize("call", ["stop", "close", "control", "signal", "input", "trigger"])
def test_a_call_to_a_device_that_went_away_meanwhile_says_so_or_goes_on(clock, call):
    grabber, device = started(clock)
    grabber.read(1.0)
    device.gone = True
    if call in ("stop", "close"):
        getattr(grabber, call)()
    else:
        calls = {
            "control": lambda: grabber.set_control("hue", 3),
            "signal": grabber.signal_status,
            "input": lambda: grabber.select_input("S-Video 2"),
            "trigger": lambda: grabber.read(1.0),
        }
        with pytest.raises(DeviceDisconnectedError, match="/dev/video0: is gone"):
            calls[call]()
    grabber.close()
    assert grabber._system.fds == {}


def test_a_thousand_unplugs_and_replugs_leave_no_descriptor_and_no_mapping(clock):
    grabber, device = fake_grabber(clock)
    for _ in range(1000):
        device.faults = {1: "gone"}
        with grabber:
            grabber.start()
            grabber.read(1.0)
            with pytest.raises(DeviceDisconnectedError):
                grabber.read(1.0)
        with pytest.raises(DeviceNotFoundError):
            grabber.open()
        device.gone, device.owner = False, None
    assert grabber._system.fds == {}
    assert all(memory.closed for memory in device.mapped)
    assert grabber.generation == 1000


# -- 2: back at another node -------------------------------------------------------------------------------------------


def test_it_is_found_again_by_its_identity_at_another_node(clock, tmp_path):
    first, second = FakeDevice(), FakeDevice()
    kernel = FakeKernel(clock, {"/dev/video0": first, "/dev/video1": second})
    usb = usb_device(tmp_path, "1-2", serial="A1")
    node = video_node(tmp_path, "video0", usb / "1-2:1.0")
    grabber = V4l2Grabber("usb-534d:2109-A1", system=kernel, sysfs=tmp_path, clock=clock)
    with grabber:
        assert grabber.node == "/dev/video0"
        node.unlink()
        first.gone = True
        with pytest.raises(DeviceDisconnectedError):
            grabber.start()
    with pytest.raises(DeviceNotFoundError, match=r"is not there; there is no video device at all"):
        grabber.open()
    video_node(tmp_path, "video1", usb / "1-2:1.0")
    with grabber:
        assert grabber.node == "/dev/video1"
        assert grabber.grab(1.0).generation == 2


# -- 3: a fatal error stays --------------------------------------------------------------------------------------------


def test_a_fatal_error_is_told_once_and_healed_by_closing_and_opening(clock):
    grabber, device = started(clock, faults={2: "eio"})
    for _ in range(2):
        grabber.read(1.0)
    asked = len(device.requests)
    with pytest.raises(DeviceProtocolError, match="EIO"):
        grabber.read(5.0)
    assert len(device.requests) - asked <= 2, "a loop that takes buffers again and again would spin"
    assert grabber.state is GrabberState.FAULTED
    with pytest.raises(DeviceStateError):
        grabber.read(1.0)
    grabber.close()
    with grabber:
        assert grabber.grab(1.0).defect is None


def test_a_failure_that_does_not_say_which_is_one_too(clock):
    grabber, device = started(clock, fails={Request.DQBUF: errno.EAGAIN}, faults={0: "eio"})
    with pytest.raises(DeviceProtocolError, match="does not say why"):
        grabber.read(5.0)
    assert device.requests.count(Request.DQBUF) == 1


def test_a_poll_that_promises_a_frame_which_is_not_there_ends_with_the_time(clock):
    grabber, _ = started(clock, faults={0: "spurious", 1: "hang"})
    with pytest.raises(DeviceTimeoutError):
        grabber.read(0.5)
    assert clock.now_ns == pytest.approx(1.5e9, abs=10)


def test_a_hung_device_times_out_as_often_as_it_is_read_and_stops(clock):
    grabber, device = started(clock, faults={1: "hang"})
    grabber.read(1.0)
    for _ in range(3):
        with pytest.raises(DeviceTimeoutError, match=r"no frame within 0\.2 s"):
            grabber.read(0.2)
    assert grabber.counters.timeouts == 3
    grabber.stop()
    grabber.start()
    assert grabber.read(1.0).sequence == 0
    grabber.close()
    assert all(memory.closed for memory in device.mapped)


# -- 4: flawed and missing frames --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "options", "words"),
    [
        ("error", {}, "the device marked it as bad"),
        ("short", {}, "holds 1536 of 3072 bytes"),
        ("empty", {}, "holds 0 of 3072 bytes"),
        ("short", {"encodings": ("YUYV",), "padding": 8}, "holds 3264 of 6528 bytes"),
        ("short", {"encodings": ("NV12",)}, "holds 2304 of 4608 bytes"),
        ("short", {"encodings": ("MJPG",)}, "its JPEG"),
        ("empty", {"encodings": ("MJPG",)}, "its JPEG is empty"),
        ("junk", {"encodings": ("MJPG",)}, "its JPEG"),
    ],
)
def test_a_bad_buffer_is_a_frame_with_a_defect_and_the_next_one_is_sound(clock, fault, options, words):
    grabber, _ = started(clock, faults={1: fault}, **options)
    sound, bad, next_one = (grabber.read(1.0) for _ in range(3))
    assert (sound.defect, next_one.defect) == (None, None)
    assert words in bad.defect
    assert bad.sequence == 1
    assert bad.size_px == sound.size_px
    assert not bad.pixels.flags.writeable
    assert (grabber.counters.completed, grabber.counters.corrupt, grabber.counters.lost) == (3, 1, 0)
    grabber.close()


def test_of_a_short_buffer_the_lines_that_came_are_there_and_the_others_black(clock):
    grabber, _ = started(clock, faults={0: "short"})
    pixels = grabber.read(1.0).pixels
    np.testing.assert_array_equal(pixels[:24], picture(0)[:24])
    assert not pixels[24:].any()
    grabber.close()


def test_a_gap_in_the_numbers_is_counted_as_lost(clock):
    grabber, _ = started(clock, faults={2: "drop", 3: "drop", 6: "drop"})
    assert [grabber.read(1.0).sequence for _ in range(5)] == [0, 1, 4, 5, 7]
    assert grabber.counters.lost == 3
    assert grabber.counters.suspected == 0
    grabber.close()


# -- 5: nobody reads for a while ---------------------------------------------------------------------------------------


def test_after_a_pause_the_frames_kept_come_oldest_first_and_none_is_lost_in_silence(clock):
    grabber, _ = started(clock, grabber={"buffers": 4})
    grabber.read(1.0)
    clock.advance(0.6)
    assert [grabber.read(1.0).sequence for _ in range(6)] == [1, 2, 3, 4, 16, 17]
    assert grabber.counters.lost == 11
    grabber.close()


def test_drained_to_the_newest_a_reader_gets_what_is_newest_and_the_rest_counts_as_lost(clock):
    grabber, device = started(clock, grabber={"buffers": 4, "newest": True})
    grabber.read(1.0)
    clock.advance(0.6)
    assert [grabber.read(1.0).sequence for _ in range(3)] == [4, 16, 17]
    assert grabber.counters.lost == 3 + 11
    assert len(device.queued) == 4
    grabber.close()


# -- 6: numbers --------------------------------------------------------------------------------------------------------


def test_numbers_go_on_past_their_wrap_and_begin_anew_with_a_start(clock):
    grabber, _ = started(clock, first_sequence=SEQUENCE_NUMBERS - 2)
    numbers = [grabber.read(1.0).sequence for _ in range(4)]
    assert [b - a for a, b in itertools.pairwise(numbers)] == [1, 1, 1]
    assert grabber.counters.lost == 0
    grabber.stop()
    assert grabber.start().read(1.0).sequence == SEQUENCE_NUMBERS - 2
    grabber.close()


def test_both_fields_share_a_number_and_none_counts_as_lost(clock):
    grabber, _ = started(clock, grabber={"field_mode": FieldMode.ALTERNATE})
    frames = [grabber.read(1.0) for _ in range(6)]
    assert [f.sequence for f in frames] == [0, 0, 1, 1, 2, 2]
    assert grabber.counters.lost == grabber.counters.suspected == 0
    grabber.close()


def test_frames_that_a_device_loses_without_counting_are_suspected_from_the_times(clock):
    grabber, _ = started(clock, faults={20: "uncounted", 21: "uncounted", 30: "uncounted"})
    frames = [grabber.read(1.0) for _ in range(40)]
    assert [f.sequence for f in frames] == list(range(40))
    assert (grabber.counters.lost, grabber.counters.suspected) == (0, 3)
    grabber.close()


# -- 7: switching while streaming --------------------------------------------------------------------------------------


def test_a_device_that_is_busy_is_stopped_switched_and_started_and_its_numbers_go_on(clock):
    grabber, device = started(clock)
    first = [grabber.read(1.0) for _ in range(3)]
    for channel, name in enumerate(["S-Video 0", "S-Video 1", "S-Video 2", "S-Video 3"]):
        grabber.select_input(name)
        assert grabber.input == name
        frame = grabber.read(1.0)
        assert frame.defect is None
        np.testing.assert_array_equal(frame.pixels, picture(0 if channel else 3, channel))
        assert frame.sequence == 3 + channel
    assert grabber.state is GrabberState.STREAMING
    assert grabber.generation == first[0].generation == 1
    assert grabber.counters.lost == 0
    grabber.close()
    assert all(memory.closed for memory in device.mapped)


def test_frames_in_flight_while_a_device_switches_as_it_streams_are_marked(clock):
    grabber, device = started(clock, stops_to_switch=False)
    grabber.read(1.0)
    clock.advance(0.1)
    grabber.select_input("S-Video 1")
    frames = [grabber.read(1.0) for _ in range(6)]
    assert [f.sequence for f in frames] == [1, 2, 3, 4, 5, 6]
    switched = "was taken while the input was switched"
    assert [f.defect for f in frames] == [switched, switched, switched, None, None, None]
    for frame in frames[3:]:
        np.testing.assert_array_equal(frame.pixels, picture(frame.sequence, 1))
    assert Request.STREAMOFF not in device.requests
    grabber.close()


def test_a_standard_chosen_while_streaming_brings_its_own_format(clock):
    grabber, device = started(clock, fields=frozenset({4}))
    grabber.read(1.0)
    assert grabber.format.field is Field.INTERLACED_TOP_FIRST
    grabber.set_standard(Standard.NTSC)
    assert grabber.standard is Standard.NTSC
    frame = grabber.read(1.0)
    assert frame.field is grabber.format.field is Field.INTERLACED_BOTTOM_FIRST
    assert device.standard == StandardBits.NTSC
    grabber.close()


def test_a_switch_that_fails_leaves_the_stream_as_it_was(clock):
    grabber, device = started(clock)
    grabber.read(1.0)
    device.fails = {Request.S_INPUT: errno.EBUSY}
    with pytest.raises(DeviceBusyError, match="cannot switch to input S-Video 2"):
        grabber.select_input("S-Video 2")
    assert grabber.input == "S-Video 0"
    assert grabber.read(1.0).sequence == 1
    grabber.close()


def test_a_device_that_cannot_start_again_after_a_switch_is_faulted(clock):
    grabber, device = started(clock)
    device.fails = {Request.STREAMON: errno.EIO}
    with pytest.raises(DeviceProtocolError, match="cannot start"):
        grabber.select_input("S-Video 2")
    assert grabber.state is GrabberState.FAULTED
    grabber.close()
    assert all(memory.closed for memory in device.mapped)


# -- 8: what an input says of its signal -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("status", "said", "standard"),
    [
        (0, SignalStatus.OK, Standard.PAL),
        (InputStatus.NO_SIGNAL, SignalStatus.NO_SIGNAL, Standard.NONE),
        (InputStatus.NO_POWER, SignalStatus.NO_SIGNAL, Standard.NONE),
        (InputStatus.NO_H_LOCK, SignalStatus.NO_LOCK, Standard.NONE),
        (InputStatus.NO_STD_LOCK, SignalStatus.NO_LOCK, Standard.NONE),
    ],
)
def test_frames_come_without_a_signal_too_so_the_input_is_asked(clock, status, said, standard):
    grabber, _ = started(clock, inputs=[FakeInput("Video", status=status)])
    assert grabber.read(1.0).defect is None
    assert grabber.signal_status() is said
    assert grabber.detected_standard() is standard
    grabber.close()


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        (timings(640, 480, 60), SignalStatus.OK),
        (errno.ENOLINK, SignalStatus.NO_SIGNAL),
        (errno.ENOLCK, SignalStatus.NO_LOCK),
        (errno.ERANGE, SignalStatus.NO_LOCK),
        (errno.ENODATA, SignalStatus.UNKNOWN),
    ],
)
def test_of_a_digital_input_its_timings_tell(clock, signal, said):
    grabber, _ = fake_grabber(clock, inputs=[FakeInput("HDMI", std=0, timings=signal)])
    with grabber:
        assert grabber.signal_status() is said
        assert grabber.standard is Standard.NONE


def test_a_camera_has_no_status_so_nothing_is_known_of_its_signal(clock):
    grabber, _ = fake_grabber(clock, inputs=[FakeInput("Camera 1", std=0)])
    with grabber:
        assert grabber.signal_status() is SignalStatus.UNKNOWN
    grabber, _ = fake_grabber(clock, lacks=frozenset({Request.ENUMINPUT, Request.G_INPUT}))
    with grabber:
        assert grabber.signal_status() is SignalStatus.UNKNOWN
        assert grabber.input == grabber.inputs[0].name == "/dev/video0"
        grabber.select_input("/dev/video0")


# -- 9: times, substitutes, unknown requests ---------------------------------------------------------------------------


def test_times_that_lie_in_the_future_are_set_back_and_keep_their_intervals(clock):
    grabber, _ = started(clock, inputs=[FakeInput("Camera", std=0)], ahead_ns=35_000_000)
    frames = [grabber.read(1.0) for _ in range(10)]
    assert all(f.timestamp_ns <= f.received_ns for f in frames)
    assert {b.timestamp_ns - a.timestamp_ns for a, b in itertools.pairwise(frames)} == {40_000_000}
    grabber.close()


@pytest.mark.parametrize("options", [{"stamp_flags": 0}, {"ahead_ns": 10**18}, {"ahead_ns": -(10**18)}])
def test_the_time_of_another_clock_is_none(clock, options):
    grabber, _ = started(clock, inputs=[FakeInput("Camera", std=0)], **options)
    frame = grabber.read(1.0)
    assert frame.timestamp_ns == frame.received_ns == clock.now_ns
    grabber.close()


def test_what_was_asked_and_what_was_granted_are_both_told(clock, caplog):
    grabber, _ = fake_grabber(
        clock, grabber={"size_px": (1280, 720), "rate_hz": 50}, inputs=[FakeInput("Camera", std=0)]
    )
    with grabber:
        asked, granted = grabber.format_asked, grabber.format
        assert (asked.width_px, asked.height_px, asked.rate_hz) == (1280, 720, 50)
        assert (granted.width_px, granted.height_px, granted.rate_hz) == (64, 48, 25)
        assert grabber.grab(1.0).size_px == (64, 48)
    assert [r.message for r in caplog.records] == [
        "/dev/video0: asked for 1280x720 px, the device grants 64x48",
        "/dev/video0: asked for 50 frames a second, the device grants 25",
    ]


def test_what_another_program_left_cut_off_or_unused_is_made_whole(clock):
    grabber, device = fake_grabber(clock, selections={0: (10, 10, 20, 20), 0x100: (0, 0, 64, 24)})
    with grabber:
        assert device.selections == {0: (0, 0, 64, 48), 0x100: (0, 0, 64, 48)}
    device.requests.clear()
    with grabber:
        assert Request.S_SELECTION not in device.requests


def test_a_device_that_knows_only_what_it_must_can_be_grabbed_from(clock):
    must = {
        Request.QUERYCAP, Request.ENUM_FMT, Request.G_FMT, Request.S_FMT, Request.REQBUFS, Request.QUERYBUF,
        Request.QBUF, Request.DQBUF, Request.STREAMON, Request.STREAMOFF,
    }  # fmt: skip
    grabber, _ = fake_grabber(clock, lacks=frozenset(set(Request) - must), inputs=[FakeInput("Camera", std=0)])
    with grabber:
        assert grabber.format.rate_hz is None
        assert grabber.controls() == ()
        assert grabber.standard is Standard.NONE
        assert grabber.detected_standard() is None
        assert grabber.timings is None
        assert grabber.detected_timings() is None
        assert grabber.grab(1.0).field is Field.PROGRESSIVE


# -- 10: one copy, into memory that nobody holds -----------------------------------------------------------------------


def test_memory_is_used_again_but_never_while_anybody_looks_at_it(clock):
    grabber, _ = started(clock)
    held = [grabber.read(1.0) for _ in range(3)]
    corner = grabber.read(1.0).pixels[:4, :4]
    copies, corner_copy = [f.pixels.copy() for f in held], corner.copy()
    places = {grabber.read(1.0).pixels.ctypes.data for _ in range(60)}
    assert len(places) == 16 - 4
    for frame, copy in zip(held, copies, strict=True):
        np.testing.assert_array_equal(frame.pixels, copy)
    np.testing.assert_array_equal(corner, corner_copy)
    grabber.close()


def test_a_holder_of_more_than_the_ring_gets_memory_of_its_own(clock):
    grabber, _ = started(clock)
    frames = [grabber.read(1.0) for _ in range(40)]
    for frame in frames:
        np.testing.assert_array_equal(frame.pixels, picture(frame.sequence))
    grabber.close()
    np.testing.assert_array_equal(frames[0].pixels, picture(0))
