"""The station's lens and range finder, each asked by a thread of its own."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self, TypeVar

from drivers.grabber import SystemClock
from drivers.lens import ViscaLens
from drivers.range_finder import AcuityRangeFinder, DimetixRangeFinder
from drivers.serial_channel import SerialChannel
from service.acquisition.poller import InstrumentPoller, Reading
from service.acquisition.readings import (
    InstrumentReadings,
    LensPlace,
    calibration_of,
    distance_of,
    focal_length_of,
    place_of,
)
from service.config.instruments import RangeFinderModel

if TYPE_CHECKING:
    from types import TracebackType

    from drivers.grabber import Clock
    from drivers.lens import Lens
    from drivers.range_finder import RangeFinder
    from service.acquisition.poller import Instrument
    from service.config.instruments import LensSettings, RangeFinderSettings

__all__ = ["Instruments", "open_lens", "open_range_finder"]

R = TypeVar("R", bound=Reading)

STOP_S = 1.0


def open_lens(settings: LensSettings, clock: Clock) -> Lens:
    """Make the lens of a station. Its line is opened when it is first read."""
    return ViscaLens(
        SerialChannel(settings.port, settings.line, clock=clock),
        address=settings.address,
        autofocus_off=settings.autofocus_off,
        digital_zoom_off=settings.digital_zoom_off,
    )


def open_range_finder(settings: RangeFinderSettings, clock: Clock) -> RangeFinder:
    """Make the range finder of a station. Its line is opened when it is first read."""
    channel = SerialChannel(settings.port, settings.line, clock=clock)
    if settings.model is RangeFinderModel.DIMETIX:
        return DimetixRangeFinder(channel, device_id=settings.device_id, sigma_mm=settings.sigma_mm)
    return AcuityRangeFinder(channel, sigma_mm=settings.sigma_mm)


class Instruments:
    """Asks lens and range finder while it runs; either may be missing. `readings` may be called from any thread.

    Parameters
    ----------
    lens, range_finder
        Their settings; None where there is none.
    clock
        For ages and time stamps.
    """

    def __init__(
        self, lens: LensSettings | None, range_finder: RangeFinderSettings | None, clock: Clock | None = None
    ) -> None:
        self._clock: Clock = clock or SystemClock()
        self._lens_settings, self._range_settings = lens, range_finder
        self._lock = threading.Lock()
        self._calibrated: LensPlace | None = None
        if lens is not None and lens.calibrated_zoom_position is not None:
            self._calibrated = LensPlace(lens.calibrated_zoom_position, lens.calibrated_focus_position)
        self._lens = None if lens is None else self._poller(open_lens(lens, self._clock), "lens", lens.rate_hz)
        self._range_finder = (
            None
            if range_finder is None
            else self._poller(open_range_finder(range_finder, self._clock), "range-finder", range_finder.rate_hz)
        )
        self.stuck: list[str] = []
        """What did not stop in time."""

    def _poller(self, instrument: Instrument[R], kind: str, rate_hz: float) -> InstrumentPoller[R]:
        return InstrumentPoller(instrument, kind, rate_hz, self._clock)

    @property
    def _pollers(self) -> list[InstrumentPoller[Any]]:
        return [poller for poller in (self._lens, self._range_finder) if poller is not None]

    def start(self) -> None:
        """Begin to ask. Returns at once: an instrument that is not there is looked for as long as this runs."""
        for poller in self._pollers:
            poller.start()

    def request_stop(self) -> None:
        """Ask all to end; returns at once."""
        for poller in self._pollers:
            poller.request_stop()

    def stop(self, timeout_s: float = STOP_S) -> None:
        """Stop asking and let the devices go. May be repeated."""
        deadline = time.monotonic() + timeout_s
        self.request_stop()
        self.stuck = [poller.name for poller in self._pollers if not poller.join(deadline - time.monotonic())]

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def mark_calibrated(self) -> bool:
        """Take where the lens stands now for where it was calibrated; False where it has not told, or moves."""
        last = self._lens.heard.good if self._lens else None
        if last is None or last.executing:
            return False
        with self._lock:
            self._calibrated = place_of(last)
        return True

    def readings(self) -> InstrumentReadings:
        """What the instruments say now."""
        return self._with_lens(self._with_distance(InstrumentReadings()))

    def _with_distance(self, readings: InstrumentReadings) -> InstrumentReadings:
        if self._range_finder is None or self._range_settings is None:
            return readings
        heard = self._range_finder.heard
        estimate = distance_of(self._clock.monotonic_ns(), heard.newest, heard.good, self._range_settings)
        return replace(
            readings,
            distance_mm=estimate.value,
            distance_sigma_mm=estimate.sigma,
            distance_age_s=estimate.age_s,
            distance_quality=estimate.quality,
            distance_reason=estimate.reason,
        )

    def _with_lens(self, readings: InstrumentReadings) -> InstrumentReadings:
        if self._lens is None or self._lens_settings is None:
            return readings
        if self._calibrated is None:
            self.mark_calibrated()
        heard = self._lens.heard
        now_ns = self._clock.monotonic_ns()
        estimate = focal_length_of(now_ns, heard.newest, heard.good, heard.good_before, self._lens_settings)
        calibration, reason, moving = calibration_of(
            now_ns, heard.good, heard.good_before, self._calibrated, self._lens_settings
        )
        return replace(
            readings,
            focal_length_mm=estimate.value,
            focal_sigma_mm=estimate.sigma,
            zoom_position=heard.good.zoom_position if heard.good else None,
            focus_position=heard.good.focus_position if heard.good else None,
            lens_age_s=estimate.age_s,
            focal_quality=estimate.quality,
            focal_reason=estimate.reason,
            lens_moving=moving,
            calibration=calibration,
            calibration_reason=reason,
        )
