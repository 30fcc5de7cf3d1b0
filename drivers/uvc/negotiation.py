"""Choosing among what a device offers, and the bytes in which it is asked for: pure functions.

The structure is that of table 4-75 of the "USB Device Class Definition for Video Devices" 1.5.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from drivers.encodings import ENCODINGS, Layout
from drivers.errors import DeviceProtocolError, UnsupportedFormatError

if TYPE_CHECKING:
    from drivers.uvc.descriptors import StreamFormat, StreamSize, VideoStream

__all__ = ["Choice", "Granted", "Wish", "choose", "probe_bytes", "read_granted"]

INTERVALS_A_SECOND: Final = 10_000_000
KEEP_INTERVAL: Final = 1
"""bmHint: of all that is asked for, keep the frame interval."""
LEAST_BYTES: Final = 26
MOST_FRAME_BYTES: Final = 1 << 28
HEADERS_BYTES: Final = 4096
"""Room for the headers of a payload that holds a whole frame."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What is asked of the device; None: as is usual for it, or as serves best."""

    size_px: tuple[int, int] | None = None
    encoding: str | None = None
    rate_hz: float | None = None


@dataclass(frozen=True, slots=True)
class Choice:
    """A format, a size and an interval out of those on offer."""

    format: StreamFormat
    size: StreamSize
    interval: int

    @property
    def rate_hz(self) -> float:
        """Frames a second."""
        return INTERVALS_A_SECOND / self.interval

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.size.width_px, self.size.height_px

    @property
    def layout(self) -> Layout:
        """Of a frame's bytes: without padding, as the class has it."""
        encoding = ENCODINGS[self.format.encoding or ""]
        width, height = self.size.width_px, self.size.height_px
        return Layout(width, height, width * encoding.bytes_per_px, encoding)


@dataclass(frozen=True, slots=True)
class Granted:
    """What a device answers.

    Attributes
    ----------
    choice
        The pictures that it will send.
    frame_bytes
        The most that a frame will have.
    payload_bytes
        The most that a payload will have, its header included.
    raw
        The answer itself, with which it is committed to.
    """

    choice: Choice
    frame_bytes: int
    payload_bytes: int
    raw: bytes


def choose(stream: VideoStream, device: str, wish: Wish) -> Choice:
    """Choose the coding asked for, or the best; the size and rate nearest to those asked for, or the usual ones.

    Raises
    ------
    UnsupportedFormatError
        It offers nothing that can be read, or not the coding asked for.
    """
    usable = {f.encoding: f for f in reversed(stream.formats) if f.encoding and f.sizes}
    wanted = wish.encoding or next((name for name in ENCODINGS if name in usable), None)
    if wanted not in usable:
        offered = ", ".join(n for n in ENCODINGS if n in usable)
        there = offered or f"only what cannot be read ({', '.join(f.code for f in stream.formats) or 'nothing'})"
        raise UnsupportedFormatError(device, f"cannot give {wanted or ' or '.join(ENCODINGS)}; it offers {there}")
    chosen = usable[wanted]
    size = _nearest_size(chosen, wish.size_px)
    return Choice(chosen, size, _nearest_interval(size, wish.rate_hz))


def _nearest_size(f: StreamFormat, size_px: tuple[int, int] | None) -> StreamSize:
    if size_px is None:
        return next((s for s in f.sizes if s.index == f.default_size), f.sizes[0])
    return min(f.sizes, key=lambda s: abs(s.width_px - size_px[0]) + abs(s.height_px - size_px[1]))


def _nearest_interval(size: StreamSize, rate_hz: float | None) -> int:
    if rate_hz is None:
        return size.default_interval
    wanted = round(INTERVALS_A_SECOND / rate_hz)
    if size.continuous:
        return min(max(wanted, size.intervals[0]), size.intervals[-1])
    return min(size.intervals, key=lambda i: abs(i - wanted))


def probe_bytes(version: int, choice: Choice) -> bytes:
    """Give the bytes that ask for a choice, as many as the version of the class definition has."""
    size = 26 if version < 0x0110 else 34 if version < 0x0150 else 48
    return struct.pack("<HBBI", KEEP_INTERVAL, choice.format.index, choice.size.index, choice.interval).ljust(
        size, b"\0"
    )


def read_granted(raw: bytes, stream: VideoStream, asked: Choice, device: str) -> Granted:
    """Read a device's answer to what was asked.

    Raises
    ------
    DeviceProtocolError
        It is too short, or grants what the device does not offer.
    """
    if len(raw) < LEAST_BYTES:
        raise DeviceProtocolError(device, f"negotiates in {len(raw)} bytes instead of at least {LEAST_BYTES}")
    _, format_index, size_index, interval = struct.unpack_from("<HBBI", raw)
    frame_bytes, payload_bytes = struct.unpack_from("<II", raw, 18)
    granted = next((f for f in stream.formats if f.index == format_index and f.encoding), None)
    size = next((s for s in granted.sizes if s.index == size_index), None) if granted else None
    if granted is None or size is None:
        raise DeviceProtocolError(device, f"grants format {format_index}, size {size_index}, which it does not offer")
    choice = Choice(granted, size, interval or asked.interval)
    # devices are known to tell a wrong size of uncompressed frames
    most = choice.layout.size_bytes or min(max(frame_bytes, 2 * size.width_px * size.height_px), MOST_FRAME_BYTES)
    at_most = most + HEADERS_BYTES
    return Granted(choice, most, min(payload_bytes or at_most, at_most), raw)
