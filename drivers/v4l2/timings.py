"""Timings of digital video inputs, HDMI or SDI: which pictures come in, and how fast."""

from __future__ import annotations

import errno
import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

from drivers.v4l2 import calls
from drivers.v4l2.structs import DvTimings

if TYPE_CHECKING:
    from drivers.v4l2.calls import Node

__all__ = ["NO_TIMINGS", "Timings", "detected_timings", "follow_timings", "set_timings", "timings_in_use"]

log = logging.getLogger(__name__)

NO_TIMINGS = frozenset({errno.ENOLINK, errno.ENOLCK, errno.ERANGE})
"""No signal, none to lock to, none in the range of the device."""
SAME_RATE = 0.005
"""Rates are measured: of one signal they differ by less than this share."""


@dataclass(frozen=True, slots=True)
class Timings:
    """Size and rate of digital video.

    Attributes
    ----------
    width_px, height_px
        Of whole frames.
    interlaced
        Whether they come as fields.
    rate_hz
        Frames a second; 0 where they do not tell.
    raw
        The kernel's structure.
    """

    width_px: int
    height_px: int
    interlaced: bool
    rate_hz: float
    raw: bytes = field(repr=False)

    @classmethod
    def of(cls, timings: DvTimings) -> Self:
        """Describe the kernel's structure."""
        bt = timings.timings.bt
        return cls(bt.width, bt.height, bool(bt.interlaced), _rate_hz(timings), bytes(timings))

    def like(self, other: Timings) -> bool:
        """Whether they give pictures of one size at one rate."""
        same = (self.width_px, self.height_px, self.interlaced) == (other.width_px, other.height_px, other.interlaced)
        return same and abs(self.rate_hz - other.rate_hz) <= SAME_RATE * other.rate_hz

    def __str__(self) -> str:
        return f"{self.width_px}x{self.height_px}{'i' if self.interlaced else 'p'} at {self.rate_hz:.4g} Hz"


def _rate_hz(timings: DvTimings) -> float:
    t = timings.timings.bt
    width = t.width + t.hfrontporch + t.hsync + t.hbackporch
    height = t.height + t.vfrontporch + t.vsync + t.vbackporch
    if t.interlaced:
        height += t.il_vfrontporch + t.il_vsync + t.il_vbackporch
    return t.pixelclock / (width * height) if width * height else 0.0


def timings_in_use(node: Node) -> Timings | None:
    """Give the timings set; None where the input has none."""
    told = calls.dv_timings(node)
    return None if told is None else Timings.of(told)


def detected_timings(node: Node) -> Timings | None:
    """Give the timings of the signal; None where there is none, or the input has no timings."""
    try:
        told = calls.query_dv_timings(node)
    except OSError as error:
        if error.errno in NO_TIMINGS:
            return None
        raise
    return None if told is None else Timings.of(told)


def set_timings(node: Node, timings: Timings) -> None:
    """Set a digital input."""
    calls.set_dv_timings(node, DvTimings.from_buffer_copy(timings.raw))


def follow_timings(node: Node, device: str) -> None:
    """Set a digital input to the timings of its signal, as far as there is one that the device takes."""
    in_use, found = timings_in_use(node), detected_timings(node)
    if in_use is None or found is None or found.like(in_use):
        return
    try:
        set_timings(node, found)
    except OSError as error:
        if error.errno not in {errno.EINVAL, errno.ERANGE}:
            raise
        log.warning("%s: its source sends %s, which it does not take; it stays at %s", device, found, in_use)
