"""The device's settings by name."""

from __future__ import annotations

import errno
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from drivers.errors import DeviceStateError
from drivers.grabber import Control
from drivers.v4l2 import calls
from drivers.v4l2.constants import ControlFlag, ControlId, ControlType

if TYPE_CHECKING:
    from drivers.v4l2.calls import Node
    from drivers.v4l2.structs import QueryControl

__all__ = ["ControlTable"]

NAMES: Final = {
    ControlId.BRIGHTNESS: "brightness",
    ControlId.CONTRAST: "contrast",
    ControlId.SATURATION: "saturation",
    ControlId.HUE: "hue",
    ControlId.GAMMA: "gamma",
    ControlId.SHARPNESS: "sharpness",
    ControlId.BACKLIGHT_COMPENSATION: "backlight_compensation",
    ControlId.AUTO_WHITE_BALANCE: "auto_white_balance",
    ControlId.WHITE_BALANCE_TEMPERATURE: "white_balance_temperature",
    ControlId.AUTOGAIN: "auto_gain",
    ControlId.GAIN: "gain",
    ControlId.HUE_AUTO: "auto_hue",
    ControlId.AUTOBRIGHTNESS: "auto_brightness",
    ControlId.EXPOSURE: "exposure",
    ControlId.EXPOSURE_AUTO: "auto_exposure",
    ControlId.EXPOSURE_ABSOLUTE: "exposure_time",
    ControlId.EXPOSURE_AUTO_PRIORITY: "exposure_dynamic_framerate",
    ControlId.FOCUS_AUTO: "auto_focus",
    ControlId.FOCUS_ABSOLUTE: "focus",
    ControlId.ZOOM_ABSOLUTE: "zoom",
    ControlId.IRIS_ABSOLUTE: "iris",
}
"""Devices and kernel versions spell these differently; all others have the name that v4l2-ctl gives them."""
UNITS: Final = {ControlId.EXPOSURE_ABSOLUTE: "100 us", ControlId.WHITE_BALANCE_TEMPERATURE: "K"}
SETTINGS: Final = {
    ControlType.INTEGER, ControlType.BOOLEAN, ControlType.MENU, ControlType.INTEGER_MENU, ControlType.BITMASK,
}  # fmt: skip
REFUSALS: Final = {errno.EACCES, errno.EPERM, errno.EINVAL, errno.ERANGE, errno.EBUSY, errno.EIO, errno.EPIPE}


@dataclass(frozen=True, slots=True)
class _Entry:
    id: int
    told: Control
    values: tuple[int, ...]
    """What a menu takes; empty where everything in the range will do."""

    def nearest(self, value: float) -> int:
        """Give what can be set: within the range, on a step, in the menu."""
        c = self.told
        inside = min(max(value, c.minimum), c.maximum)
        if self.values:
            return min(self.values, key=lambda v: abs(v - inside))
        return min(round(c.minimum + round((inside - c.minimum) / c.step) * c.step), int(c.maximum))


class ControlTable:
    """Settings of an open device; its calls raise OSError where the device fails.

    Parameters
    ----------
    node
        The device.
    device
        Its name in errors.
    """

    def __init__(self, node: Node, device: str) -> None:
        self._node, self._device = node, device
        self._entries: dict[str, _Entry] = {}
        for query in calls.controls(node):
            if query.type in SETTINGS and not query.flags & ControlFlag.WRITE_ONLY:
                self._add(query)

    def _add(self, query: QueryControl) -> None:
        name = NAMES.get(query.id) or re.sub("[^a-z0-9]+", "_", calls.text(query.name).lower()).strip("_")
        if name in self._entries:
            name = f"{name}_{query.id:x}"
        is_menu = query.type in {ControlType.MENU, ControlType.INTEGER_MENU}
        items = calls.menu(self._node, query) if is_menu else {}
        low, high = query.minimum, query.maximum
        if query.type == ControlType.BITMASK:
            low, high = 0, query.maximum & 0x7FFFFFFF
        low, high = min(items, default=low), max(items, default=high)
        told = Control(
            name=name,
            minimum=low,
            maximum=high,
            step=max(1, query.step),
            default=query.default_value,
            unit=UNITS.get(query.id, ""),
            choices=tuple(items.get(value, "") for value in range(low, high + 1)) if items else (),
            read_only=bool(query.flags & ControlFlag.READ_ONLY),
        )
        self._entries[name] = _Entry(query.id, told, tuple(items))

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def all(self) -> tuple[Control, ...]:
        """Settings on offer."""
        return tuple(entry.told for entry in self._entries.values())

    def read(self, name: str) -> float:
        """Read a setting back."""
        return float(calls.control_value(self._node, self._entries[name].id))

    def write(self, name: str, value: float) -> float:
        """Change a setting to the nearest that can be set; gives what the device took.

        Raises
        ------
        DeviceStateError
            The device does not let it be changed, or not now.
        """
        entry = self._entries[name]
        if entry.told.read_only or math.isnan(value):
            why = "it can only be read" if entry.told.read_only else "that is no number"
            raise DeviceStateError(self._device, f"{name} = {value:g} cannot be set: {why}")
        try:
            calls.set_control(self._node, entry.id, entry.nearest(value))
        except OSError as error:
            if error.errno not in REFUSALS:
                raise
            raise DeviceStateError(
                self._device,
                f"refuses {name} = {value:g} ({error.strerror}); is an automatic in charge of it? Turn that off first",
            ) from error
        return self.read(name)
