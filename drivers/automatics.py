"""Turning a camera's automatics off before it measures: a picture that changes by itself cannot be compared."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from drivers.errors import DeviceStateError

if TYPE_CHECKING:
    from collections.abc import Collection

    from drivers.grabber import Control, Grabber

__all__ = ["AUTOMATICS", "lock_automatics"]

AUTOMATICS: Final = (
    "auto_exposure",
    "exposure_dynamic_framerate",
    "auto_gain",
    "auto_white_balance",
    "auto_brightness",
    "auto_hue",
    "auto_focus",
)
"""Controls that let the device change its own picture, in the order in which they are turned off."""


def lock_automatics(grabber: Grabber, names: Collection[str] = AUTOMATICS) -> dict[str, float]:
    """Turn automatics off, as far as the device has them, and read them back.

    Parameters
    ----------
    grabber
        Open.
    names
        Which of AUTOMATICS.

    Returns
    -------
    dict
        What each one that the device has was read back as.

    Raises
    ------
    DeviceStateError
        One stays on, or is none of AUTOMATICS.
    """
    unknown = [name for name in names if name not in AUTOMATICS]
    if unknown:
        raise DeviceStateError(grabber.name, f"{unknown[0]} is no automatic; known: {', '.join(AUTOMATICS)}")
    offered = {c.name: c for c in grabber.controls()}
    return {name: _turn_off(grabber, offered[name]) for name in AUTOMATICS if name in names and name in offered}


def _turn_off(grabber: Grabber, control: Control) -> float:
    off = control.minimum
    if control.choices:
        manual = [i for i, choice in enumerate(control.choices) if choice.lower().startswith("manual")]
        if not manual:
            raise DeviceStateError(grabber.name, f"{control.name} knows no manual: {', '.join(control.choices)}")
        off += manual[0]
    taken = grabber.set_control(control.name, off)
    if taken != off:
        raise DeviceStateError(grabber.name, f"{control.name} stays on: set to {off:g}, read back as {taken:g}")
    return taken
