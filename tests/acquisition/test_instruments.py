import time

import pytest

from drivers.range_finder import AcuityRangeFinder, DimetixRangeFinder
from drivers.reading import Quality
from drivers.serial_port import LineSettings
from service.acquisition.instruments import Instruments, open_range_finder
from service.acquisition.readings import Calibration, InstrumentReadings
from service.config.instruments import LensSettings, RangeFinderModel, RangeFinderSettings
from tests.fakes.clock import HurriedClock
from tests.fakes.scripted import PATIENCE_S
from tests.fakes.serial_devices import FakeCamera, FakeRangeFinder, PtyLine, SocketLine


def until(instruments, condition):
    """Readings that meet a condition, waited for with patience."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition(readings := instruments.readings()):
        assert time.monotonic() < deadline, readings
        time.sleep(0.01)
    return readings


def lens_at(port, **values):
    return LensSettings(port, rate_hz=50.0, stale_after_s=600.0, wide_focal_length_mm=3.3, **values)


def finder_at(port, **values):
    return RangeFinderSettings(
        port, RangeFinderModel.DIMETIX, LineSettings(), rate_hz=50.0, stale_after_s=600.0, **values
    )


def test_a_station_without_instruments_says_so():
    with Instruments(None, None) as instruments:
        assert instruments.readings() == InstrumentReadings()
        assert not instruments.mark_calibrated()
    assert instruments.readings().calibration is Calibration.WITHOUT_LENS


def test_lens_and_range_finder_are_read_side_by_side(tmp_path):
    camera = FakeCamera(zoom=0x1781)
    with (
        PtyLine(tmp_path, camera, "camera") as lens,
        SocketLine(FakeRangeFinder(b"g0g+00012345\r\n")) as finder,
        Instruments(lens_at(lens.path), finder_at(finder.path, sigma_mm=0.8, offset_mm=10.0)) as instruments,
    ):
        both = until(instruments, lambda r: r.distance_mm and r.focal_length_mm)
    assert (both.distance_mm, both.distance_sigma_mm, both.distance_quality) == (1244.5, 0.8, Quality.GOOD)
    assert both.focal_length_mm == pytest.approx(6.6)
    assert both.focal_sigma_mm == pytest.approx(0.066)
    assert (both.zoom_position, both.focus_position) == (0x1781, 0x1234)
    assert both.distance_age_s >= 0
    assert both.lens_age_s >= 0
    assert (both.calibration, both.lens_moving) == (Calibration.CURRENT, False)
    assert instruments.stuck == []


def test_a_calibration_goes_stale_with_the_lens_and_is_current_again_where_it_was(tmp_path):
    camera = FakeCamera(zoom=0x1781)
    with PtyLine(tmp_path, camera) as line, Instruments(lens_at(line.path), None) as instruments:
        until(instruments, lambda r: r.calibration is Calibration.CURRENT)
        camera.executing = 1
        moving = until(instruments, lambda r: r.lens_moving)
        assert (moving.calibration, moving.focal_quality) == (Calibration.STALE, Quality.BAD)
        assert not instruments.mark_calibrated()
        camera.zoom, camera.executing = 0x2000, 0
        elsewhere = until(instruments, lambda r: r.zoom_position == 0x2000 and r.lens_moving is False)
        assert elsewhere.calibration is Calibration.STALE
        assert "zoom stands at 8192, calibrated at 6017" in elsewhere.calibration_reason
        assert elsewhere.focal_quality is Quality.GOOD
        camera.zoom = 0x1781
        until(instruments, lambda r: r.calibration is Calibration.CURRENT)
        camera.zoom = 0x2000
        until(instruments, lambda r: r.calibration is Calibration.STALE and r.lens_moving is False)
        assert instruments.mark_calibrated()
        assert instruments.readings().calibration is Calibration.CURRENT


def test_a_lens_that_stands_elsewhere_than_the_station_file_says_is_stale_from_the_start(tmp_path):
    with (
        PtyLine(tmp_path, FakeCamera(zoom=0x1781)) as line,
        Instruments(lens_at(line.path, calibrated_zoom_position=0x2000), None) as instruments,
    ):
        readings = until(instruments, lambda r: r.lens_age_s is not None)
    assert readings.calibration is Calibration.STALE


def test_an_unplugged_instrument_is_bad_then_found_again(tmp_path):
    clock, device = HurriedClock(), FakeRangeFinder(b"g0g+00012345\r\n")
    with Instruments(None, finder_at(str(tmp_path / "usb-fake-port0")), clock) as instruments:
        assert "no such port" in until(instruments, lambda r: r.distance_reason != "no answer yet").distance_reason
        clock.advance(20)
        with PtyLine(tmp_path, device):
            until(instruments, lambda r: r.distance_mm == 1234.5)
        lost = until(instruments, lambda r: r.distance_quality is Quality.BAD)
        assert (lost.distance_mm, lost.distance_sigma_mm) == (None, None)
        assert lost.distance_age_s >= 0
        clock.advance(20)
        with PtyLine(tmp_path, device):
            until(instruments, lambda r: r.distance_mm == 1234.5)


def test_a_mute_instrument_is_left_within_the_time_for_a_stop(tmp_path):
    with PtyLine(tmp_path, FakeRangeFinder(b"")) as line:
        instruments = Instruments(None, finder_at(line.path))
        instruments.start()
        instruments.stop(PATIENCE_S)
        instruments.stop(PATIENCE_S)
        assert instruments.stuck == []


def test_one_never_started_stops_too():
    instruments = Instruments(lens_at("loop://"), finder_at("loop://"))
    instruments.stop()
    assert instruments.stuck == []


def test_an_echo_is_no_instrument():
    """A loop answers every question with the question."""
    with Instruments(lens_at("loop://"), finder_at("loop://")) as instruments:
        readings = until(instruments, lambda r: "yet" not in r.focal_reason and "yet" not in r.distance_reason)
    assert (readings.focal_quality, readings.distance_quality) == (Quality.BAD, Quality.BAD)
    assert readings.calibration is Calibration.UNCONFIRMED


@pytest.mark.parametrize(
    ("model", "kind"), [(RangeFinderModel.DIMETIX, DimetixRangeFinder), (RangeFinderModel.ACUITY, AcuityRangeFinder)]
)
def test_a_model_has_its_driver(model, kind):
    settings = RangeFinderSettings("loop://", model, LineSettings())
    assert type(open_range_finder(settings, HurriedClock())) is kind
