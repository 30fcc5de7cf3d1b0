"""Video inputs by name, what they say of their signal, and which television standards they take."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING, Final

from drivers.grabber import Input, SignalStatus, Standard
from drivers.v4l2 import calls
from drivers.v4l2.constants import InputCapability, InputStatus, StandardBits
from drivers.v4l2.timings import NO_TIMINGS, Timings, timings_in_use

if TYPE_CHECKING:
    from drivers.v4l2.calls import Node
    from drivers.v4l2.structs import InputDescription

__all__ = ["STANDARD_BITS", "list_inputs", "signal_status", "standard_of"]

STANDARD_BITS: Final = {
    Standard.NTSC: StandardBits.NTSC,
    Standard.PAL: StandardBits.PAL,
    Standard.SECAM: StandardBits.SECAM,
}
SIGNALLESS: Final = InputStatus.NO_POWER | InputStatus.NO_SIGNAL | InputStatus.NO_CARRIER
UNLOCKED: Final = InputStatus.NO_H_LOCK | InputStatus.NO_V_LOCK | InputStatus.NO_STD_LOCK | InputStatus.NO_SYNC
KINDS: Final = {1: "tuner", 2: "camera", 3: "touch"}


def list_inputs(descriptions: list[InputDescription]) -> tuple[Input, ...]:
    """Give the inputs, each with a name of its own."""
    names: list[str] = []
    for d in descriptions:
        name = calls.text(d.name) or f"input {d.index}"
        names.append(name if name not in names else f"{name} ({d.index})")
    return tuple(Input(n, _kind(d), _standards(d)) for n, d in zip(names, descriptions, strict=True))


def _kind(d: InputDescription) -> str:
    if d.capabilities & InputCapability.DV_TIMINGS:
        return "digital"
    return "analogue" if d.std else KINDS.get(d.type, "camera")


def _standards(d: InputDescription) -> tuple[Standard, ...]:
    return tuple(name for name, bits in STANDARD_BITS.items() if d.std & bits) or (Standard.NONE,)


def standard_of(bits: int) -> Standard:
    """Name a standard; PAL-M, PAL-N and PAL-60 are PAL too."""
    if not bits:
        return Standard.NONE
    return next((name for name, of_it in STANDARD_BITS.items() if bits & of_it), Standard.PAL)


def signal_status(node: Node, index: int) -> SignalStatus:
    """Ask the input in use for its signal; raises OSError.

    Cameras have no status of their own and drivers leave it 0: that is UNKNOWN, not OK.
    """
    found = next((d for d in calls.inputs(node) if d.index == index), None)
    if found is None:
        return SignalStatus.UNKNOWN
    if found.status & SIGNALLESS:
        return SignalStatus.NO_SIGNAL
    if found.status & UNLOCKED:
        return SignalStatus.NO_LOCK
    if found.capabilities & InputCapability.DV_TIMINGS:
        return _digital_status(node)
    return SignalStatus.OK if found.std else SignalStatus.UNKNOWN


def _digital_status(node: Node) -> SignalStatus:
    try:
        told, in_use = calls.query_dv_timings(node), timings_in_use(node)
    except OSError as error:
        if error.errno not in NO_TIMINGS:
            raise
        return SignalStatus.NO_SIGNAL if error.errno == errno.ENOLINK else SignalStatus.NO_LOCK
    if told is None or in_use is None:
        return SignalStatus.UNKNOWN
    return SignalStatus.OK if Timings.of(told).like(in_use) else SignalStatus.NO_LOCK
