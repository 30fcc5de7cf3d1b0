from dataclasses import replace

import pytest

from drivers.lens import LensState
from drivers.range_finder import RangeReading
from drivers.reading import Quality
from drivers.serial_port import LineSettings
from service.acquisition.readings import Calibration, Estimate, LensPlace, calibration_of, distance_of, focal_length_of
from service.config.instruments import LensSettings, RangeFinderModel, RangeFinderSettings

NOW_NS = 100_000_000_000
LENS = LensSettings("loop://", wide_focal_length_mm=3.3, stale_after_s=2.0, tolerance_counts=2)
FINDER = RangeFinderSettings("loop://", RangeFinderModel.DIMETIX, LineSettings(), stale_after_s=3.0, offset_mm=-20.0)
AT = LensPlace(0x1781, 5000)


def state(*, age_s=0.5, zoom=0x1781, focus=5000, executing=False, digital_zoom=False):
    return LensState(
        NOW_NS - round(age_s * 1e9), Quality.GOOD, None, zoom, focus, executing, digital_zoom, autofocus=False
    )


def bad(reason="no answer"):
    return LensState(NOW_NS, Quality.BAD, reason)


def measured(distance_mm, age_s=0.5):
    return RangeReading(NOW_NS - round(age_s * 1e9), Quality.GOOD, None, distance_mm, 1.0)


# -- distance ----------------------------------------------------------------------------------------------------------


def test_a_distance_is_counted_from_the_camera():
    good = measured(1220)
    assert distance_of(NOW_NS, good, good, FINDER) == Estimate(1200, 1.0, 0.5, Quality.GOOD, None)


@pytest.mark.parametrize(
    ("newest", "good", "quality", "words"),
    [
        (None, None, Quality.BAD, "no answer yet"),
        (RangeReading(NOW_NS, Quality.BAD, "error E255"), measured(1220), Quality.BAD, "error E255"),
        (measured(1220, 3.1), measured(1220, 3.1), Quality.STALE, "3.1 s ago"),
        (measured(15), measured(15), Quality.BAD, "behind the camera"),
    ],
)
def test_without_a_good_and_fresh_measurement_there_is_no_number(newest, good, quality, words):
    estimate = distance_of(NOW_NS, newest, good, FINDER)
    assert (estimate.value, estimate.sigma, estimate.quality) == (None, None, quality)
    assert words in estimate.reason
    assert estimate.age_s == (None if good is None else pytest.approx((NOW_NS - good.time_ns) / 1e9))


# -- focal length ------------------------------------------------------------------------------------------------------


def test_a_focal_length_follows_from_the_zoom_position():
    estimate = focal_length_of(NOW_NS, state(), state(), None, LENS)
    assert estimate == Estimate(pytest.approx(6.6), pytest.approx(0.066), 0.5, Quality.GOOD, None)


@pytest.mark.parametrize(
    ("newest", "settings", "quality", "words"),
    [
        (None, LENS, Quality.BAD, "no answer yet"),
        (bad(), LENS, Quality.BAD, "no answer"),
        (state(age_s=2.1), LENS, Quality.STALE, "2.1 s ago"),
        (state(executing=True), LENS, Quality.BAD, "moves"),
        (state(zoom=0x2000), LENS, Quality.BAD, "moves"),
        (state(digital_zoom=True), LENS, Quality.BAD, "digital zoom is on"),
        (state(zoom=0x4001), replace(LENS, tolerance_counts=0x8000), Quality.BAD, "digital zoom?"),
        (state(), replace(LENS, wide_focal_length_mm=None), Quality.BAD, "wide_focal_length_mm"),
    ],
)
def test_without_a_resting_optical_zoom_there_is_no_focal_length(newest, settings, quality, words):
    estimate = focal_length_of(NOW_NS, newest, newest, state(), settings)
    assert (estimate.value, estimate.sigma, estimate.quality) == (None, None, quality)
    assert words in estimate.reason


# -- calibration -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("last", "before", "calibrated", "standing", "words", "moving"),
    [
        (None, None, AT, Calibration.UNCONFIRMED, "no answer yet", None),
        (state(), None, AT, Calibration.CURRENT, None, False),
        (state(), state(), None, Calibration.CURRENT, None, False),
        (state(zoom=0x1783, focus=4998), None, AT, Calibration.CURRENT, None, False),
        (state(zoom=0x1784), None, AT, Calibration.STALE, "zoom stands at 6020, calibrated at 6017", False),
        (state(focus=4997), None, AT, Calibration.STALE, "focus stands at 4997", False),
        (state(focus=9), None, LensPlace(0x1781, None), Calibration.CURRENT, None, False),
        (state(executing=True), None, AT, Calibration.STALE, "moves", True),
        (state(), state(zoom=0x1700), AT, Calibration.STALE, "moves", True),
        (state(zoom=0x1700), state(zoom=0x1700), AT, Calibration.STALE, "zoom stands", False),
        (state(age_s=2.1), None, AT, Calibration.UNCONFIRMED, "2.1 s ago", None),
        (state(age_s=2.1, executing=True), None, AT, Calibration.UNCONFIRMED, "2.1 s ago", None),
        (state(age_s=99, zoom=0x1700), None, AT, Calibration.STALE, "zoom stands", None),
    ],
)
def test_a_calibration_belongs_to_where_the_lens_stood(last, before, calibrated, standing, words, moving):
    found, reason, moves = calibration_of(NOW_NS, last, before, calibrated, LENS)
    assert (found, moves) == (standing, moving)
    assert reason is None if words is None else words in reason
