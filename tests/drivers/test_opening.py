"""A source's name leads to its grabber, or to one line that says what is wrong with it."""

import math

import numpy as np
import pytest

from drivers.errors import ConfigError, DeviceNotFoundError, UnsupportedFormatError
from drivers.frame import PixelFormat
from drivers.grabber import FieldMode, GrabberState
from drivers.opencv import OpenCvGrabber
from drivers.opening import bus_reset, open_grabber
from drivers.replay import ReplayGrabber
from drivers.simulated import SimulatedGrabber
from drivers.uvc.grabber import UvcGrabber
from drivers.v4l2.formats import Wish
from drivers.v4l2.grabber import V4l2Grabber
from tests.drivers.recorded import picture, write_folder, write_video
from tests.fakes.clock import ManualClock


def test_a_path_is_played(tmp_path):
    write_video(tmp_path / "a.mkv", [picture(i) for i in range(3)])
    write_folder(tmp_path / "pictures", [picture(i) for i in range(3)])
    for source in (tmp_path / "a.mkv", tmp_path / "pictures", tmp_path / "pictures" / "1.png"):
        grabber = open_grabber(str(source), speed=math.inf, rate_hz=50, clock=ManualClock())
        assert isinstance(grabber, ReplayGrabber)
        assert grabber.state is GrabberState.CLOSED
        with grabber:
            assert grabber.grab(1.0).source == str(source)


def test_options_reach_the_recording(tmp_path):
    folder = write_folder(tmp_path, [picture(i) for i in range(2)])
    with open_grabber(
        str(folder), speed=math.inf, loop=True, rate_hz=10, field_mode=FieldMode.ALTERNATE, top_first=False
    ) as grabber:
        grabber.start()
        frames = [grabber.read(1.0) for _ in range(6)]
    assert [(f.field, f.timestamp_ns) for f in frames[:2]] == [("bottom", 0), ("top", 50_000_000)]
    assert frames[5].sequence == 2


def test_a_colon_in_a_file_s_name_is_no_scheme(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "tape:1.mkv", [picture(0)])
    with open_grabber("tape:1.mkv") as grabber:
        assert grabber.frame_count == 1


def test_simulated_values_are_in_its_name():
    source = (
        "simulated:delta60?seed=4&size=160x120&rate_hz=60&bits=16&interlaced=yes&look=hard&loop_frames=3&pitch_px=30"
    )
    with open_grabber(source, clock=ManualClock()) as grabber:
        assert isinstance(grabber, SimulatedGrabber)
        assert grabber.scene.sheet.lattice.model == "W_Delta60"
        granted = grabber.format
        assert (granted.width_px, granted.height_px, granted.rate_hz) == (160, 120, 60)
        assert granted.pixel_format is PixelFormat.MONO16
        assert grabber.scene.interlaced
        assert grabber.grab(1.0).source == source


@pytest.mark.parametrize("source", ["v4l2:usb-534d:2109-A%2F1", "v4l2:path-platform-vivid.0#1", "/dev/video0"])
def test_a_capture_device_is_named_by_identity_or_node_with_its_values(source):
    asked = f"{source}?size=720x576&encoding=YUYV&rate_hz=25&fields=alternate&buffers=4&newest=yes"
    grabber = open_grabber(asked)
    assert isinstance(grabber, V4l2Grabber)
    assert grabber.name == asked
    assert grabber.state is GrabberState.CLOSED
    assert grabber._wish == Wish((720, 576), "YUYV", 25, FieldMode.ALTERNATE)
    assert grabber._device == source.removeprefix("v4l2:")
    assert open_grabber(source, field_mode=FieldMode.TOP).field_mode is FieldMode.TOP


@pytest.mark.parametrize(
    ("source", "kind"),
    [
        ("uvc:usb-1209:0001-SN1", UvcGrabber),
        ("uvc:path-pci-0000:00:14.0-usb-0:2", UvcGrabber),
        ("opencv:usb-534d:2109-A1", OpenCvGrabber),
        ("opencv:/dev/video7", OpenCvGrabber),
        ("opencv:0", OpenCvGrabber),
    ],
)
def test_so_is_one_that_is_read_over_usb_or_through_opencv(source, kind):
    grabber = open_grabber(f"{source}?size=720x576&encoding=MJPG&rate_hz=25&fields=alternate")
    assert isinstance(grabber, kind)
    assert grabber.state is GrabberState.CLOSED
    assert grabber.field_mode is FieldMode.ALTERNATE
    assert grabber._device == source.partition(":")[2]


def test_a_node_is_taken_with_a_hint_at_a_name_that_lasts(caplog):
    open_grabber("v4l2:/dev/video3")
    open_grabber("v4l2:usb-1:2-3")
    ((record),) = caplog.records
    assert record.message.startswith("/dev/video3 may be another device after a replug")


def test_the_usual_simulation_is_the_same_each_time():
    first, second = (
        open_grabber("simulated?size=64x48&loop_frames=2", clock=ManualClock()).open().grab(1.0) for _ in range(2)
    )
    np.testing.assert_array_equal(first.pixels, second.pixels)


@pytest.mark.parametrize(
    ("source", "error_type", "words"),
    [
        ("v4l2:", ConfigError, "no device has such a name; bowlsight devices lists"),
        ("v4l2:1234:5678", ConfigError, "no device has such a name"),
        ("v4l2:usb-1:2-3?size=big", ConfigError, "size = 'big': must be like 640x480"),
        ("v4l2:usb-1:2-3?encoding=H264", ConfigError, "encoding = 'H264': must be one of GREY, NV12, YUYV"),
        ("v4l2:usb-1:2-3?fields=both", ConfigError, "must be one of frame, alternate, top, bottom"),
        ("v4l2:usb-1:2-3?buffers=1", ConfigError, "a whole number from 2 to 32"),
        ("v4l2:usb-1:2-3?rate=25", ConfigError, "did you mean rate_hz"),
        ("/dev/video0?newest=maybe", ConfigError, "must be yes or no"),
        ("uvc:/dev/video0", ConfigError, "no device has such a name"),
        ("uvc:usb-1:2-3?buffers=4", ConfigError, "known: size, encoding, rate_hz, fields"),
        ("opencv:webcam", ConfigError, "no device has such a name"),
        ("opencv:0?newest=yes", ConfigError, "unknown key 'newest'"),
        ("webcam:/dev/video0", DeviceNotFoundError, "webcam: is no kind of source; give a video"),
        ("usb:1234:5678", DeviceNotFoundError, "usb: is no kind of source"),
        ("http://host/video.mp4", DeviceNotFoundError, "http: is no kind of source"),
        ("simulated:sistem80", ConfigError, "did you mean system80"),
        ("simulated?sed=3", ConfigError, "did you mean seed"),
        ("simulated?seed=x", ConfigError, "seed = 'x': must be a whole number"),
        ("simulated?seed=-1", ConfigError, "seed = '-1'"),
        ("simulated?size=640", ConfigError, "must be like 640x480"),
        ("simulated?rate_hz=0", ConfigError, "rate_hz = '0': must be a number above 0"),
        ("simulated?rate_hz=nan", ConfigError, "rate_hz = 'nan'"),
        ("simulated?bits=12", ConfigError, "bits = '12': must be 8 or 16"),
        ("simulated?interlaced=1", ConfigError, "must be yes or no"),
        ("simulated?look=nice", ConfigError, "known: clean, nominal, hard"),
        ("simulated?loop_frames=0", ConfigError, "loop_frames = '0'"),
        ("simulated?seed=", ConfigError, "seed = ''"),
    ],
)
def test_a_wrong_source_is_refused_in_one_line(source, error_type, words):
    with pytest.raises(error_type) as error:
        open_grabber(source)
    assert str(error.value).startswith(source)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("scheme", ["v4l2", "uvc", "opencv"])
def test_a_usb_device_can_be_reset_by_the_name_of_its_source(scheme, tmp_path):
    for device in ("usb-1209:0001-SN1", "path-pci-0000:00:14.0-usb-0:2"):
        reset = bus_reset(f"{scheme}:{device}?size=640x480", tmp_path)
        with pytest.raises(DeviceNotFoundError, match=rf"^{scheme}:{device}\?size=640x480: is not there"):
            reset()


@pytest.mark.parametrize("source", ["simulated", "/dev/video0", "a.mkv", "v4l2:path-platform-vivid.0", "opencv:0"])
def test_what_is_no_usb_device_cannot_be_reset(source):
    assert bus_reset(source) is None


@pytest.mark.parametrize(
    ("source", "error_type"), [("no such file.mp4", DeviceNotFoundError), ("/dev/null", UnsupportedFormatError)]
)
def test_a_path_that_is_no_recording_is_refused_when_it_is_opened(source, error_type):
    with pytest.raises(error_type, match=source):
        open_grabber(source).open()
