"""The station file's [lens] and [range_finder]: instruments on serial lines."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.serial_port import LineSettings, port_fault
from drivers.zoom_table import SONY_25X, ZoomTable

if TYPE_CHECKING:
    from service.config.table import Table

__all__ = ["LensSettings", "RangeFinderModel", "RangeFinderSettings", "lens_settings", "range_finder_settings"]


class RangeFinderModel(enum.StrEnum):
    """Whose language a range finder speaks."""

    DIMETIX = "dimetix"
    ACUITY = "acuity"


VISCA_LINE = LineSettings()
FACTORY_LINES = {RangeFinderModel.DIMETIX: (19200, "7E1"), RangeFinderModel.ACUITY: (9600, "8N1")}


@dataclass(frozen=True, slots=True, eq=False)
class LensSettings:
    """[lens]: a block camera's lens on a VISCA line.

    Attributes
    ----------
    wide_focal_length_mm
        At zoom ratio 1; None: the lens tells only whether it moves.
    calibrated_zoom_position, calibrated_focus_position
        Where the lens stood when the camera file was made; None: wherever it stands when the service starts.
    tolerance_counts
        How far from there it still counts as not moved.
    """

    port: str
    line: LineSettings = VISCA_LINE
    address: int = 1
    rate_hz: float = 5.0
    stale_after_s: float = 2.0
    wide_focal_length_mm: float | None = None
    zoom_table: ZoomTable = SONY_25X
    autofocus_off: bool = True
    digital_zoom_off: bool = True
    calibrated_zoom_position: int | None = None
    calibrated_focus_position: int | None = None
    tolerance_counts: int = 2


@dataclass(frozen=True, slots=True)
class RangeFinderSettings:
    """[range_finder]: a laser on a serial line, looking along the optical axis.

    Attributes
    ----------
    sigma_mm
        One sigma of what it measures; None: its type's usual one.
    offset_mm
        How far its zero stands in front of the camera's centre; added to what it measures.
    """

    port: str
    model: RangeFinderModel
    line: LineSettings
    device_id: int = 0
    rate_hz: float = 2.0
    stale_after_s: float = 3.0
    sigma_mm: float | None = None
    offset_mm: float = 0.0


def lens_settings(t: Table) -> LensSettings | None:
    """Take [lens]; None where it is empty."""
    if not t.values:
        return None
    default = LensSettings("")
    settings = LensSettings(
        port=_port(t),
        line=_line(t, 9600, "8N1"),
        address=t.integer("address", default.address, minimum=1, maximum=7),
        rate_hz=t.number("rate_hz", default.rate_hz, minimum=0.1, maximum=30),
        stale_after_s=t.number("stale_after_s", default.stale_after_s, minimum=0.1, maximum=600),
        wide_focal_length_mm=t.number("wide_focal_length_mm", None, above=0),
        zoom_table=_zoom_table(t),
        autofocus_off=t.flag("autofocus_off", default.autofocus_off),
        digital_zoom_off=t.flag("digital_zoom_off", default.digital_zoom_off),
        calibrated_zoom_position=t.integer("calibrated_zoom_position", None, minimum=0, maximum=0xFFFF),
        calibrated_focus_position=t.integer("calibrated_focus_position", None, minimum=0, maximum=0xFFFF),
        tolerance_counts=t.integer("tolerance_counts", default.tolerance_counts, minimum=0, maximum=0xFFFF),
    )
    t.finish()
    if settings.calibrated_zoom_position is None and settings.calibrated_focus_position is not None:
        raise t.error("calibrated_focus_position", "needs calibrated_zoom_position beside it")
    _check_age(t, settings.rate_hz, settings.stale_after_s)
    return settings


def range_finder_settings(t: Table) -> RangeFinderSettings | None:
    """Take [range_finder]; None where it is empty."""
    if not t.values:
        return None
    port, model = _port(t), t.choice("model", RangeFinderModel)
    settings = RangeFinderSettings(
        port=port,
        model=model,
        line=_line(t, *FACTORY_LINES[model]),
        device_id=t.integer("device_id", 0, minimum=0, maximum=9),
        rate_hz=t.number("rate_hz", 2.0, minimum=0.1, maximum=30),
        stale_after_s=t.number("stale_after_s", 3.0, minimum=0.1, maximum=600),
        sigma_mm=t.number("sigma_mm", None, above=0),
        offset_mm=t.number("offset_mm", 0.0),
    )
    t.finish()
    _check_age(t, settings.rate_hz, settings.stale_after_s)
    return settings


def _port(t: Table) -> str:
    port: str = t.text("port")
    if fault := port_fault(port):
        raise t.error("port", fault)
    return port


def _line(t: Table, baudrate: int, framing: str) -> LineSettings:
    baudrate = t.integer("baudrate", baudrate, minimum=50, maximum=4_000_000)
    try:
        return LineSettings.of(baudrate, t.text("framing", framing))
    except ValueError as error:
        raise t.error("framing", str(error)) from None


def _zoom_table(t: Table) -> ZoomTable:
    points = t.pairs("zoom_table", None)
    if points is None:
        return SONY_25X
    try:
        return ZoomTable(points)
    except ValueError as error:
        raise t.error("zoom_table", str(error)) from None


def _check_age(t: Table, rate_hz: float, stale_after_s: float) -> None:
    if stale_after_s <= 1 / rate_hz:
        raise t.error(
            "stale_after_s", f"every value would be stale before the next comes; give more than {1 / rate_hz:g}"
        )
