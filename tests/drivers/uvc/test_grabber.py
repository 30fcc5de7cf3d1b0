"""A USB video device from user space: what it offers, what befalls it, and what is refused."""

import errno

import numpy as np
import pytest
import usb.core
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceProtocolError,
    DeviceStateError,
    DeviceTimeoutError,
    UnsupportedFormatError,
)
from drivers.grabber import AcquisitionMode, FieldMode, GrabberState
from drivers.uvc import link
from drivers.uvc.grabber import UvcGrabber
from drivers.uvc.link import reset_usb_device
from tests.fakes.clock import ManualClock
from tests.fakes.usb import FakeUsb, Plugged, fake_uvc_grabber, plug_in
from tests.fakes.uvc import FakeUvcDevice, noise

IDENTITY = "usb-1209:0001-SN1"


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def fake(clock, tmp_path):
    return lambda **options: fake_uvc_grabber(clock, tmp_path, **options)


def read(grabber, count):
    return [grabber.read(1.0) for _ in range(count)]


# -- pictures ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("encoding", "shift"), [("YUYV", 1), ("UYVY", 1), ("GREY", 1), ("NV12", 1), ("Y16", 257)])
@pytest.mark.parametrize("payload_bytes", [512, 700, 3072, 1 << 20])
def test_pictures_are_what_the_device_sent(fake, encoding, shift, payload_bytes):
    grabber, _ = fake(encodings=(encoding,), payload_bytes=payload_bytes)
    with grabber:
        grabber.start()
        for number, frame in enumerate(read(grabber, 3)):
            np.testing.assert_array_equal(frame.pixels, noise(number, 0, (64, 48)).astype(int) * shift)


def test_of_the_encodings_an_exact_one_is_taken_and_another_where_it_is_asked_for(fake):
    assert fake(encodings=("MJPG", "UYVY"))[0].open().format.encoding == "UYVY"
    assert fake(encodings=("MJPG", "UYVY"), grabber={"encoding": "MJPG"})[0].open().format.encoding == "MJPG"


def test_the_nearest_size_and_rate_are_asked_for_and_a_substitute_is_told(fake, caplog):
    grabber, _ = fake(grabber={"size_px": (30, 30), "rate_hz": 11.0})
    with grabber:
        asked, granted = grabber.format_asked, grabber.format
        assert (asked.width_px, asked.height_px, asked.rate_hz) == (30, 30, 11.0)
        assert (granted.width_px, granted.height_px, granted.rate_hz) == (32, 24, 12.5)
        assert grabber.grab(1.0).size_px == (32, 24)
    assert "asked for 30x30 px, the device grants 32x24" in caplog.text
    assert "asked for 11 frames a second, the device grants 12.5" in caplog.text


def test_a_rate_between_the_limits_is_taken_as_it_is(fake):
    grabber, _ = fake(continuous=True, grabber={"rate_hz": 20.0})
    assert grabber.open().format.rate_hz == 20.0
    grabber, _ = fake(continuous=True, grabber={"rate_hz": 500.0})
    assert grabber.open().format.rate_hz == 25.0


def test_what_the_device_grants_instead_is_what_is_read(fake, caplog):
    grabber, _ = fake(grants={"size": 2})
    assert grabber.open().format.width_px == 32
    assert "asked for 64x48 px, the device grants 32x24" in caplog.text


def test_wrong_sizes_that_it_tells_do_no_harm(fake):
    for wrong in ({"frame_bytes": 7}, {"frame_bytes": 1 << 31, "payload_bytes": 1 << 31}):
        for encoding in ("YUYV", "MJPG"):
            grabber, _ = fake(grants=wrong, grabber={"encoding": encoding})
            with grabber:
                grabber.start()
                assert [f.defect for f in read(grabber, 3)] == [None] * 3


# -- times -------------------------------------------------------------------------------------------------------------


def test_frames_are_stamped_when_they_were_captured_however_late_they_are_read(fake, clock):
    grabber, _ = fake()
    with grabber:
        start_ns = clock.now_ns
        grabber.start()
        for number in range(6):
            frame = grabber.read(1.0)
            assert frame.timestamp_ns == pytest.approx(start_ns + (number + 1) * 40e6 - 1e6, abs=100)
            assert frame.received_ns >= frame.timestamp_ns
            clock.advance(0.03 if number % 2 else 0.035)


@pytest.mark.parametrize("options", [{"clock_hz": 0}, {"header_bytes": 2}])
def test_without_times_of_its_own_a_frame_is_stamped_when_it_came(fake, options):
    grabber, _ = fake(**options)
    with grabber:
        grabber.start()
        for frame in read(grabber, 3):
            assert frame.timestamp_ns == frame.received_ns


def test_times_that_cannot_be_are_not_believed(fake):
    grabber, _ = fake(faults={2: "no_times"})
    with grabber:
        grabber.start()
        frames = read(grabber, 5)
        for frame in frames:
            assert 0 <= frame.received_ns - frame.timestamp_ns <= 1e6


def test_frames_that_a_late_reader_missed_are_suspected_by_the_times(fake, clock):
    grabber, _ = fake()
    with grabber:
        grabber.start()
        read(grabber, 12)
        clock.advance(0.4)
        read(grabber, 4)
        assert grabber.counters.lost == 0
        assert 6 <= grabber.counters.suspected <= 9


# -- faults ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("err", "the device marked it as bad"),
        ("short", "holds 3072 of 6144 bytes"),
        ("long", "holds more than 6144 bytes"),
        ("headerless", "without a proper header"),
    ],
)
def test_a_bad_frame_is_told_and_counted_and_the_next_is_good(fake, fault, words):
    grabber, _ = fake(faults={2: fault})
    with grabber:
        grabber.start()
        frames = read(grabber, 5)
        assert [f.sequence for f in frames] == list(range(5))
        assert words in frames[2].defect
        assert [f.defect for f in frames if f.sequence != 2] == [None] * 4
        assert (grabber.counters.corrupt, grabber.counters.lost) == (1, 0)


@pytest.mark.parametrize("fault", ["junk", "short", "err"])
def test_so_is_a_bad_jpeg(fake, fault):
    grabber, _ = fake(encodings=("MJPG",), faults={2: fault})
    with grabber:
        grabber.start()
        assert [f.defect is None for f in read(grabber, 4)] == [True, True, False, True]


def test_a_frame_without_picture_is_lost(fake):
    grabber, _ = fake(faults={2: "empty"})
    with grabber:
        grabber.start()
        assert [f.sequence for f in read(grabber, 3)] == [0, 1, 3]
        assert grabber.counters.lost == 1


def test_so_is_one_whose_only_payload_has_no_header(fake):
    grabber, _ = fake(faults={2: "headerless"}, payload_bytes=1 << 16)
    with grabber:
        grabber.start()
        assert [(f.sequence, f.defect) for f in read(grabber, 3)] == [(0, None), (1, None), (3, None)]
        assert grabber.counters.lost == 1


def test_a_missing_end_shows_in_the_next_frame(fake):
    grabber, _ = fake(faults={1: "no_eof", 2: "no_toggle"})
    with grabber:
        grabber.start()
        assert [(f.sequence, f.defect) for f in read(grabber, 4)] == [(n, None) for n in range(4)]


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.dictionaries(
        st.integers(1, 30),
        st.sampled_from(["err", "short", "long", "no_eof", "headerless", "empty", "no_times"]),
        max_size=12,
    ),
    st.sampled_from([512, 700, 3072]),
)
def test_whatever_goes_wrong_no_frame_is_unaccounted_for_and_none_is_silently_wrong(fake, faults, payload_bytes):
    grabber, _ = fake(faults=dict(faults), payload_bytes=payload_bytes, inputs=1)
    with grabber:
        grabber.start()
        frames = read(grabber, 25)
        last = frames[-1].sequence
        assert len(frames) + grabber.counters.lost == last + 1
        assert grabber.counters.lost == sum(1 for n, f in faults.items() if f == "empty" and n < last)
        for frame in frames:
            fault = faults.get(frame.sequence)
            assert (frame.defect is None) == (fault in (None, "no_eof", "no_times"))
            if frame.defect is None:
                np.testing.assert_array_equal(frame.pixels, noise(frame.sequence, 0, (64, 48)))


def test_a_stall_is_told_and_healed_by_opening_again(fake):
    grabber, _ = fake(events={3: "stall"})
    grabber.open().start()
    read(grabber, 3)
    with pytest.raises(DeviceProtocolError, match=r"cannot be read: .*\(EPIPE\)"):
        grabber.read(1.0)
    assert grabber.state is GrabberState.FAULTED
    grabber.close()
    assert grabber.open().grab(1.0).generation == 2
    grabber.close()


def test_a_device_that_hangs_times_out_and_a_new_start_gets_it_going(fake):
    grabber, _ = fake(events={2: "hang"})
    with grabber:
        grabber.start()
        read(grabber, 2)
        for _ in range(2):
            with pytest.raises(DeviceTimeoutError):
                grabber.read(0.2)
        grabber.stop()
        grabber.start()
        assert grabber.read(1.0).sequence == 0


def test_an_unplugged_device_is_gone_and_found_again_at_another_address(fake, tmp_path):
    grabber, plugged = fake(events={2: "gone"})
    grabber.open().start()
    read(grabber, 2)
    with pytest.raises(DeviceDisconnectedError, match="is gone"):
        grabber.read(1.0)
    grabber.close()
    assert (plugged.handles, plugged.claimed) == (0, 0)
    with pytest.raises(DeviceNotFoundError, match="libusb does not yet"):
        grabber.open()
    again = Plugged(FakeUvcDevice(), address=9)
    plug_in(tmp_path, again)
    grabber._backend.plugged.append(again)
    assert grabber.open().grab(1.0).generation == 2
    assert grabber.node == "/dev/bus/usb/001/009"
    grabber.close()


def test_stop_and_close_never_fail_although_the_device_is_gone(fake):
    grabber, plugged = fake()
    grabber.open().start()
    plugged.gone = True
    grabber.stop()
    grabber.close()
    assert grabber.state is GrabberState.CLOSED


def test_what_libusb_had_when_its_time_was_up_is_the_beginning_of_a_payload(fake, monkeypatch):
    grabber, _ = fake(payload_bytes=1 << 16)
    backend, cuts = grabber._backend, iter([1024, 512])
    whole = backend._send

    def send(handle, buff):
        part = next(cuts, None)
        if part is None:
            return whole(handle, buff)
        payload = handle.queue.popleft()
        handle.queue.appendleft(payload[part:])
        buff[:part] = type(buff)("B", payload[:part])
        backend.clock.now_ns += 1_000_000_000
        return part

    with grabber:
        grabber.start()
        monkeypatch.setattr(backend, "_send", send)
        for _ in range(2):
            with pytest.raises(DeviceTimeoutError):
                grabber.read(0.5)
        frame = grabber.read(1.0)
        np.testing.assert_array_equal(frame.pixels, noise(0, 0, (64, 48)))


def test_a_trigger_gives_what_begins_after_it(fake, clock):
    grabber, _ = fake()
    with grabber:
        grabber.start(AcquisitionMode.TRIGGERED)
        clock.advance(0.5)
        grabber.trigger()
        assert grabber.read(1.0).sequence == 0


# -- inputs ------------------------------------------------------------------------------------------------------------


def test_four_inputs_are_switched_while_streaming_and_frames_between_them_are_marked(fake):
    grabber, _ = fake()
    with grabber:
        assert [i.name for i in grabber.inputs] == [f"Composite {n}" for n in (1, 2, 3, 4)]
        grabber.start()
        read(grabber, 2)
        for channel in (2, 3, 0):
            grabber.select_input(f"Composite {channel + 1}")
            frames = read(grabber, 3)
            assert frames[0].defect == "was taken while the input was switched"
            assert frames[2].defect is None
            np.testing.assert_array_equal(frames[2].pixels, noise(frames[2].sequence, channel, (64, 48)))


def test_an_input_that_cannot_be_is_told(fake):
    grabber, plugged = fake()
    with grabber:
        plugged.device.channel = 9
        with pytest.raises(DeviceProtocolError, match="input 9 of 4"):
            _ = grabber.input


def test_fields_need_an_interlaced_device(fake):
    with pytest.raises(UnsupportedFormatError, match="progressive"):
        fake(grabber={"field_mode": FieldMode.TOP})[0].open()
    grabber, _ = fake()
    with grabber, pytest.raises(UnsupportedFormatError, match="progressive"):
        grabber.set_field_mode(FieldMode.ALTERNATE)


# -- refusals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "error_type", "words"),
    [
        ({"bulk": False}, UnsupportedFormatError, r'isochronously only.*modprobe uvcvideo.*"v4l2:usb-1209:0001-SN1"'),
        ({"encodings": ("H264",)}, UnsupportedFormatError, r"only what cannot be read \(H264 \(frame-based\)\)"),
        ({"grabber": {"encoding": "NV12"}}, UnsupportedFormatError, "cannot give NV12; it offers YUYV, MJPG"),
        ({"driver": "uvcvideo"}, DeviceBusyError, "served by the kernel's uvcvideo; set device = \"v4l2:usb-1209"),
        ({"grants": {"length": 12}}, DeviceProtocolError, "negotiates in 12 bytes"),
        ({"grants": {"format": 9}}, DeviceProtocolError, "grants format 9, size 1, which it does not offer"),
        ({"refused": {(1, 0, 1)}}, DeviceProtocolError, r"cannot agree on a picture format: .*\(EPIPE\)"),
    ],
)
def test_a_device_that_cannot_be_read_is_refused_in_one_line(fake, options, error_type, words):
    grabber, plugged = fake(**options)
    with pytest.raises(error_type, match=words) as error:
        grabber.open()
    assert "\n" not in str(error.value)
    assert grabber.state is GrabberState.CLOSED
    assert plugged.handles == 0


@pytest.mark.parametrize(
    ("where", "number", "error_type", "words"),
    [
        ("refusal", errno.EACCES, DevicePermissionError, "udev rule config/deploy/70-bowlsight.rules"),
        ("claim_refusal", errno.EBUSY, DeviceBusyError, "it is in use by"),
        ("refusal", errno.ENODEV, DeviceDisconnectedError, "is gone"),
        ("refusal", errno.EIO, DeviceProtocolError, "EIO"),
    ],
)
def test_a_device_that_cannot_be_opened_says_what_to_do(fake, where, number, error_type, words):
    grabber, plugged = fake()
    setattr(plugged, where, number)
    with pytest.raises(error_type, match=words):
        grabber.open()
    assert plugged.handles == 0


def test_a_device_that_does_not_answer_times_out(fake, monkeypatch):
    grabber, plugged = fake()

    def hang(*_):
        raise TimeoutError

    monkeypatch.setattr(plugged.device, "_class_request", hang)
    with pytest.raises(DeviceTimeoutError, match="does not answer"):
        grabber.open()
    assert plugged.handles == 0


def test_a_device_that_is_not_there_is_told_with_those_that_are(fake, clock, tmp_path):
    fake()
    with pytest.raises(DeviceNotFoundError, match=f"is not there; there is {IDENTITY}"):
        UvcGrabber("usb-1:2-3", sysfs=tmp_path, clock=clock).open()


def test_twins_are_told_apart_by_their_places(clock, tmp_path):
    twins = [Plugged(FakeUvcDevice(), address=n) for n in (4, 5)]
    for port, twin in zip(("1-2", "1-3"), twins, strict=True):
        plug_in(tmp_path, twin, port=port)
    backend = FakeUsb(clock, twins)
    with pytest.raises(DeviceNotFoundError, match=r"name its place: path-.*-usb-0:2 or path-.*-usb-0:3"):
        UvcGrabber(IDENTITY, sysfs=tmp_path, backend=backend, clock=clock).open()
    with UvcGrabber("path-pci-0000:00:14.0-usb-0:3", sysfs=tmp_path, backend=backend, clock=clock) as grabber:
        assert grabber.node == "/dev/bus/usb/001/005"


def test_without_libusb_it_is_named(fake, monkeypatch):
    def none(**_):
        raise usb.core.NoBackendError("No backend available")

    grabber, _ = fake()
    monkeypatch.setattr(link.usb.core, "find", none)
    with pytest.raises(DeviceNotFoundError, match=r"libusb is not installed \(Debian package libusb-1\.0-0\)"):
        grabber.open()


@pytest.mark.parametrize("ask", ["format", "format_asked", "node"])
def test_closed_it_has_no_format(fake, ask):
    with pytest.raises(DeviceStateError, match="is closed"):
        getattr(fake()[0], ask)


# -- reset -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("refusal", [0, errno.ENODEV, errno.ENOENT])
def test_a_reset_ends_what_streams_and_leaves_nothing_open(fake, tmp_path, refusal):
    grabber, plugged = fake(driver="uvcvideo")
    plugged.reset_refusal = refusal
    reset_usb_device(IDENTITY, "it", tmp_path, grabber._backend)
    assert (plugged.resets, plugged.handles) == (1, 0)


def test_a_reset_that_is_not_allowed_says_what_to_do(fake, tmp_path):
    grabber, plugged = fake()
    plugged.refusal = errno.EACCES
    with pytest.raises(DevicePermissionError, match=r"70-bowlsight\.rules"):
        reset_usb_device(IDENTITY, "it", tmp_path, grabber._backend)
    with pytest.raises(DeviceNotFoundError, match="is not there"):
        reset_usb_device("usb-9:9-9", "it", tmp_path, grabber._backend)


def test_a_thousand_replugs_leave_nothing_open(fake, tmp_path):
    grabber, plugged = fake(sizes=((16, 12),))
    for generation in range(1, 1001):
        grabber.open().start()
        grabber.read(1.0)
        plugged.gone = True
        with pytest.raises(DeviceDisconnectedError):
            grabber.read(1.0)
        grabber.close()
        assert (plugged.handles, plugged.claimed, grabber.generation) == (0, 0, generation)
        plugged.gone = False
