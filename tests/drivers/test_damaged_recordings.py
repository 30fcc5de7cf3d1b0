"""Recordings that are not sound: an error where nothing can be read, else a counted bad frame, never a silent one."""

import errno
import math
import os
from unittest.mock import Mock

import av
import cv2
import numpy as np
import pytest

from drivers.errors import (
    DeviceDisconnectedError,
    DeviceError,
    DeviceNotFoundError,
    DevicePermissionError,
    EndOfRecordingError,
    UnsupportedFormatError,
)
from drivers.grabber import GrabberState
from drivers.replay import ReplayGrabber
from tests.drivers.recorded import SIZE, cut, number_of, overwrite, picture, write_folder, write_video
from tests.fakes.clock import ManualClock

H264 = {"codec": "libx264", "pix_fmt": "yuv420p", "options": {"g": "12", "crf": "10", "threads": "1"}}


def grabber_of(path, **options):
    return ReplayGrabber(path, speed=math.inf, clock=ManualClock(), **options)


def play(path):
    """Frames of a recording, the error that ended it, and the counters."""
    frames = []
    with grabber_of(path) as grabber:
        grabber.start()
        while True:
            try:
                frames.append(grabber.read(1.0))
            except (DeviceError, EndOfRecordingError) as error:
                return frames, error, grabber.counters


def pictures(count=60):
    return [picture(i) for i in range(count)]


def cloudy(number):
    """A picture as a camera gives it: in white noise any code is as likely as another, and no decoder finds a fault."""
    noise = np.random.default_rng(number // 5).standard_normal((240, 320 + 60))
    soft = cv2.GaussianBlur(noise, (0, 0), 4)[:, number : number + 320]
    fine = np.random.default_rng(number).standard_normal((240, 320))
    return np.clip(120 + 400 * soft + 2 * fine, 0, 255).astype(np.uint8)


# -- nothing can be read: an error at open -----------------------------------------------------------------------------


def bad_sources(folder):
    def file(name, data):
        (folder / name).write_bytes(data)
        return folder / name

    (folder / "empty").mkdir()
    (folder / "texts").mkdir()
    (folder / "texts" / "1.png").write_text("no picture")
    (folder / "texts" / "2.png").write_text("none either")
    fifo = folder / "fifo.mkv"
    os.mkfifo(fifo)
    one_png = write_folder(folder / "one", [picture(0)]) / "0.png"
    whole = write_video(folder / "whole.mkv", [picture(0)]).read_bytes()
    return {
        "absent": (folder / "absent.mp4", DeviceNotFoundError, "No such file"),
        "zero bytes": (file("zero.mp4", b""), UnsupportedFormatError, "empty"),
        "zero bytes picture": (file("zero.png", b""), UnsupportedFormatError, "empty"),
        "text called mp4": (file("text.mp4", b"hello\n" * 99), UnsupportedFormatError, "no video"),
        "text": (file("notes.txt", b"hello\n" * 99), UnsupportedFormatError, "no video"),
        "json": (file("truth.json", b'{"a": 1}' * 99), UnsupportedFormatError, "no video"),
        "noise": (file("noise.avi", np.random.default_rng(0).bytes(9000)), UnsupportedFormatError, "no video"),
        "zeros": (file("zeros.mkv", bytes(9000)), UnsupportedFormatError, "no video"),
        "header only": (file("header.mkv", whole[:600]), UnsupportedFormatError, "damaged or cut short"),
        "mp4 without its index": (
            cut(write_video(folder / "cut.mp4", pictures(), **H264), 0.6), UnsupportedFormatError, "index",
        ),
        "sound only": (write_sound(folder / "sound.mkv"), UnsupportedFormatError, "no video"),
        "text called png": (file("text.png", b"hello"), UnsupportedFormatError, "no PNG"),
        "cut png": (cut(one_png, 0.5), UnsupportedFormatError, "cut short"),
        "empty folder": (folder / "empty", DeviceNotFoundError, "no picture"),
        "folder of no pictures": (folder / "texts", UnsupportedFormatError, "none of which"),
        "pipe": (fifo, UnsupportedFormatError, "no file or folder"),
    }  # fmt: skip


def write_sound(path):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), layout="mono")
        frame.rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.fixture(scope="module")
def unreadable(tmp_path_factory):
    return bad_sources(tmp_path_factory.mktemp("unreadable"))


@pytest.mark.parametrize(
    "kind",
    [
        "absent", "zero bytes", "zero bytes picture", "text called mp4", "text", "json", "noise", "zeros",
        "header only", "mp4 without its index", "sound only", "text called png", "cut png",
        "empty folder", "folder of no pictures", "pipe",
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_at_open_in_one_line(unreadable, kind, capfd):
    path, error_type, words = unreadable[kind]
    grabber = grabber_of(path)
    with pytest.raises(error_type) as error:
        grabber.open()
    message = str(error.value)
    assert path.name in message
    assert words in message
    assert "\n" not in message
    assert grabber.state is GrabberState.CLOSED
    assert capfd.readouterr() == ("", "")  # FFmpeg keeps quiet


def test_a_file_without_rights_is_refused_by_name(tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root may read everything")
    path = write_video(tmp_path / "a.mkv", [picture(0)])
    path.chmod(0)
    with pytest.raises(DeviceError, match=r"a\.mkv: .*rights"):
        grabber_of(path).open()


def test_a_video_without_rights_is_not_called_the_wrong_file(tmp_path, monkeypatch):
    path = write_video(tmp_path / "a.mkv", [picture(0)])
    refused = av.error.PermissionError(errno.EACCES, "Permission denied", str(path))
    monkeypatch.setattr("drivers.video.av.open", Mock(side_effect=refused))
    with pytest.raises(DevicePermissionError, match=r"a\.mkv: may not be read by this user"):
        grabber_of(path).open()


def test_a_single_bad_picture_is_named_once(unreadable):
    path, error_type, _ = unreadable["text called png"]
    with pytest.raises(error_type) as error:
        grabber_of(path).open()
    assert str(error.value).count(path.name) == 1


# -- it breaks off -----------------------------------------------------------------------------------------------------

SEVERED = {
    "mkv-ffv1": ("a.mkv", {}),
    "nut-ffvhuff": ("a.nut", {"codec": "ffvhuff"}),
    "avi-mjpeg": ("a.avi", {"codec": "mjpeg", "pix_fmt": "yuvj420p"}),
    "mkv-h264": ("a.mkv", H264),
    "mp4-h264-faststart": ("a.mp4", H264 | {"mux_options": {"movflags": "faststart"}}),
    "mp4-h264-fragmented": ("a.mp4", H264 | {"mux_options": {"movflags": "frag_keyframe+empty_moov"}}),
}


@pytest.mark.parametrize("kind", SEVERED)
@pytest.mark.parametrize("share", [0.35, 0.5, 0.8])
def test_a_recording_cut_short_gives_what_is_there_and_then_says_so(tmp_path, kind, share):
    name, options = SEVERED[kind]
    path = cut(write_video(tmp_path / name, pictures(), **options), share)
    frames, end, counters = play(path)
    assert isinstance(end, DeviceDisconnectedError)
    assert f"{name}: breaks off after picture" in str(end)
    sound = [f for f in frames if f.defect is None]
    assert len(sound) > 60 * share - 15
    assert [f.sequence for f in sound] == list(range(len(sound)))
    assert [number_of(f.pixels) for f in sound] == pytest.approx(range(len(sound)), abs=1)
    assert counters.corrupt == len(frames) - len(sound) <= 12


@pytest.mark.parametrize("kind", SEVERED)
def test_the_same_recording_whole_ends_cleanly(tmp_path, kind):
    name, options = SEVERED[kind]
    frames, end, counters = play(write_video(tmp_path / name, pictures(), **options))
    assert isinstance(end, EndOfRecordingError)
    assert (counters.completed, counters.corrupt, counters.lost) == (60, 0, 0)
    assert [f.timestamp_ns for f in frames] == [40_000_000 * i for i in range(60)]


def test_after_it_broke_off_it_can_be_opened_again(tmp_path):
    grabber = grabber_of(cut(write_video(tmp_path / "a.mkv", pictures(20)), 0.5))
    for _ in range(2):
        with grabber:
            grabber.start()
            with pytest.raises(DeviceDisconnectedError):
                list(grabber)
            assert grabber.state is GrabberState.FAULTED


def test_a_loop_does_not_begin_a_broken_recording_again(tmp_path):
    with grabber_of(cut(write_video(tmp_path / "a.mkv", pictures(20)), 0.5), loop=True) as grabber:
        grabber.start()
        with pytest.raises(DeviceDisconnectedError):
            list(grabber)


def test_a_recording_that_vanishes_while_it_loops_is_a_lost_device(tmp_path):
    path = write_video(tmp_path / "a.mkv", pictures(3))
    with grabber_of(path, loop=True) as grabber:
        grabber.start()
        for _ in range(3):
            grabber.read(1.0)
        path.unlink()
        with pytest.raises(DeviceDisconnectedError, match=r"a\.mkv"):
            grabber.read(1.0)


# -- damage in the middle ----------------------------------------------------------------------------------------------

GARBLED = {
    "mkv-ffv1-intra": ("a.mkv", {"options": {"level": "3", "slicecrc": "1", "g": "1"}}, 1),
    "mkv-ffv1": ("a.mkv", {"options": {"level": "3", "slicecrc": "1", "g": "12"}}, 12),
    "mkv-mjpeg": ("a.mkv", {"codec": "mjpeg", "pix_fmt": "yuvj420p"}, 3),
    "avi-mjpeg": ("a.avi", {"codec": "mjpeg", "pix_fmt": "yuvj420p"}, 3),
    "mkv-h264": ("a.mkv", H264, 24),
    "mp4-h264": ("a.mp4", H264, 24),
    "avi-mpeg4": ("a.avi", {"codec": "mpeg4", "pix_fmt": "yuv420p", "options": {"qscale": "2"}}, 24),
}


@pytest.mark.parametrize("kind", GARBLED)
def test_garbled_bytes_cost_counted_frames_and_no_wrong_one_passes(tmp_path, kind):
    name, options, most = GARBLED[kind]
    path = write_video(tmp_path / name, [cloudy(i) for i in range(60)], **options)
    sound, _, _ = play(path)
    frames, _, counters = play(overwrite(path, 0.5, 400))
    bad = [f for f in frames if f.defect]
    assert 1 <= counters.corrupt + counters.lost <= most
    assert counters.corrupt == len(bad)
    assert frames[-1].sequence == 59
    for frame in frames:
        if frame.defect is None:
            np.testing.assert_array_equal(frame.pixels, sound[frame.sequence].pixels)
            assert frame.timestamp_ns == sound[frame.sequence].timestamp_ns


@pytest.mark.parametrize("share", [0.04, 0.5])  # before and after the recording is known to be a steady one
def test_a_hole_in_the_file_is_a_gap_in_the_numbers(tmp_path, share):
    path = write_video(tmp_path / "a.mkv", pictures(), options={"g": "1"}, mux_options={"cluster_time_limit": "100"})
    data = bytearray(path.read_bytes())
    hole = slice(int(len(data) * share), int(len(data) * (share + 0.125)))
    data[hole] = bytes(hole.stop - hole.start)
    path.write_bytes(data)
    frames, end, counters = play(path)
    assert isinstance(end, EndOfRecordingError)
    assert counters.lost >= 5
    assert counters.completed + counters.lost == 60
    for frame in frames:
        if frame.defect is None:
            np.testing.assert_array_equal(frame.pixels, picture(frame.sequence))


def test_a_packet_without_a_picture_is_a_blank_frame_with_a_defect(tmp_path):
    path = write_video(tmp_path / "a.mkv", pictures(), **H264)
    data = bytearray(path.read_bytes())
    start = len(data) // 2
    data[start : start + 2000] = bytes(2000)
    path.write_bytes(data)
    frames, _, counters = play(path)
    assert counters.completed + counters.lost == frames[-1].sequence + 1
    assert all(f.defect for f in frames if not f.pixels.any())
    assert all(abs(number_of(f.pixels) - f.sequence) <= 1 for f in frames if f.defect is None)


def test_black_frames_are_told(tmp_path):
    grey = pictures(5)
    grey[2] = np.full_like(grey[2], 16)
    frames, _, counters = play(write_video(tmp_path / "a.mkv", grey))
    assert [f.defect for f in frames] == [None, None, "flat picture: every pixel is 16", None, None]
    assert counters.corrupt == 1


def test_a_wholly_black_video_has_no_sound_frame(tmp_path):
    frames, end, counters = play(write_video(tmp_path / "a.mkv", [np.zeros((48, 64), np.uint8)] * 5))
    assert isinstance(end, EndOfRecordingError)
    assert counters.corrupt == len(frames) == 5


def test_a_picture_of_another_size_in_a_video_is_told(tmp_path):
    """Two MJPEG streams one after the other, as a recorder leaves them that was switched over."""
    raw = b"".join(
        write_video(tmp_path / f"{i}.mjpeg", [picture(0, size)] * 3, "mjpeg", "yuvj420p").read_bytes()
        for i, size in enumerate([SIZE, (32, 24), SIZE])
    )
    path = tmp_path / "joined.mjpeg"
    path.write_bytes(raw)
    frames, _, counters = play(path)
    assert [f.size_px for f in frames] == [SIZE] * 3 + [(32, 24)] * 3 + [SIZE] * 3
    assert [f.defect for f in frames] == [None] * 3 + ["is 32x24 px in a recording of 64x48 px"] * 3 + [None] * 3
    assert counters.corrupt == 3


# -- folders -----------------------------------------------------------------------------------------------------------


def test_a_broken_picture_in_a_folder_is_one_bad_frame(tmp_path):
    write_folder(tmp_path, pictures(6))
    cut(tmp_path / "2.png", 0.5)
    overwrite(tmp_path / "3.png", 0.5, 20)
    (tmp_path / "4.png").write_bytes(b"")
    frames, end, counters = play(tmp_path)
    assert isinstance(end, EndOfRecordingError)
    assert [f.sequence for f in frames] == list(range(6))
    assert [f.defect is None for f in frames] == [True, True, False, False, False, True]
    for number in (2, 3, 4):
        assert f"{number}.png" in frames[number].defect
        assert not frames[number].pixels.any()
    assert (counters.completed, counters.corrupt) == (6, 3)


def test_a_cut_jpeg_is_told_although_its_decoder_fills_it_up(tmp_path):
    write_folder(tmp_path, pictures(3), ".jpg")
    cut(tmp_path / "1.jpg", 0.6)
    frames, _, _ = play(tmp_path)
    assert [f.defect is None for f in frames] == [True, False, True]


def test_a_broken_first_picture_is_counted_too(tmp_path):
    write_folder(tmp_path, pictures(3))
    cut(tmp_path / "0.png", 0.5)
    frames, _, counters = play(tmp_path)
    assert [f.defect is None for f in frames] == [False, True, True]
    assert counters.completed == 3


@pytest.mark.parametrize(
    ("odd", "words"),
    [
        (picture(1, (32, 24)), "is 32x24 px in a recording of 64x48 px"),
        (picture(1, dtype=np.uint16), "is mono16 in a recording of mono8"),
        (np.full((48, 64), 7, np.uint8), "flat picture: every pixel is 7"),
    ],
)
def test_a_picture_that_does_not_belong_is_told(tmp_path, odd, words):
    frames, _, _ = play(write_folder(tmp_path, [picture(0), odd, picture(2)]))
    assert [f.defect for f in frames] == [None, words, None]
    np.testing.assert_array_equal(frames[1].pixels, odd)
