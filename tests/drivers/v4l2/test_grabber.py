"""Formats, fields, controls, digital inputs and failures of the V4L2 grabber."""

import errno
import os

import numpy as np
import pytest

from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceProtocolError,
    DeviceStateError,
    UnsupportedFormatError,
)
from drivers.frame import Field, PixelFormat
from drivers.grabber import AcquisitionMode, FieldMode, GrabberState, SignalStatus, Standard
from drivers.v4l2.calls import LinuxCalls
from drivers.v4l2.constants import (
    BufferFlag,
    CapabilityFlag,
    ControlFlag,
    ControlId,
    ControlType,
    FieldOrder,
    StandardBits,
)
from drivers.v4l2.grabber import V4l2Grabber
from drivers.v4l2.structs import Request
from tests.drivers.tree import usb_device, video_node
from tests.fakes.clock import ManualClock
from tests.fakes.kernel import (
    PROGRESSIVE,
    WOVEN_ONLY,
    FakeDevice,
    FakeInput,
    FakeKernel,
    fake_grabber,
    picture,
    setting,
    timings,
)

CAMERA = {"inputs": [FakeInput("Camera 1", std=0)]}


@pytest.fixture
def clock():
    return ManualClock()


# -- pictures ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("encoding", "factor"),
    [
        ("GREY", 1), ("NV12", 1), ("YUYV", 1), ("UYVY", 1), ("Y10", 4), ("Y12", 16), ("Y16", 257), ("Y16-BE", 257),
    ],
)  # fmt: skip
@pytest.mark.parametrize("padding", [0, 6])
def test_the_luma_of_every_encoding_comes_back_to_the_last_bit(clock, encoding, factor, padding):
    grabber, _ = fake_grabber(clock, encodings=(encoding,), padding=padding)
    with grabber:
        frame = grabber.grab(1.0)
    np.testing.assert_array_equal(frame.pixels, picture(0).astype(np.uint16) * factor)
    assert frame.pixel_format is (PixelFormat.MONO8 if factor == 1 else PixelFormat.MONO16)


def test_of_the_encodings_an_exact_one_is_preferred_and_any_can_be_asked_for(clock):
    offered = ("H264", "MJPG", "Y16", "UYVY", "GREY")
    for asked, given in [(None, "GREY"), ("MJPG", "MJPG"), ("Y16", "Y16")]:
        grabber, _ = fake_grabber(clock, grabber={"encoding": asked}, encodings=offered)
        with grabber:
            assert grabber.format.encoding == given
            assert grabber.grab(1.0).defect is None


@pytest.mark.parametrize(
    ("asked", "offered", "words"),
    [
        ("YUYV", ("GREY", "MJPG"), "cannot give YUYV; it offers GREY, MJPG"),
        ("H264", ("GREY", "H264"), "cannot give H264; it offers GREY"),
        (None, ("H264", "RGB3"), r"it offers only what cannot be read \(H264, RGB3\)"),
    ],
)
def test_an_encoding_that_is_not_there_or_not_known_is_refused_and_nothing_stays_open(clock, asked, offered, words):
    grabber, _ = fake_grabber(clock, grabber={"encoding": asked}, encodings=offered)
    with pytest.raises(UnsupportedFormatError, match=words):
        grabber.open()
    assert grabber.state is GrabberState.CLOSED
    assert grabber._system.fds == {}


def test_a_jpeg_of_another_size_is_a_defect(clock):
    grabber, device = fake_grabber(clock, encodings=("MJPG",), fields=PROGRESSIVE, **CAMERA)
    with grabber:
        grabber.start()
        assert grabber.read(1.0).defect is None
        device.size = (32, 24)
        assert "is 32x24 px instead of 64x48" in grabber.read(1.0).defect


# -- fields ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fields", [None, WOVEN_ONLY])
@pytest.mark.parametrize(
    ("standard", "order"),
    [(StandardBits.NTSC, [Field.BOTTOM, Field.TOP]), (StandardBits.PAL, [Field.TOP, Field.BOTTOM])],
)
def test_fields_come_in_the_standards_order_each_at_its_own_time(clock, standard, order, fields):
    options = {} if fields is None else {"fields": fields}
    rate_hz = 30000 / 1001 if standard == StandardBits.NTSC else 25.0
    mode = {"field_mode": FieldMode.ALTERNATE}
    grabber, _ = fake_grabber(clock, grabber=mode, standard=int(standard), rate_hz=rate_hz, **options)
    with grabber:
        grabber.start()
        frames = [grabber.read(1.0) for _ in range(8)]
    assert [f.field for f in frames] == order * 4
    assert [f.sequence for f in frames] == [0, 0, 1, 1, 2, 2, 3, 3]
    for i, frame in enumerate(frames):
        since_ns = frame.timestamp_ns - frames[0].timestamp_ns
        assert since_ns == pytest.approx(i * 0.5e9 / rate_hz, abs=2000)
        parity = int(frame.field is Field.BOTTOM)
        np.testing.assert_array_equal(frame.pixels, picture(frame.sequence)[parity::2])


@pytest.mark.parametrize(
    ("standard", "field"),
    [(StandardBits.NTSC, Field.INTERLACED_BOTTOM_FIRST), (StandardBits.PAL, Field.INTERLACED_TOP_FIRST)],
)
@pytest.mark.parametrize("flags", [0, BufferFlag.TSTAMP_SRC_SOE])
def test_a_woven_frame_is_timed_by_its_first_field(clock, standard, field, flags):
    monotonic = BufferFlag.TIMESTAMP_MONOTONIC | flags
    grabber, _ = fake_grabber(clock, standard=int(standard), stamp_flags=int(monotonic))
    with grabber:
        assert grabber.format.field is field
        frame = grabber.grab(1.0)
    assert frame.field is field
    assert frame.received_ns - frame.timestamp_ns == (0 if flags else 20_000_000)


@pytest.mark.parametrize(
    ("order", "field"),
    [(FieldOrder.INTERLACED_TB, Field.INTERLACED_TOP_FIRST), (FieldOrder.INTERLACED_BT, Field.INTERLACED_BOTTOM_FIRST)],
)
def test_a_device_that_says_the_order_of_fields_is_believed(clock, order, field):
    grabber, device = fake_grabber(clock)
    with grabber:
        device.fields = frozenset({FieldOrder.INTERLACED, order})
        grabber.set_field_mode(FieldMode.FRAME)
        device.field = order
        assert grabber.format.field is Field.INTERLACED_TOP_FIRST
    stubborn, device = fake_grabber(clock)
    device._s_fmt = lambda fd, a, now_ns: (FakeDevice._s_fmt(device, fd, a, now_ns), setattr(a.fmt.pix, "field", order))
    with stubborn:
        assert stubborn.format.field is field


def test_a_progressive_device_has_no_fields_and_keeps_its_mode(clock):
    grabber, _ = fake_grabber(clock, fields=PROGRESSIVE, **CAMERA)
    with grabber:
        for mode in (FieldMode.ALTERNATE, FieldMode.TOP):
            with pytest.raises(UnsupportedFormatError, match="gives progressive pictures, which have no fields"):
                grabber.set_field_mode(mode)
        assert grabber.field_mode is FieldMode.FRAME
        assert grabber.grab(1.0).size_px == (64, 48)
    grabber.set_field_mode(FieldMode.ALTERNATE)
    with pytest.raises(UnsupportedFormatError, match="progressive"):
        grabber.open()


def test_a_field_that_does_not_say_which_it_is_is_a_defect(clock):
    grabber, _ = fake_grabber(clock, grabber={"field_mode": FieldMode.ALTERNATE}, faults={1: "fieldless"})
    with grabber:
        grabber.start()
        defects = [grabber.read(1.0).defect for _ in range(6)]
    words = "does not say which field it is"
    assert defects == [None, None, words, words, None, None]


def test_a_field_order_that_cannot_be_read_is_refused(clock):
    grabber, device = fake_grabber(clock, fields=frozenset({FieldOrder.INTERLACED}))
    device._s_fmt = lambda fd, a, now_ns: setattr(a.fmt.pix, "field", FieldOrder.SEQ_TB)
    with pytest.raises(UnsupportedFormatError, match="SEQ_TB"):
        grabber.open()


# -- triggers ----------------------------------------------------------------------------------------------------------


def test_a_trigger_takes_the_next_frame_and_not_one_that_waited(clock):
    grabber, _ = fake_grabber(clock)
    with grabber:
        grabber.start(AcquisitionMode.TRIGGERED)
        clock.advance(1.0)
        triggered_ns = clock.now_ns
        grabber.trigger()
        frame = grabber.read(1.0)
    assert frame.sequence == 0
    assert frame.received_ns > triggered_ns
    assert grabber.counters.lost == 0


# -- inputs and timings ------------------------------------------------------------------------------------------------


def test_inputs_of_one_name_are_told_apart(clock):
    grabber, _ = fake_grabber(clock, inputs=[FakeInput("Composite"), FakeInput("Composite"), FakeInput("", std=0)])
    with grabber:
        assert [(i.name, i.kind, len(i.standards)) for i in grabber.inputs] == [
            ("Composite", "analogue", 3),
            ("Composite (1)", "analogue", 3),
            ("input 2", "camera", 1),
        ]
        grabber.select_input("Composite (1)")
        assert grabber.input == "Composite (1)"


def test_standards_are_those_of_the_input(clock):
    grabber, device = fake_grabber(clock, inputs=[FakeInput("Video", std=int(StandardBits.PAL))])
    with grabber:
        assert grabber.inputs[0].standards == (Standard.PAL,)
        with pytest.raises(DeviceStateError, match="has no standard ntsc; it offers pal"):
            grabber.set_standard(Standard.NTSC)
        device.standard = 0x100  # PAL-M
        assert grabber.standard is Standard.PAL


def hdmi(signal):
    return {"inputs": [FakeInput("HDMI", std=0, timings=signal)], "most": (1280, 720), "fields": PROGRESSIVE}


def test_a_digital_input_is_opened_at_the_timings_of_its_signal(clock):
    grabber, _ = fake_grabber(clock, **hdmi(timings(320, 240, 50)))
    with grabber:
        assert (grabber.format.width_px, grabber.format.height_px) == (320, 240)
        assert str(grabber.timings) == "320x240p at 50 Hz"
        assert grabber.timings.like(grabber.detected_timings())
        grabber.set_timings(grabber.timings)


def test_without_a_signal_the_timings_stay(clock):
    grabber, _ = fake_grabber(clock, **hdmi(errno.ENOLINK))
    with grabber:
        assert str(grabber.timings) == "640x480p at 60 Hz"
        assert grabber.detected_timings() is None
        assert grabber.signal_status() is SignalStatus.NO_SIGNAL


def test_timings_that_the_device_does_not_take_are_told_and_not_locked_to(clock, caplog):
    grabber, device = fake_grabber(clock, **hdmi(timings(320, 240, 50)))
    device.fails = {Request.S_DV_TIMINGS: errno.EINVAL}
    with grabber:
        assert str(grabber.timings) == "640x480p at 60 Hz"
        assert grabber.signal_status() is SignalStatus.NO_LOCK
    assert "sends 320x240p at 50 Hz, which it does not take; it stays at 640x480p at 60 Hz" in caplog.text
    grabber, device = fake_grabber(clock, **hdmi(timings(320, 240, 50)))
    device.fails = {Request.S_DV_TIMINGS: errno.EIO}
    with pytest.raises(DeviceProtocolError):
        grabber.open()


def test_a_source_that_changes_its_pictures_ends_the_stream_and_is_followed_when_opened_again(clock):
    grabber, device = fake_grabber(clock, **hdmi(timings(640, 480, 60)))
    grabber.open().start()
    assert grabber.read(1.0).size_px == (640, 480)
    device.input.timings, device.input.changes = timings(320, 240, 50), 2
    with pytest.raises(DeviceProtocolError, match=r"changed from 640x480p at 60 Hz to 320x240p at 50 Hz"):
        grabber.read(1.0)
    assert grabber.source_changes == 2
    grabber.close()
    with grabber:
        assert grabber.grab(1.0).size_px == (320, 240)


@pytest.mark.parametrize("signal", [timings(640, 480, 60.1), errno.ENOLINK])
def test_a_change_that_leaves_the_pictures_as_they_are_is_only_told(clock, signal, caplog):
    grabber, device = fake_grabber(clock, **hdmi(timings(640, 480, 60)))
    with grabber:
        grabber.start()
        device.input.timings, device.input.changes = signal, 1
        assert grabber.read(1.0).sequence == 0
        assert grabber.source_changes == 1
    assert "its signal changed" in caplog.text


# -- controls ----------------------------------------------------------------------------------------------------------

EXPOSURE_MENU = {1: "Manual Mode", 3: "Aperture Priority Mode"}
CONTROLS = (
    setting(ControlId.EXPOSURE_AUTO, "Exposure, Auto", 0, 3, 1, 3, ControlType.MENU, items=EXPOSURE_MENU),
    setting(ControlId.EXPOSURE_ABSOLUTE, "Exposure (Absolute)", 3, 2047, 1, 250),
    setting(ControlId.GAIN, "Gain", 0, 100, 8, 0),
    setting(0x98F900, "Button", kind=ControlType.BUTTON, flags=ControlFlag.WRITE_ONLY),
    setting(0x98F901, "LED1 Mode / On"),
    setting(0x98F902, "LED1-mode, on"),
    setting(0x98F903, "Link Frequency", 0, 2, 1, 0, ControlType.INTEGER_MENU, items={0: 400, 2: 800}),
    setting(0x98F904, "Temperature", flags=ControlFlag.READ_ONLY),
    setting(0x98F905, "Gone", flags=ControlFlag.DISABLED),
)


@pytest.fixture
def camera(clock):
    grabber, device = fake_grabber(clock, controls=CONTROLS)
    with grabber:
        yield grabber, device


def test_controls_go_by_one_name_on_all_devices(camera):
    told = {c.name: c for c in camera[0].controls()}
    assert list(told) == [
        "gain", "led1_mode_on", "led1_mode_on_98f902", "link_frequency", "temperature",
        "auto_exposure", "exposure_time",
    ]  # fmt: skip
    assert told["exposure_time"].unit == "100 us"
    assert told["temperature"].read_only


def test_a_menu_takes_what_is_in_it(camera):
    grabber, _ = camera
    told = {c.name: c for c in grabber.controls()}
    exposure, frequency = told["auto_exposure"], told["link_frequency"]
    assert (exposure.minimum, exposure.maximum, exposure.choices) == (
        1,
        3,
        ("Manual Mode", "", "Aperture Priority Mode"),
    )
    assert frequency.choices == ("400", "", "800")
    assert grabber.set_control("auto_exposure", 1) == 1
    assert grabber.set_control("auto_exposure", 99) == 3


def test_a_value_is_set_on_the_nearest_step(camera):
    grabber, _ = camera
    assert [grabber.set_control("gain", v) for v in (5, 3.9, 100, 1e9, -1)] == [8, 0, 96, 96, 0]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("temperature", 3, "temperature = 3 cannot be set: it can only be read"),
        ("gain", float("nan"), "gain = nan cannot be set: that is no number"),
        ("exposure_time", 100, "refuses exposure_time = 100 .*is an automatic in charge"),
    ],
)
def test_a_control_that_cannot_be_set_says_why(camera, name, value, words):
    grabber, device = camera
    device.refuses_control = {ControlId.EXPOSURE_ABSOLUTE: errno.EACCES}
    with pytest.raises(DeviceStateError, match=words):
        grabber.set_control(name, value)


# -- failures ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "error", "words"),
    [
        (errno.ENOENT, DeviceNotFoundError, "there is no /dev/video0; bowlsight devices lists what there is"),
        (errno.EACCES, DevicePermissionError, "config/deploy/70-bowlsight.rules"),
        (errno.EPERM, DevicePermissionError, "may not be opened by this user"),
        (errno.EBUSY, DeviceBusyError, "is in use by another program"),
        (errno.ENODEV, DeviceDisconnectedError, "is gone"),
        (errno.EMFILE, DeviceProtocolError, r"Too many open files \(EMFILE\)"),
    ],
)
def test_a_device_that_cannot_be_opened_says_what_to_do(clock, number, error, words):
    kernel = FakeKernel(clock, {"/dev/video0": FakeDevice()})
    kernel.refusals["/dev/video0"] = number
    with pytest.raises(error, match=words) as raised:
        V4l2Grabber("/dev/video0", system=kernel, clock=clock).open()
    assert str(raised.value).startswith("/dev/video0: ")
    assert "\n" not in str(raised.value)
    assert raised.value.__cause__.errno == number


@pytest.mark.parametrize(
    ("capabilities", "words"),
    [
        (CapabilityFlag.STREAMING, "does not capture video"),
        (CapabilityFlag.VIDEO_CAPTURE_MPLANE | CapabilityFlag.STREAMING, "separate planes"),
        (CapabilityFlag.VIDEO_CAPTURE, "does not stream"),
    ],
)
def test_a_node_of_no_use_is_refused(clock, capabilities, words):
    grabber, _ = fake_grabber(clock, capabilities=capabilities)
    with pytest.raises(UnsupportedFormatError, match=words):
        grabber.open()
    assert grabber._system.fds == {}


@pytest.mark.parametrize(
    ("request_", "number", "error", "words"),
    [
        (Request.REQBUFS, errno.EBUSY, DeviceBusyError, "cannot start: it is in use"),
        (Request.REQBUFS, errno.ENOMEM, DeviceProtocolError, "cannot start"),
        (Request.QUERYBUF, errno.EINVAL, DeviceProtocolError, "cannot start"),
        (Request.QBUF, errno.EIO, DeviceProtocolError, "cannot start"),
        (Request.STREAMON, errno.ENOSPC, DeviceBusyError, "no bandwidth left"),
        (Request.STREAMON, errno.ENODEV, DeviceDisconnectedError, "is gone"),
    ],
)
def test_a_stream_that_cannot_start_leaves_nothing_behind_and_may_be_tried_again(clock, request_, number, error, words):
    grabber, device = fake_grabber(clock)
    with grabber:
        device.fails = {request_: number}
        with pytest.raises(error, match=words):
            grabber.start()
        assert grabber.state is GrabberState.OPEN
        assert all(memory.closed for memory in device.mapped)
        device.fails = {}
        assert grabber.grab(1.0).defect is None


def test_a_device_that_takes_no_buffer_back_is_a_failure(clock):
    grabber, device = fake_grabber(clock)
    with grabber:
        grabber.start()
        device.fails = {Request.QBUF: errno.EINVAL}
        with pytest.raises(DeviceProtocolError, match="EINVAL"):
            grabber.read(1.0)
        assert grabber.state is GrabberState.FAULTED
    assert all(memory.closed for memory in device.mapped)


def test_two_grabbers_cannot_stream_from_one_device(clock):
    kernel = FakeKernel(clock, {"/dev/video0": FakeDevice()})
    first, second = (V4l2Grabber("/dev/video0", system=kernel, clock=clock) for _ in range(2))
    first.open().start()
    with pytest.raises(DeviceBusyError):
        second.open()
    first.close()
    with second:
        assert second.grab(1.0).sequence == 0


def test_of_a_devices_nodes_the_first_that_captures_is_opened(clock, tmp_path):
    usb = usb_device(tmp_path, "1-2")
    for node, index in (("video3", "0"), ("video2", "1"), ("video4", "2")):
        video_node(tmp_path, node, usb / "1-2:1.0", index=index)
    metadata, capture = FakeDevice(capabilities=CapabilityFlag.STREAMING), FakeDevice()
    kernel = FakeKernel(clock, {"/dev/video3": metadata, "/dev/video2": capture, "/dev/video4": FakeDevice()})
    place = "path-pci-0000:00:14.0-usb-0:2"
    for identity, node in ((place, "/dev/video2"), (f"{place}#1", "/dev/video2"), (f"{place}#2", "/dev/video4")):
        with V4l2Grabber(identity, system=kernel, sysfs=tmp_path, clock=clock) as grabber:
            assert grabber.node == node
    with pytest.raises(UnsupportedFormatError, match="/dev/video3 does not capture video"):
        V4l2Grabber(f"{place}#0", system=kernel, sysfs=tmp_path, clock=clock).open()
    assert kernel.fds == {}


def test_two_devices_of_one_number_are_refused_by_it(clock, tmp_path):
    kernel = FakeKernel(clock, {})
    for port, node in (("1-1", "video0"), ("1-4", "video1")):
        video_node(tmp_path, node, usb_device(tmp_path, port, serial="0001") / f"{port}:1.0")
    with pytest.raises(DeviceNotFoundError, match=r"name its place: path-.*-usb-0:1 or path-.*-usb-0:4"):
        V4l2Grabber("usb-534d:2109-0001", system=kernel, sysfs=tmp_path, clock=clock).open()


@pytest.mark.parametrize("call", ["format", "format_asked", "node", "standard", "timings"])
def test_nothing_is_known_of_a_closed_device(clock, call):
    grabber, _ = fake_grabber(clock)
    with pytest.raises(DeviceStateError, match="is closed; open it first"):
        getattr(grabber, call)


# -- the real edge -----------------------------------------------------------------------------------------------------


def test_something_that_is_no_video_device_is_refused_by_the_real_kernel():
    with pytest.raises(UnsupportedFormatError, match="/dev/null is no video capture device"):
        V4l2Grabber("/dev/null").open()
    with pytest.raises(DeviceNotFoundError, match="there is no /dev/video999"):
        V4l2Grabber("/dev/video999").open()


def test_the_real_edge_waits_for_what_comes_and_not_longer():
    system = LinuxCalls()
    ours, theirs = os.pipe()
    try:
        assert system.poll(ours, 0.01) == 0
        os.write(theirs, b"x")
        assert system.poll(ours, 10.0) == 1
    finally:
        os.close(theirs)
        system.close(ours)
