"""What every grabber must do, whatever it is."""

import itertools
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import DeviceStateError, DeviceTimeoutError
from drivers.frame import Field, PixelFormat
from drivers.grabber import AcquisitionMode, FieldMode, GrabberState, Standard
from drivers.opencv import OpenCvGrabber
from drivers.replay import ReplayGrabber
from drivers.scene import CLEAN, GENERATORS
from drivers.simulated import SimulatedGrabber
from drivers.simulation import default_scene
from tests.drivers.recorded import picture, write_folder, write_video
from tests.fakes.capture import FakeVideoCapture
from tests.fakes.clock import ManualClock
from tests.fakes.kernel import WOVEN_ONLY, fake_grabber
from tests.fakes.usb import fake_uvc_grabber


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    write_video(folder / "video.mkv", (picture(i) for i in range(30)))
    write_video(folder / "deep.nut", (picture(i, dtype=np.uint16) for i in range(30)), pix_fmt="gray16le")
    write_folder(folder / "pictures", (picture(i) for i in range(30)))
    return folder


@pytest.fixture(scope="module")
def scenes():
    def scene(**options):
        return default_scene(
            GENERATORS["model-f"], np.random.default_rng(1), size_px=(64, 48), frames=7, look=CLEAN, **options
        )

    return {"plain": scene(), "interlaced": scene(interlaced=True), "deep": scene(bits=16)}


@dataclass
class Device:
    """A grabber under test, and what of the contract applies to it."""

    make: object
    paced: bool = True
    numbered: bool = True

    def numbers(self, *expected: int) -> list[int | None]:
        return [n if self.numbered else None for n in expected]


def devices(recordings, scenes):
    def replay(name, **options):
        return Device(lambda: ReplayGrabber(recordings / name, clock=ManualClock(), **options), "speed" not in options)

    def simulated(scene, **options):
        return Device(
            lambda: SimulatedGrabber(scenes[scene], loop_frames=8, clock=ManualClock(), **options),
            "speed" not in options,
        )

    def v4l2(**options):
        return Device(lambda: fake_grabber(ManualClock(), **options)[0])

    def uvc(**options):
        sysfs = recordings / "-".join(("sys", *map(str, options.values()))).replace("/", "")
        return Device(lambda: fake_uvc_grabber(ManualClock(), sysfs, interlace=5, **options)[0])

    def opencv(**options):
        def make():
            clock = ManualClock()
            return OpenCvGrabber("0", capture=lambda _: FakeVideoCapture(clock, **options), clock=clock)

        return Device(make, numbered=False)

    return {
        "video": replay("video.mkv"),
        "video-at-max": replay("video.mkv", speed=float("inf")),
        "video-looped": replay("video.mkv", loop=True),
        "video-16-bit": replay("deep.nut"),
        "folder": replay("pictures"),
        "picture-looped": replay("pictures/3.png", loop=True),
        "simulated": simulated("plain"),
        "simulated-at-max": simulated("plain", speed=float("inf")),
        "simulated-interlaced": simulated("interlaced"),
        "simulated-16-bit": simulated("deep"),
        "v4l2": v4l2(),
        "v4l2-without-fields": v4l2(fields=WOVEN_ONLY, padding=6),
        "v4l2-yuyv": v4l2(encodings=("RGB3", "YUYV"), padding=4),
        "v4l2-nv12": v4l2(encodings=("NV12",)),
        "v4l2-10-bit": v4l2(encodings=("Y10",)),
        "v4l2-16-bit": v4l2(encodings=("Y16-BE",), padding=2),
        "v4l2-jpeg": v4l2(encodings=("MJPG",), fields=WOVEN_ONLY),
        "uvc": uvc(),
        "uvc-grey": uvc(encodings=("H264", "GREY"), inputs=1, payload_bytes=1024),
        "uvc-nv12": uvc(encodings=("NV12",), version=0x0150, header_bytes=2),
        "uvc-16-bit": uvc(encodings=("Y16",), alternate=2, payload_bytes=700),
        "opencv": opencv(),
        "opencv-without-times": opencv(stamped=False),
        "uvc-jpeg": uvc(encodings=("MJPG",), version=0x0100, serial=None),
    }


NAMES = list(devices(Path(), {"plain": None, "interlaced": None, "deep": None}))


@pytest.fixture(params=NAMES)
def device(request, recordings, scenes) -> Device:
    return devices(recordings, scenes)[request.param]


@pytest.fixture
def grabber(device):
    made = device.make()
    yield made
    made.close()


# -- lifecycle ---------------------------------------------------------------------------------------------------------


def test_it_goes_through_its_states_and_back(grabber):
    assert grabber.state is GrabberState.CLOSED
    assert grabber.open() is grabber
    assert grabber.state is GrabberState.OPEN
    assert grabber.start() is grabber
    assert grabber.state is GrabberState.STREAMING
    grabber.stop()
    assert grabber.state is GrabberState.OPEN
    grabber.close()
    assert grabber.state is GrabberState.CLOSED


def test_stop_and_close_may_be_repeated_and_close_comes_from_any_state(grabber):
    grabber.stop()
    grabber.close()
    grabber.open()
    grabber.stop()
    grabber.start()
    grabber.read(1.0)
    grabber.close()
    grabber.close()
    assert grabber.state is GrabberState.CLOSED


@pytest.mark.parametrize("call", ["open", "start", "read", "trigger", "grab"])
def test_a_call_that_does_not_fit_the_state_is_refused_and_changes_nothing(grabber, call):
    calls = {
        "open": grabber.open,
        "start": grabber.start,
        "read": lambda: grabber.read(0.0),
        "trigger": grabber.trigger,
        "grab": lambda: grabber.grab(0.0),
    }
    fits = {GrabberState.CLOSED: {"open"}, GrabberState.OPEN: {"start", "grab"}, GrabberState.STREAMING: {"read"}}
    for state, step in [
        (GrabberState.CLOSED, grabber.open),
        (GrabberState.OPEN, grabber.start),
        (GrabberState.STREAMING, grabber.close),
    ]:
        if call not in fits[state]:
            with pytest.raises(DeviceStateError) as error:
                calls[call]()
            assert grabber.name in str(error.value)
        assert grabber.state is state
        step()


def test_the_context_manager_closes_although_an_error_passes(grabber):
    with pytest.raises(DeviceStateError), grabber:
        grabber.start().start()
    assert grabber.state is GrabberState.CLOSED


def test_generation_grows_with_each_opening_and_marks_the_frames(grabber):
    for generation in (1, 2, 3):
        with grabber:
            assert grabber.generation == generation
            assert grabber.grab(1.0).generation == generation


def test_it_can_be_stopped_and_started_again(device, grabber):
    grabber.open()
    for _ in range(3):
        grabber.start()
        assert [grabber.read(1.0).sequence for _ in range(2)] == device.numbers(0, 1)
        grabber.stop()


def test_nothing_is_left_open_or_running_after_many_rounds(grabber):
    def left():
        descriptors = Path("/proc/self/fd")
        return len(list(descriptors.iterdir())) if descriptors.exists() else 0, threading.active_count()

    def round_():
        with grabber:
            grabber.start()
            grabber.read(1.0)

    round_()
    before = left()
    for _ in range(10):
        round_()
    assert left() == before


# -- frames ------------------------------------------------------------------------------------------------------------


def test_frames_are_what_the_format_says(grabber):
    with grabber:
        granted = grabber.format
        grabber.start()
        for frame in (grabber.read(1.0) for _ in range(5)):
            assert frame.size_px == (granted.width_px, granted.height_px)
            assert frame.pixel_format is granted.pixel_format
            assert frame.pixels.dtype == (np.uint8 if frame.pixel_format is PixelFormat.MONO8 else np.uint16)
            assert frame.field is granted.field
            assert (frame.source, frame.generation, frame.defect) == (grabber.name, 1, None)


def test_pixels_are_read_only_and_a_later_read_leaves_them_alone(grabber):
    with grabber:
        grabber.start()
        frames = [grabber.read(1.0) for _ in range(3)]
        copies = [f.pixels.copy() for f in frames]
        for _ in range(8):
            grabber.read(1.0)
        for frame, copy in zip(frames, copies, strict=True):
            assert frame.pixels.flags.c_contiguous
            np.testing.assert_array_equal(frame.pixels, copy)
            with pytest.raises(ValueError, match="read-only"):
                frame.pixels[0, 0] = 1


def test_numbers_grow_by_one_and_times_only_grow(device, grabber):
    with grabber:
        grabber.start()
        frames = [grabber.read(1.0) for _ in range(20)]
        assert [f.sequence for f in frames] == device.numbers(*range(20))
        times = [f.timestamp_ns for f in frames]
        assert all(a < b for a, b in itertools.pairwise(times))
        received = [f.received_ns for f in frames]
        assert received == sorted(received)
        assert received[-1] <= grabber.clock.monotonic_ns()


def test_counters_count_from_open_on(grabber):
    for _ in range(2):
        with grabber:
            grabber.start()
            for _ in range(4):
                grabber.read(1.0)
            grabber.stop()
            grabber.start()
            grabber.read(1.0)
            assert (grabber.counters.completed, grabber.counters.lost, grabber.counters.corrupt) == (5, 0, 0)


def test_grab_takes_one_frame_and_leaves_the_device_open(device, grabber):
    with grabber:
        for _ in range(3):
            assert [grabber.grab(1.0).sequence] == device.numbers(0)
            assert grabber.state is GrabberState.OPEN


def test_single_mode_gives_one_frame_only(grabber):
    with grabber:
        grabber.start(AcquisitionMode.SINGLE)
        grabber.read(1.0)
        with pytest.raises(DeviceTimeoutError):
            grabber.read(1.0)


def test_triggered_mode_gives_one_frame_for_each_trigger(device, grabber):
    with grabber:
        grabber.start(AcquisitionMode.TRIGGERED)
        with pytest.raises(DeviceTimeoutError):
            grabber.read(0.5)
        for sequence in range(3):
            grabber.trigger()
            assert [grabber.read(1.0).sequence] == device.numbers(sequence)
            with pytest.raises(DeviceTimeoutError):
                grabber.read(0.5)
        grabber.trigger()
        grabber.trigger()
        assert [grabber.read(1.0).sequence for _ in range(2)] == device.numbers(3, 4)


def test_only_triggered_mode_can_be_triggered(device, grabber):
    with grabber:
        grabber.start()
        with pytest.raises(DeviceStateError, match="triggered mode"):
            grabber.trigger()
        assert [grabber.read(1.0).sequence] == device.numbers(0)


def test_a_timeout_waits_no_longer_than_told_and_loses_nothing(device, grabber):
    if not device.paced:
        pytest.skip("as fast as it is read, nothing is waited for")
    with grabber:
        grabber.start()
        first = grabber.read(1.0)
        before_ns = grabber.clock.monotonic_ns()
        for _ in range(3):
            with pytest.raises(TimeoutError) as error:
                grabber.read(0.01)
            assert isinstance(error.value, DeviceTimeoutError)
            assert grabber.name in str(error.value)
        assert grabber.clock.monotonic_ns() - before_ns == pytest.approx(30e6, abs=10)
        assert grabber.counters.timeouts == 3
        assert grabber.state is GrabberState.STREAMING
        following = grabber.read(1.0)
        assert [first.sequence, following.sequence] == device.numbers(0, 1)
        assert following.timestamp_ns - first.timestamp_ns == pytest.approx(40e6, rel=0.03)


def test_iterating_gives_frames_until_it_is_stopped(device, grabber):
    with grabber:
        grabber.start()
        seen = []
        for frame in grabber:
            seen.append(frame.sequence)
            if len(seen) == 5:
                grabber.stop()
        assert seen == device.numbers(*range(5))


# -- inputs, standard, fields, controls --------------------------------------------------------------------------------


def test_the_input_in_use_is_one_of_the_inputs_and_others_are_refused_by_name(grabber):
    with grabber:
        names = [i.name for i in grabber.inputs]
        assert len(set(names)) == len(names) >= 1
        for name in names:
            grabber.select_input(name)
            assert grabber.input == name
            grabber.signal_status()
        with pytest.raises(DeviceStateError, match="CH99"):
            grabber.select_input("CH99")
        assert grabber.input == names[-1]


def test_standards_on_offer_read_back_and_others_are_refused_by_name(grabber):
    with grabber:
        offered = {s for i in grabber.inputs for s in i.standards}
        for standard in offered:
            grabber.set_standard(standard)
            assert grabber.standard is standard
        for standard in set(Standard) - offered:
            with pytest.raises(DeviceStateError, match=str(standard)):
                grabber.set_standard(standard)


def test_controls_keep_to_their_range_and_read_back(grabber):
    with grabber:
        for control in grabber.controls():
            assert grabber.control(control.name) == control.default
            for asked, taken in [
                (control.minimum, control.minimum),
                (control.maximum + 1000, control.maximum),
                (control.minimum - 1000, control.minimum),
                (control.default, control.default),
            ]:
                assert grabber.set_control(control.name, asked) == taken == grabber.control(control.name)
        for call in (lambda: grabber.control("warp"), lambda: grabber.set_control("warp", 1)):
            with pytest.raises(DeviceStateError, match="warp"):
                call()


@pytest.mark.parametrize("mode", [FieldMode.ALTERNATE, FieldMode.TOP, FieldMode.BOTTOM])
def test_fields_are_the_rows_of_the_frames_at_their_own_times(device, mode):
    with device.make() as whole:
        whole.start()
        frames = [whole.read(1.0) for _ in range(3)]
    grabber = device.make()
    with grabber:
        grabber.set_field_mode(mode)
        assert grabber.field_mode is mode
        granted = grabber.format
        grabber.start()
        with pytest.raises(DeviceStateError):
            grabber.set_field_mode(FieldMode.FRAME)
        fields = [grabber.read(1.0) for _ in range(6 if mode is FieldMode.ALTERNATE else 3)]
    expected = [Field.TOP, Field.BOTTOM] * 3 if mode is FieldMode.ALTERNATE else [Field(mode.value)] * 3
    assert [f.field for f in fields] == expected
    assert granted.height_px == fields[0].size_px[1]
    start_ns = fields[0].timestamp_ns - (20e6 if mode is FieldMode.BOTTOM else 0)
    for place, field in enumerate(fields):
        parity, number = int(field.field is Field.BOTTOM), place // (2 if mode is FieldMode.ALTERNATE else 1)
        assert [field.sequence] == device.numbers(number)
        np.testing.assert_array_equal(field.pixels, frames[number].pixels[parity::2])
        assert field.timestamp_ns - start_ns == pytest.approx(40e6 * number + 20e6 * parity, abs=1e6)
        assert field.pixels.flags.c_contiguous
        assert not field.pixels.flags.writeable
    assert grabber.counters.lost == 0
