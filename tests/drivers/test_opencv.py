"""OpenCV as the fallback: no numbers, told so; old pictures passed over, repetitions noticed, failures in words."""

import cv2
import numpy as np
import pytest

from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceProtocolError,
    UnsupportedFormatError,
)
from drivers.grabber import AcquisitionMode, GrabberState
from drivers.opencv import OpenCvGrabber
from tests.fakes.capture import PERIOD_NS, FakeVideoCapture, picture
from tests.fakes.clock import ManualClock


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def fake(clock, tmp_path):
    """Give a grabber on a device node that is there, and its capture."""

    def make(*, grabber=None, device=None, **options):
        capture = FakeVideoCapture(clock, **options)
        (tmp_path / "video0").touch()
        node = str(tmp_path / "video0") if device is None else device
        return OpenCvGrabber(node, capture=lambda _: capture, clock=clock, **(grabber or {})), capture

    return make


def read(grabber, count):
    return [grabber.read(1.0) for _ in range(count)]


def numbers(frames):
    """Which of the camera's pictures these are."""
    known = [picture(n) for n in range(200)]
    return [next(n for n, p in enumerate(known) if np.array_equal(p, f.pixels)) for f in frames]


@pytest.mark.parametrize("grey", [False, True])
def test_frames_have_no_number_and_the_picture_in_grey(fake, grey, caplog):
    caplog.set_level("INFO")
    grabber, _ = fake(grey=grey)
    with grabber:
        grabber.start()
        frames = read(grabber, 5)
    assert numbers(frames) == [1, 2, 3, 4, 5], "the first sets it going"
    assert {f.sequence for f in frames} == {None}
    assert "no frame numbers" in caplog.text
    assert (grabber.counters.completed, grabber.counters.lost, grabber.counters.suspected) == (5, 0, 0)


def test_what_is_asked_for_is_set_and_what_is_granted_is_told(fake, caplog):
    grabber, capture = fake(grabber={"size_px": (640, 480), "encoding": "MJPG", "rate_hz": 50.0})
    granted = grabber.open().format
    assert capture.asked[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"MJPG")
    assert capture.asked[cv2.CAP_PROP_BUFFERSIZE] == 1
    assert (granted.width_px, granted.height_px, granted.rate_hz, granted.encoding) == (64, 48, 25.0, "YUYV")
    assert "asked for 640x480 px, it grants 64x48" in caplog.text


@pytest.mark.parametrize("options", [{}, {"stamped": False}, {"backend": "MSMF", "stamped": False}])
def test_after_a_pause_old_pictures_are_passed_over_and_counted(fake, clock, options):
    grabber, _ = fake(**options)
    with grabber:
        grabber.start()
        read(grabber, 3)
        clock.advance(1.0)
        before_ns = clock.now_ns
        frame = grabber.read(1.0)
        assert frame.timestamp_ns >= before_ns - 1.5 * PERIOD_NS
        assert numbers([frame])[0] >= 26
        assert grabber.counters.suspected >= 4
        assert frame.defect is None


def test_pictures_that_always_come_late_are_not_old_but_for_those_taken_before_the_start(fake):
    grabber, _ = fake(latency_ns=5 * PERIOD_NS)
    with grabber:
        grabber.start()
        assert numbers(read(grabber, 8)) == list(range(3, 11))
        assert grabber.counters.suspected == 2


@pytest.mark.parametrize(("stamped", "fault"), [(True, "repeat"), (False, "repeat"), (False, "static")])
def test_a_repetition_is_noticed(fake, stamped, fault):
    grabber, _ = fake(stamped=stamped, faults={4: fault, 5: fault})
    with grabber:
        grabber.start()
        frames = read(grabber, 6)
        assert [f.defect for f in frames] == [None] * 3 + ["repeats the picture before it"] * 2 + [None]
        assert (grabber.counters.corrupt, grabber.counters.suspected) == (2, 2)


def test_a_scene_that_does_not_change_is_no_repetition_where_its_times_do(fake):
    grabber, _ = fake(faults={3: "static"})
    with grabber:
        grabber.start()
        assert [f.defect for f in read(grabber, 5)] == [None] * 5


def test_a_trigger_gives_a_picture_taken_after_it(fake, clock):
    grabber, _ = fake()
    with grabber:
        grabber.start(AcquisitionMode.TRIGGERED)
        for _ in range(3):
            clock.advance(0.5)
            triggered_ns = clock.now_ns
            grabber.trigger()
            assert grabber.read(1.0).timestamp_ns >= triggered_ns - PERIOD_NS


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({3: "broken"}, "no picture any more"),
        ({3: "raises"}, "close it and open it again"),
        ({3: "resized"}, "32x24 px instead of 64x48"),
    ],
)
def test_a_failure_is_told_once_and_healed_by_opening_again(fake, faults, words):
    grabber, capture = fake(faults=faults)
    grabber.open().start()
    read(grabber, 2)
    with pytest.raises(DeviceProtocolError, match=words):
        grabber.read(1.0)
    assert grabber.state is GrabberState.FAULTED
    grabber.close()
    assert capture.released == 1
    capture.faults = {}
    assert grabber.open().grab(1.0).generation == 2
    grabber.close()


def test_a_picture_that_cannot_be_decoded_is_told_and_counted(fake):
    grabber, _ = fake(faults={3: "undecodable"})
    with grabber:
        grabber.start()
        frames = read(grabber, 4)
        assert [f.defect for f in frames] == [None, None, "cannot be decoded", None]
        assert not frames[2].pixels.any()
        assert grabber.counters.corrupt == 1


def test_a_device_that_gives_nothing_does_not_start(fake):
    grabber, _ = fake(faults={0: "broken"})
    with grabber:
        with pytest.raises(DeviceProtocolError, match="no picture any more"):
            grabber.start()
        assert grabber.state is GrabberState.OPEN


@pytest.mark.parametrize("fault", ["broken", "raises"])
def test_an_unplugged_device_is_gone_although_opencv_calls_it_open(fake, tmp_path, fault):
    grabber, capture = fake(faults={3: fault})
    grabber.open().start()
    read(grabber, 2)
    (tmp_path / "video0").unlink()
    assert capture.isOpened()
    with pytest.raises(DeviceDisconnectedError, match="unplugged"):
        grabber.read(1.0)
    grabber.close()
    with pytest.raises(DeviceNotFoundError, match="bowlsight devices"):
        grabber.open()


def test_a_device_that_does_not_open_says_why(fake, tmp_path, monkeypatch):
    grabber, capture = fake(opens=False)
    with pytest.raises(UnsupportedFormatError, match="may be no camera"):
        grabber.open()
    assert capture.released == 1
    with (tmp_path / "video0").open(), pytest.raises(DeviceBusyError, match=r"in use by .* \(pid \d+\)"):
        grabber.open()

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", refuse)
    with pytest.raises(DevicePermissionError, match="may not be opened by this user; it is for"):
        grabber.open()


def test_a_number_is_opencv_s_own_and_an_identity_is_looked_up(clock, tmp_path):
    asked = []

    def make(which):
        asked.append(which)
        return FakeVideoCapture(clock)

    OpenCvGrabber("7", capture=make, clock=clock).open().close()
    assert asked == [7]
    with pytest.raises(DeviceNotFoundError, match="there is no video device at all"):
        OpenCvGrabber("usb-1:2-3", capture=make, sysfs=tmp_path).open()


def test_pictures_without_a_size_are_refused(fake):
    grabber, capture = fake(size_px=(0, 0))
    with pytest.raises(DeviceProtocolError, match="0x0 px"):
        grabber.open()
    assert capture.released == 1
