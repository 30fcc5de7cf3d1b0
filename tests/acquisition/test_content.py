"""Frozen, flat and signal-less pictures are told from a camera's, field by field."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.frame import Field
from drivers.grabber import SignalStatus
from service.acquisition.content import Content, PictureWatch, frozen, is_flat, is_same, no_picture
from tests.fakes.scripted import make_frame


def noise(seed=0, shape=(48, 64), dtype=np.uint8):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype)


def showing(pixels, **kwargs):
    return replace(make_frame(**kwargs), pixels=pixels)


@pytest.fixture
def watch():
    return PictureWatch(frozen_frames=3, flat_levels=4)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_one_pixel_tells_a_picture_from_another_and_from_a_flat_one(dtype):
    grey = np.full((48, 64), 100, dtype)
    spotted = grey.copy()
    spotted[47, 61] = 105
    assert is_flat(grey, 0)
    assert is_flat(spotted, 5)
    assert not is_flat(spotted, 4)
    assert is_same(grey, grey)
    assert is_same(grey, grey.copy())
    assert not is_same(grey, spotted)


def test_pictures_of_another_size_or_depth_are_others():
    grey = np.full((48, 64), 100, np.uint8)
    assert not is_same(grey, grey[::2])
    assert not is_same(grey, grey.astype(np.uint16))


def test_a_camera_s_pictures_pass_unchanged(watch):
    frames = [showing(noise(i), sequence=i) for i in range(10)]
    assert [watch.look(f) for f in frames] == frames
    assert watch.reason() is None


def test_the_third_same_picture_is_bad_and_the_first_other_one_good(watch):
    looked = [watch.look(showing(noise(0), sequence=i, received_ns=100 + i)).defect for i in range(4)]
    assert looked == [None, None, "the picture is frozen: the same byte for byte", looked[2]]
    assert watch.content.same_since_ns == 100
    assert watch.look(showing(noise(1))).defect is None


def test_the_third_flat_picture_is_bad_however_grey(watch):
    looked = [watch.look(showing(np.full((48, 64), 10 * i, np.uint8))).defect for i in range(4)]
    assert [bool(d) for d in looked] == [False, False, True, True]
    assert "even grey" in looked[2]


def test_a_flat_and_frozen_picture_is_called_one_without_signal(watch):
    for _ in range(3):
        frame = watch.look(showing(np.zeros((48, 64), np.uint8)))
    assert "even grey" in frame.defect


def test_fields_are_compared_with_their_own_kind(watch):
    top, bottom = noise(0), noise(1)
    for _ in range(2):
        assert watch.look(showing(top, field=Field.TOP)).defect is None
        assert watch.look(showing(bottom, field=Field.BOTTOM)).defect is None
    assert "frozen" in watch.look(showing(top, field=Field.TOP)).defect


@pytest.mark.parametrize("signal", [SignalStatus.NO_SIGNAL, SignalStatus.NO_LOCK])
def test_a_device_that_says_it_has_no_signal_is_believed_at_once(watch, signal):
    watch.signalled(signal)
    assert "signal" in watch.look(showing(noise())).defect
    watch.signalled(SignalStatus.OK)
    assert watch.look(showing(noise(1))).defect is None


def test_a_defect_that_the_device_told_is_kept(watch):
    watch.signalled(SignalStatus.NO_SIGNAL)
    assert watch.look(showing(noise(), defect="torn")).defect == "torn"


def test_a_new_stream_begins_with_nothing_known(watch):
    for _ in range(3):
        watch.look(showing(noise()))
    watch.restart()
    assert watch.content == Content()
    assert watch.look(showing(noise())).defect is None


def test_reasons_are_given_from_the_number_asked_for_on():
    assert frozen(Content(same=2), 3) is None
    assert frozen(Content(same=3), 3)
    assert no_picture(Content(flat=2), 3) is None
    assert no_picture(Content(flat=3), 3)
