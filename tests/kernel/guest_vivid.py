"""A capture board of the kernel's own, vivid: inputs, standards, fields, encodings, controls, what the system shows."""

import grp
import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from drivers.access import Holder
from drivers.automatics import lock_automatics
from drivers.discovery import video_devices
from drivers.encodings import ENCODINGS
from drivers.errors import UnsupportedFormatError
from drivers.frame import Field
from drivers.grabber import AcquisitionMode, FieldMode, GrabberState, SignalStatus, Standard
from drivers.opening import open_grabber
from tests.kernel.conftest import VIVID

S_VIDEO = ["S-Video 0", "S-Video 1", "S-Video 2"]
NTSC_HZ = 30000 / 1001


def frames(grabber, count, timeout_s=10.0):
    return [grabber.read(timeout_s) for _ in range(count)]


# -- what the system shows ---------------------------------------------------------------------------------------------


def test_it_is_listed_with_inputs_and_formats_and_who_holds_it(vivid):
    with vivid.grabber() as grabber:
        listed = {d.identity: d for d in video_devices()}
        device = listed[VIVID]
        assert (device.node, device.driver, device.problem) == (grabber.node, "vivid", None)
        assert Holder(os.getpid(), Path("/proc/self/comm").read_text().strip()) in device.held_by
    assert [i.name for i in device.inputs] == [*S_VIDEO, "HDMI 0"]
    assert device.inputs[0].in_use
    assert device.inputs[0].signal is SignalStatus.OK
    assert {"GREY", "YUYV", "UYVY", "NV12", "Y10", "Y16"} <= {f.encoding for f in device.formats}
    assert [i for i in listed if "vivid" in i] == [VIVID], "the output node does not capture"


def test_the_udev_rule_gives_it_to_group_video_and_links_it(vivid):
    node = Path(vivid.nodes()[0])
    assert grp.getgrgid(node.stat().st_gid).gr_name == "video"
    assert node.stat().st_mode & 0o777 == 0o660
    link = Path("/dev/bowlsight/platform-vivid.0")
    assert link.resolve() == node
    with open_grabber(f"v4l2:{link}?encoding=GREY") as grabber:
        assert grabber.grab(10.0).defect is None


def test_it_opens_by_the_line_that_bowlsight_devices_prints(vivid):
    ((device,)) = [d for d in video_devices() if d.identity == VIVID]
    with open_grabber(f"{device.source}?encoding=YUYV&buffers=3") as grabber:
        assert grabber.grab(10.0).source == f"v4l2:{VIVID}?encoding=YUYV&buffers=3"


# -- streaming ---------------------------------------------------------------------------------------------------------


def test_frames_are_numbered_timed_and_sound_round_after_round(grabber):
    grabber.open()
    for _ in range(3):
        grabber.start()
        got = frames(grabber, 10)
        grabber.stop()
        numbers = [f.sequence for f in got]
        assert numbers == sorted(numbers)
        assert len(set(numbers)) + grabber.counters.lost == 10 + grabber.counters.lost
        assert all(a.timestamp_ns < b.timestamp_ns for a, b in itertools.pairwise(got))
        assert all(f.timestamp_ns <= f.received_ns for f in got), "vivid's own times lie in the future"
        assert {f.defect for f in got} == {None}
        assert {f.size_px for f in got} == {(720, 576)}
    assert grabber.state is GrabberState.OPEN


def test_a_trigger_gives_the_next_frame(grabber):
    grabber.open().start(AcquisitionMode.TRIGGERED)
    for number in range(3):
        with pytest.raises(TimeoutError):
            grabber.read(0.2)
        triggered_ns = grabber.clock.monotonic_ns()
        grabber.trigger()
        frame = grabber.read(10.0)
        assert frame.sequence == number
        assert frame.received_ns > triggered_ns


def test_a_substitute_is_told(vivid, caplog):
    with vivid.grabber(size_px=(1_000_000, 5)) as grabber:
        asked, granted = grabber.format_asked, grabber.format
        assert (asked.width_px, asked.height_px) == (1_000_000, 5)
        assert granted.width_px < 20_000
        assert grabber.grab(10.0).size_px == (granted.width_px, granted.height_px)
    assert "the device grants" in caplog.text


# -- inputs ------------------------------------------------------------------------------------------------------------


def test_four_inputs_are_switched_while_streaming(grabber):
    grabber.open().start()
    assert [(i.name, i.kind) for i in grabber.inputs] == [*((n, "analogue") for n in S_VIDEO), ("HDMI 0", "digital")]
    last = grabber.read(10.0).sequence
    for name in [*S_VIDEO[1:], "HDMI 0", *S_VIDEO, "HDMI 0"]:
        grabber.select_input(name)
        assert grabber.input == name
        assert grabber.state is GrabberState.STREAMING
        frame = grabber.read(10.0)
        assert (frame.defect, frame.size_px) == (None, (grabber.format.width_px, grabber.format.height_px))
        assert frame.size_px == ((1280, 720) if name == "HDMI 0" else (720, 576))
        assert frame.sequence > last
        last = frame.sequence
    assert grabber.generation == 1


@pytest.mark.parametrize(("mode", "status"), [(1, SignalStatus.NO_SIGNAL), (2, SignalStatus.NO_LOCK)])
def test_an_analogue_input_without_a_signal_says_so_and_still_delivers(vivid, grabber, mode, status):
    grabber.open().start()
    assert grabber.signal_status() is SignalStatus.OK
    assert grabber.detected_standard() is Standard.PAL
    vivid.set("Standard Signal Mode", mode)
    assert grabber.signal_status() is status
    assert grabber.detected_standard() is Standard.NONE
    assert grabber.read(10.0).defect is None
    grabber.select_input("S-Video 2")
    assert grabber.signal_status() is SignalStatus.OK


@pytest.mark.parametrize(
    ("mode", "status"), [(1, SignalStatus.NO_SIGNAL), (2, SignalStatus.NO_LOCK), (3, SignalStatus.NO_LOCK)]
)
def test_so_does_a_digital_one(vivid, grabber, mode, status):
    grabber.open().select_input("HDMI 0")
    assert grabber.signal_status() is SignalStatus.OK
    vivid.set("DV Timings Signal Mode", mode)
    assert grabber.signal_status() is status
    assert grabber.detected_timings() is None


# -- standards, timings, fields ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("streaming", [False, True])
def test_standards_bring_their_size_rate_and_order_of_fields(grabber, streaming):
    grabber.open()
    if streaming:
        grabber.start()
    for standard, height, rate_hz, field in [
        (Standard.NTSC, 480, NTSC_HZ, Field.INTERLACED_BOTTOM_FIRST),
        (Standard.PAL, 576, 25.0, Field.INTERLACED_TOP_FIRST),
        (Standard.SECAM, 576, 25.0, Field.INTERLACED_TOP_FIRST),
    ]:
        grabber.set_standard(standard)
        assert grabber.standard is grabber.detected_standard() is standard
        granted = grabber.format
        assert (granted.width_px, granted.height_px, granted.field) == (720, height, field)
        assert granted.rate_hz == pytest.approx(rate_hz, rel=1e-3)
        frame = grabber.read(10.0) if streaming else grabber.grab(10.0)
        assert (frame.size_px, frame.field) == ((720, height), field)


def test_a_signal_of_another_standard_than_the_one_in_use_is_told(vivid, grabber):
    grabber.open()
    vivid.set("Standard Signal Mode", 4)
    vivid.set("Standard", 0)
    assert (grabber.standard, grabber.detected_standard()) == (Standard.PAL, Standard.NTSC)
    grabber.set_standard(Standard.NTSC)
    assert grabber.grab(10.0).size_px == (720, 480)
    vivid.set("Standard Signal Mode", 5)
    assert len({grabber.detected_standard() for _ in range(16)}) >= 2, "it goes through them all"


@pytest.mark.parametrize("standard", [Standard.NTSC, Standard.PAL])
def test_single_fields_are_the_lines_of_the_woven_frame_in_the_standards_order(grabber, standard):
    first = Field.BOTTOM if standard is Standard.NTSC else Field.TOP
    grabber.open().set_standard(standard)
    woven = grabber.grab(10.0).pixels
    for mode in (FieldMode.ALTERNATE, FieldMode.TOP, FieldMode.BOTTOM):
        grabber.set_field_mode(mode)
        grabber.start()
        got = frames(grabber, 12)
        grabber.stop()
        assert {f.size_px for f in got} == {(720, woven.shape[0] // 2)}
        for f in got:  # PAL's first line carries wide-screen signalling, of which each frame has its own
            np.testing.assert_array_equal(f.pixels[1:], woven[int(f.field is Field.BOTTOM) :: 2][1:])
        assert all(a.timestamp_ns < b.timestamp_ns for a, b in itertools.pairwise(got))
        if mode is not FieldMode.ALTERNATE:
            assert {f.field for f in got} == {Field(mode.value)}
            continue
        pairs = [(a, b) for a, b in itertools.pairwise(got) if a.sequence == b.sequence]
        assert len(pairs) >= 3, "both fields of a frame have its number"
        assert {(a.field, b.field) for a, b in pairs} == {(first, Field(({"top", "bottom"} - {first}).pop()))}


def test_hdmi_is_progressive_and_has_no_fields(grabber):
    grabber.open().select_input("HDMI 0")
    assert grabber.format.field is Field.PROGRESSIVE
    with pytest.raises(UnsupportedFormatError, match="progressive"):
        grabber.set_field_mode(FieldMode.TOP)
    assert grabber.grab(10.0).field is Field.PROGRESSIVE


def test_a_digital_input_follows_its_source_when_it_is_opened(vivid, grabber):
    grabber.open().select_input("HDMI 0")
    assert str(grabber.timings) == "1280x720p at 60 Hz"
    vivid.set("DV Timings Signal Mode", 4)
    vivid.set("DV Timings", 4)
    grabber.close()
    grabber.open()
    assert str(grabber.timings) == "720x576p at 50 Hz"
    assert (grabber.format.width_px, grabber.format.height_px, grabber.format.rate_hz) == (720, 576, 50)
    assert grabber.signal_status() is SignalStatus.OK
    vivid.set("DV Timings", 3)
    grabber.close()
    grabber.open()
    assert str(grabber.detected_timings()) == "720x576i at 25 Hz"
    assert grabber.signal_status() is SignalStatus.NO_LOCK, "vivid takes no interlaced ones"


# -- encodings, controls -----------------------------------------------------------------------------------------------


def test_every_encoding_gives_the_same_picture(vivid):
    pictures = {}
    for encoding in ENCODINGS:
        if encoding not in ("MJPG", "JPEG"):
            with vivid.grabber(encoding=encoding) as grabber:
                assert grabber.format.encoding == encoding
                pictures[encoding] = grabber.grab(10.0).pixels
    grey = pictures["GREY"].astype(int)
    assert grey.std() > 20
    for encoding, shift in [("Y16", 8), ("Y16-BE", 8), ("Y12", 4), ("Y10", 2)]:
        np.testing.assert_array_equal(pictures[encoding][2:] >> shift, grey[2:])  # below wide-screen signalling
    for encoding in ("UYVY", "NV12"):
        np.testing.assert_array_equal(pictures[encoding][2:], pictures["YUYV"][2:])
    assert np.corrcoef(pictures["YUYV"].ravel(), grey.ravel())[0, 1] > 0.9


def test_controls_change_the_picture_and_read_back(vivid):
    with vivid.grabber(encoding="YUYV") as grabber:
        change_controls(grabber)


def change_controls(grabber):
    before = grabber.grab(10.0).pixels.mean()
    assert grabber.set_control("brightness", 200) == grabber.control("brightness") == 200
    assert grabber.set_control("brightness", 999) == 255
    grabber.start()
    after = frames(grabber, 3)[-1].pixels.mean()
    assert after > before + 20
    told = {c.name: c for c in grabber.controls()}
    assert (told["hue"].minimum, told["hue"].maximum, told["hue"].default) == (-128, 128, 0)
    assert told["menu"].choices[0] == "Menu Item 1"


def test_automatics_are_locked(grabber):
    grabber.open()
    assert grabber.control("auto_gain") == 1
    assert lock_automatics(grabber) == {"auto_gain": 0}
    assert grabber.set_control("gain", 77) == 77
