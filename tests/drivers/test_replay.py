"""Recordings that are sound: every format, pace, loop and field mode gives the right picture at the right time."""

import gc
import json
import math

import cv2
import numpy as np
import pytest

from drivers.errors import DeviceTimeoutError, EndOfRecordingError
from drivers.frame import Field, PixelFormat
from drivers.grabber import FieldMode
from drivers.replay import ReplayGrabber
from tests.drivers.recorded import number_of, picture, write_folder, write_video
from tests.fakes.clock import ManualClock


def play(path, **options):
    """All frames of a recording as fast as possible."""
    with ReplayGrabber(path, speed=math.inf, clock=ManualClock(), **options) as grabber:
        grabber.start()
        return list(grabber)


# -- what it reads -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "codec", "pix_fmt", "dtype"),
    [
        ("a.mkv", "ffv1", "gray", np.uint8),
        ("a.avi", "ffv1", "gray", np.uint8),
        ("a.nut", "ffvhuff", "gray", np.uint8),
        ("a.mkv", "ffv1", "gray16le", np.uint16),
        ("a.nut", "rawvideo", "gray16be", np.uint16),
        ("a.avi", "rawvideo", "yuyv422", np.uint8),
        ("a.avi", "rawvideo", "uyvy422", np.uint8),
        ("a.nut", "rawvideo", "nv12", np.uint8),
        ("a.mkv", "ffv1", "yuv422p", np.uint8),
        ("a.mkv", "ffv1", "yuv420p10le", np.uint16),
    ],
)
def test_lossless_video_gives_the_very_luma_that_was_written(tmp_path, name, codec, pix_fmt, dtype):
    written = [picture(i, dtype=np.uint8 if pix_fmt.endswith("10le") else dtype) for i in range(6)]
    frames = play(write_video(tmp_path / name, written, codec, pix_fmt))
    assert [f.pixels.dtype for f in frames] == [dtype] * 6
    for frame, grey in zip(frames, written, strict=True):
        np.testing.assert_array_equal(frame.pixels, grey.astype(dtype))
        assert frame.defect is None


@pytest.mark.parametrize(
    ("name", "codec", "pix_fmt"),
    [("a.avi", "rawvideo", "bgr24"), ("a.mkv", "ffv1", "bgra"), ("a.mkv", "ffv1", "gbrp10le")],
)
def test_colour_video_gives_bt601_luma(tmp_path, name, codec, pix_fmt):
    rgb = np.random.default_rng(0).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    (frame,) = play(write_video(tmp_path / name, [rgb], codec, pix_fmt))
    expected = rgb @ (0.299, 0.587, 0.114)
    scale = 257 if frame.pixels.dtype == np.uint16 else 1
    np.testing.assert_allclose(frame.pixels / scale, expected, atol=1.1)


def test_a_bottom_up_video_comes_out_the_right_way_up(tmp_path):
    rgb = np.random.default_rng(0).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    path = write_video(tmp_path / "a.avi", [rgb], "rawvideo", "bgr24")
    data = bytearray(path.read_bytes())
    at = data.find(b"strf") + 16  # the height in the picture's header: its sign says which way up
    data[at : at + 4] = (-int.from_bytes(data[at : at + 4], "little", signed=True)).to_bytes(4, "little", signed=True)
    upright = play(path)[0].pixels
    path.write_bytes(data)
    np.testing.assert_array_equal(play(path)[0].pixels, upright[::-1])


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".pgm"])
def test_a_folder_of_grey_pictures_is_exact_and_in_natural_order(tmp_path, suffix):
    frames = play(write_folder(tmp_path, [picture(i) for i in range(12)], suffix))
    assert [number_of(f.pixels) for f in frames] == list(range(12))
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.pixels, picture(i))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
def test_a_folder_of_16_bit_pictures_keeps_its_depth(tmp_path, suffix):
    written = [picture(i, dtype=np.uint16) for i in range(3)]
    for frame, grey in zip(play(write_folder(tmp_path, written, suffix)), written, strict=True):
        assert frame.pixel_format is PixelFormat.MONO16
        np.testing.assert_array_equal(frame.pixels, grey)


@pytest.mark.parametrize(
    ("suffix", "dtype"), [(".png", np.uint8), (".tif", np.uint16), (".ppm", np.uint8), (".bmp", np.uint8)]
)
def test_a_folder_of_colour_pictures_gives_bt601_luma(tmp_path, suffix, dtype):
    top = np.iinfo(dtype).max
    bgr = np.random.default_rng(0).integers(0, top, (48, 64, 3)).astype(dtype)
    (frame,) = play(write_folder(tmp_path, [bgr], suffix))
    np.testing.assert_allclose(frame.pixels, bgr @ (0.114, 0.587, 0.299), atol=2)  # OpenCV's weights have 14 bit


def test_jpeg_pictures_give_their_luma(tmp_path):
    smooth = np.tile(np.linspace(20, 230, 64), (48, 1)).astype(np.uint8)
    (frame,) = play(write_folder(tmp_path, [smooth], ".jpg"))
    np.testing.assert_allclose(frame.pixels, smooth, atol=4)


def test_a_single_picture_is_a_recording_of_one_frame(tmp_path):
    write_folder(tmp_path, [picture(i) for i in range(3)])
    with ReplayGrabber(tmp_path / "2.png", clock=ManualClock()) as grabber:
        assert (grabber.frame_count, grabber.duration_s) == (1, 0.04)
        grabber.start()
        assert number_of(grabber.read(1.0).pixels) == 2
        with pytest.raises(EndOfRecordingError, match=r"2\.png"):
            grabber.read(1.0)


def test_files_of_other_kinds_in_a_folder_are_left_alone(tmp_path):
    write_folder(tmp_path, [picture(i) for i in range(2)])
    (tmp_path / "truth.json").write_text("{}")
    (tmp_path / ".3.png").write_bytes(b"a half-written copy")
    (tmp_path / "more").mkdir()
    assert len(play(tmp_path)) == 2


def test_the_end_is_no_failure_and_stays_the_end(tmp_path):
    with ReplayGrabber(write_folder(tmp_path, [picture(0)]), clock=ManualClock()) as grabber:
        grabber.start()
        grabber.read(1.0)
        for _ in range(2):
            with pytest.raises(EndOfRecordingError):
                grabber.read(1.0)


# -- pace --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("speed", "period_s"), [(1.0, 0.04), (4.0, 0.01), (0.5, 0.08)])
def test_it_keeps_its_pace_by_presentation_time(tmp_path, speed, period_s):
    clock = ManualClock()
    with ReplayGrabber(write_video(tmp_path / "a.mkv", map(picture, range(5))), speed=speed, clock=clock) as grabber:
        grabber.start()
        began_ns = clock.monotonic_ns()
        received = [(grabber.read(1.0).received_ns - began_ns) / 1e9 for _ in range(5)]
        assert received == pytest.approx([period_s * i for i in range(5)], abs=1e-6)


def test_uneven_presentation_times_are_kept(tmp_path):
    pts = [0, 1, 2, 5, 6, 12]
    frames = play(write_video(tmp_path / "a.nut", map(picture, range(6)), "ffvhuff", pts=pts))
    assert [f.timestamp_ns for f in frames] == [p * 40_000_000 for p in pts]
    assert [f.sequence for f in frames] == list(range(6))


def test_a_late_reader_gets_every_frame_late(tmp_path):
    clock = ManualClock()
    with ReplayGrabber(write_folder(tmp_path, map(picture, range(6))), rate_hz=25, clock=clock) as grabber:
        grabber.start()
        grabber.read(1.0)
        clock.advance(10.0)
        late_ns = clock.monotonic_ns()
        frames = [grabber.read(0.0) for _ in range(5)]
        assert [f.sequence for f in frames] == [1, 2, 3, 4, 5]
        assert {f.received_ns for f in frames} == {late_ns}
        assert grabber.counters.lost == 0


def test_at_most_the_timeout_is_slept_and_the_frame_comes_with_the_next_read(tmp_path):
    clock = ManualClock()
    with ReplayGrabber(write_folder(tmp_path, map(picture, range(2))), rate_hz=0.1, clock=clock) as grabber:
        grabber.start()
        grabber.read(0.0)
        for _ in range(9):
            with pytest.raises(DeviceTimeoutError, match="due in"):
                grabber.read(1.0)
        assert grabber.read(1.1).sequence == 1


def test_as_fast_as_possible_waits_for_nothing(tmp_path):
    clock = ManualClock()
    with ReplayGrabber(write_folder(tmp_path, map(picture, range(9))), speed=math.inf, clock=clock) as grabber:
        grabber.start()
        began_ns = clock.monotonic_ns()
        assert len(list(grabber)) == 9
        assert clock.monotonic_ns() == began_ns


def test_stop_pauses_and_opening_again_rewinds(tmp_path):
    clock = ManualClock()
    grabber = ReplayGrabber(write_folder(tmp_path, map(picture, range(9))), clock=clock)
    with grabber:
        grabber.start()
        assert [number_of(grabber.read(1.0).pixels) for _ in range(3)] == [0, 1, 2]
        grabber.stop()
        clock.advance(60)
        grabber.start()
        frame = grabber.read(0.0)  # the pause does not count as lateness, nor is its end waited for
        assert (number_of(frame.pixels), frame.sequence, frame.timestamp_ns) == (3, 0, 120_000_000)
        with pytest.raises(DeviceTimeoutError):
            grabber.read(0.01)
    with grabber:
        assert number_of(grabber.grab(0.0).pixels) == 0


@pytest.mark.parametrize("kind", ["folder", "video"])
def test_a_loop_begins_again_while_numbers_and_times_grow_on(tmp_path, kind):
    pictures = [picture(i) for i in range(4)]
    path = write_folder(tmp_path, pictures) if kind == "folder" else write_video(tmp_path / "a.mkv", pictures)
    with ReplayGrabber(path, loop=True, clock=ManualClock()) as grabber:
        grabber.start()
        frames = [grabber.read(1.0) for _ in range(11)]
        assert [number_of(f.pixels) for f in frames] == [0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2]
        assert [f.sequence for f in frames] == list(range(11))
        assert [f.timestamp_ns for f in frames] == [40_000_000 * i for i in range(11)]
        assert grabber.counters.lost == 0


@pytest.mark.parametrize(
    "wrong", [{"speed": 0}, {"speed": -1}, {"speed": math.nan}, {"rate_hz": 0}, {"rate_hz": math.inf}]
)
def test_an_impossible_pace_is_refused(tmp_path, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ReplayGrabber(tmp_path, **wrong)


# -- fields ------------------------------------------------------------------------------------------------------------


def test_whole_frames_are_of_unknown_field(tmp_path):
    frame = play(write_video(tmp_path / "a.mkv", [picture(0)], options={"flags": "+ildct"}))[0]
    assert frame.field is Field.UNKNOWN


def test_with_the_bottom_field_first_the_odd_rows_come_first(tmp_path):
    frames = play(write_folder(tmp_path, map(picture, range(2))), field_mode=FieldMode.ALTERNATE, top_first=False)
    assert [(f.sequence, f.field, f.timestamp_ns) for f in frames] == [
        (0, Field.BOTTOM, 0),
        (0, Field.TOP, 20_000_000),
        (1, Field.BOTTOM, 40_000_000),
        (1, Field.TOP, 60_000_000),
    ]


def test_fields_of_an_odd_number_of_rows(tmp_path):
    frames = play(write_folder(tmp_path, [picture(0, (64, 47))]), field_mode=FieldMode.ALTERNATE)
    assert [f.size_px for f in frames] == [(64, 24), (64, 23)]
    with ReplayGrabber(tmp_path, field_mode=FieldMode.BOTTOM, clock=ManualClock()) as grabber:
        assert grabber.format.height_px == 23


# -- the truth data ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("v0_WF_nominal_pan_640x480.mp4", "h264"),
        ("v2_51B_brutal_interlaced_720x480.avi", "dvvideo"),
        ("w1_Delta60_hard_speckle_640x480.avi", "mjpeg"),
    ],
)
def test_the_bowl_videos_decode_whole_and_not_black(shared, name, codec):
    path = shared / "bowl" / "videos" / name
    truth = json.loads(path.with_suffix(".json").read_text())
    with ReplayGrabber(path, speed=math.inf) as grabber:
        assert grabber.format.encoding == codec
        assert grabber.format.rate_hz == pytest.approx(truth["fps"], rel=1e-4)
        assert grabber.frame_count == truth["n_frames"]
        grabber.start()
        frames = [(f.sequence, f.pixels.mean(), f.pixels.std()) for f in grabber]
        counters = grabber.counters
    assert [f[0] for f in frames] == list(range(truth["n_frames"]))
    assert (counters.completed, counters.lost, counters.corrupt) == (truth["n_frames"], 0, 0)
    assert min(f[1] for f in frames) > 30
    assert min(f[2] for f in frames) > 20


def test_the_bowl_stills_are_read_as_opencv_reads_them(shared):
    for path in sorted((shared / "bowl" / "stills").glob("*.png"))[:6]:
        (frame,) = play(path)
        np.testing.assert_array_equal(frame.pixels, cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def test_a_long_replay_holds_on_to_none_of_its_pictures(tmp_path):
    """What goes through the decoder with a packet and the picture that comes out must not keep each other alive."""
    path = write_video(tmp_path / "a.mkv", map(picture, range(40)), "mjpeg", "yuvj420p")
    with ReplayGrabber(path, speed=math.inf, loop=True, clock=ManualClock()) as grabber:
        grabber.start()
        for _ in range(200):
            grabber.read(1.0)
        held = [o for o in gc.get_objects() if type(o).__name__ == "_Packet"]
        assert len(held) < 5
