"""The settings of a USB video device by name: those of its processing unit and of its camera terminal.

Selectors, sizes and bits are those of sections 4.2.2.1 and 4.2.2.3 of the "USB Device Class Definition for Video
Devices" 1.5. Names are those that `drivers.v4l2.controls` gives the same settings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from drivers.errors import DeviceProtocolError, DeviceStateError
from drivers.grabber import Control

if TYPE_CHECKING:
    from drivers.uvc.descriptors import Unit, VideoFunction
    from drivers.uvc.link import UsbLink

__all__ = ["UvcControls"]

CUR, MIN, MAX, RES, DEF = 0x81, 0x82, 0x83, 0x84, 0x87


@dataclass(frozen=True, slots=True)
class _Known:
    """A setting that the class defines: its bit in bmControls, its selector, and how many bytes its value has."""

    name: str
    bit: int
    selector: int
    size: int
    signed: bool = False
    switch: bool = False
    """On or off: the class gives it no range."""
    unit: str = ""


PROCESSING: Final = (
    _Known("brightness", 0, 0x02, 2, signed=True),
    _Known("contrast", 1, 0x03, 2),
    _Known("hue", 2, 0x06, 2, signed=True),
    _Known("saturation", 3, 0x07, 2),
    _Known("sharpness", 4, 0x08, 2),
    _Known("gamma", 5, 0x09, 2),
    _Known("white_balance_temperature", 6, 0x0A, 2, unit="K"),
    _Known("backlight_compensation", 8, 0x01, 2),
    _Known("gain", 9, 0x04, 2),
    _Known("auto_hue", 11, 0x10, 1, switch=True),
    _Known("auto_white_balance", 12, 0x0B, 1, switch=True),
)
CAMERA: Final = (
    _Known("auto_exposure", 1, 0x02, 1),
    _Known("exposure_dynamic_framerate", 2, 0x03, 1, switch=True),
    _Known("exposure_time", 3, 0x04, 4, unit="100 us"),
    _Known("focus", 5, 0x06, 2),
    _Known("zoom", 9, 0x0B, 2),
    _Known("auto_focus", 17, 0x08, 1, switch=True),
)
EXPOSURE_MODES: Final = {2: "Auto Mode", 1: "Manual Mode", 4: "Shutter Priority Mode", 8: "Aperture Priority Mode"}
"""By the bits that the device takes; the choices are counted in this order, as in Video4Linux."""


@dataclass(frozen=True, slots=True)
class _Entry:
    known: _Known
    unit: int
    told: Control
    bits: tuple[int, ...] = ()
    """What the choices of a menu are on the line."""

    def nearest(self, value: float) -> int:
        """Give what can be set: within the range, on a step, among the choices."""
        c = self.told
        inside = min(max(value, c.minimum), c.maximum)
        if c.choices:
            return min((i for i, text in enumerate(c.choices) if text), key=lambda i: abs(i - inside))
        return min(round(c.minimum + round((inside - c.minimum) / c.step) * c.step), int(c.maximum))


class UvcControls:
    """Settings of an open device, asked of it when this is made.

    Parameters
    ----------
    link
        The device.
    function
        Which units it has.
    """

    def __init__(self, link: UsbLink, function: VideoFunction) -> None:
        self._link, self._interface = link, function.control_interface
        self._entries: dict[str, _Entry] = {}
        for unit, known_ones in ((function.processing, PROCESSING), (function.camera, CAMERA)):
            for known in known_ones:
                if unit.id and unit.controls >> known.bit & 1:
                    self._add(unit, known)

    def _add(self, unit: Unit, known: _Known) -> None:
        """Ask for a setting's range; what the device announces and does not know is left out."""
        try:
            self._entries[known.name] = self._asked(unit, known)
        except (DeviceStateError, DeviceProtocolError):
            return

    def _asked(self, unit: Unit, known: _Known) -> _Entry:
        default = self._get(unit.id, known, DEF)
        if known.name == "auto_exposure":
            offered = self._get(unit.id, known, RES)
            choices = tuple(text if offered & bit else "" for bit, text in EXPOSURE_MODES.items())
            bits = tuple(EXPOSURE_MODES)
            usual = bits.index(default) if default in bits else 0
            return _Entry(known, unit.id, Control(known.name, 0, 3, 1, usual, choices=choices), bits)
        low, high, step = (0, 1, 1) if known.switch else (self._get(unit.id, known, r) for r in (MIN, MAX, RES))
        if low > high:
            raise DeviceProtocolError(self._link.name, f"says that {known.name} goes from {low} to {high}")
        return _Entry(known, unit.id, Control(known.name, low, high, max(1, step), default, known.unit))

    def _get(self, unit: int, known: _Known, request: int) -> int:
        with self._link.told(f"cannot tell its {known.name}"):
            raw = self._link.get(known.selector, self._interface, known.size, entity=unit, request=request)
        return int.from_bytes(raw, "little", signed=known.signed)

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def all(self) -> tuple[Control, ...]:
        """Settings on offer."""
        return tuple(entry.told for entry in self._entries.values())

    def read(self, name: str) -> float:
        """Read a setting back."""
        entry = self._entries[name]
        value = self._get(entry.unit, entry.known, CUR)
        return float(entry.bits.index(value) if value in entry.bits else value)

    def write(self, name: str, value: float) -> float:
        """Change a setting to the nearest that can be set; gives what the device took.

        Raises
        ------
        DeviceStateError
            The device does not let it be changed, or not now.
        """
        entry = self._entries[name]
        if math.isnan(value):
            raise DeviceStateError(self._link.name, f"{name} = {value:g} cannot be set: that is no number")
        taken = entry.nearest(value)
        data = (entry.bits[taken] if entry.bits else taken).to_bytes(
            entry.known.size, "little", signed=entry.known.signed
        )
        try:
            with self._link.told(f"cannot set {name}"):
                self._link.set(entry.known.selector, self._interface, data, entity=entry.unit)
        except DeviceProtocolError as error:
            raise DeviceStateError(
                self._link.name, f"refuses {name} = {value:g}; is an automatic in charge of it? Turn that off first"
            ) from error
        return self.read(name)
