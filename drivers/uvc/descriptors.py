"""What a USB device says of the video that it sends: pure functions on the bytes of its configuration descriptor.

Numbers of tables and sections are those of the "USB Device Class Definition for Video Devices" 1.5 and of its
payload documents. Nothing that a device says is believed: what is cut short or contradicts itself is left out.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "Alternate",
    "StreamFormat",
    "StreamSize",
    "TransferKind",
    "Unit",
    "VideoFunction",
    "VideoStream",
    "video_functions",
]

INTERFACE, ENDPOINT, CLASS_INTERFACE = 0x04, 0x05, 0x24
VIDEO_CLASS, CONTROL, STREAMING = 0x0E, 1, 2
DIRECTION_IN = 0x80
CAMERA_TERMINAL: Final = 0x0201
GUID_TAIL: Final = bytes.fromhex("00001000800000aa00389b71")
ENCODING_OF_CODE: Final = {
    b"YUY2": "YUYV",
    b"UYVY": "UYVY",
    b"NV12": "NV12",
    b"Y800": "GREY",
    b"GREY": "GREY",
    b"Y16 ": "Y16",
    b"\x32\0\0\0": "GREY",  # D3DFMT_L8, as Windows names it
}
"""Of uncompressed formats, by the first four bytes of their GUID."""
FRAME_BASED: Final = "frame-based"
MOST_PX: Final = 16384


class TransferKind(enum.StrEnum):
    """How a stream's endpoint sends."""

    BULK = "bulk"
    ISOCHRONOUS = "isochronous"


@dataclass(frozen=True, slots=True)
class StreamSize:
    """Pictures of one size.

    Attributes
    ----------
    index
        What negotiation calls it.
    default_interval, intervals
        From frame to frame, in units of 100 ns, the shortest first; the shortest and the longest alone where all
        between them will do.
    """

    index: int
    width_px: int
    height_px: int
    default_interval: int
    intervals: tuple[int, ...]
    continuous: bool


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """A coding on offer.

    Attributes
    ----------
    index
        What negotiation calls it.
    encoding
        As `drivers.encodings` names it; None where it cannot be read.
    code
        As the device names it.
    interlaced, top_first
        Whether its frames are woven of two fields, and whether the one with the even rows is the first.
    default_size
        Index of the usual one of its sizes.
    """

    index: int
    encoding: str | None
    code: str
    interlaced: bool
    top_first: bool
    default_size: int
    sizes: tuple[StreamSize, ...]


@dataclass(frozen=True, slots=True)
class Alternate:
    """A setting of a streaming interface, with the endpoint that it sends from."""

    number: int
    endpoint: int
    kind: TransferKind
    packet_bytes: int


@dataclass(slots=True)
class VideoStream:
    """A streaming interface."""

    interface: int
    formats: list[StreamFormat] = field(default_factory=list)
    alternates: list[Alternate] = field(default_factory=list)

    @property
    def bulk(self) -> Alternate | None:
        """The setting in which it sends in bulk."""
        return next((a for a in self.alternates if a.kind is TransferKind.BULK), None)


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit or terminal with settings; id 0 is none. `controls` has a bit for each that it knows."""

    id: int = 0
    controls: int = 0


@dataclass(slots=True)
class VideoFunction:
    """A camera or grabber: its control interface and its streams.

    Attributes
    ----------
    version
        Of the class definition, binary coded: 0x0110 is 1.1.
    clock_hz
        Of the times in payload headers; 0 where they tell nothing.
    terminals
        Types of its input terminals (table B-2 and B-3), by their ids.
    camera, processing
        The terminal of its camera, where it has one, and the unit that works on its picture.
    selector, pins
        Id of the unit that switches between inputs, and the ids that lead to it; 0 where there is none.
    """

    control_interface: int
    version: int = 0
    clock_hz: int = 0
    terminals: dict[int, int] = field(default_factory=dict)
    camera: Unit = field(default_factory=Unit)
    processing: Unit = field(default_factory=Unit)
    selector: int = 0
    pins: tuple[int, ...] = ()
    streams: list[VideoStream] = field(default_factory=list)


def video_functions(configuration: bytes) -> list[VideoFunction]:
    """Find the video functions in a configuration descriptor, as far as it can be read."""
    reader = _Reader()
    for descriptor in _descriptors(configuration):
        reader.take(descriptor)
    return reader.functions


def _descriptors(raw: bytes) -> Iterator[bytes]:
    at = 0
    while at + 2 <= len(raw) and 2 <= raw[at] <= len(raw) - at:
        yield raw[at : at + raw[at]]
        at += raw[at]


class _Reader:
    """Goes through descriptors in their order: each belongs to the interface before it."""

    def __init__(self) -> None:
        self.functions: list[VideoFunction] = []
        self._interface: tuple[int, int] = (0, 0)
        self._alternate = 0
        self._stream: VideoStream | None = None
        self._format: StreamFormat | None = None

    def take(self, d: bytes) -> None:
        kind = d[1]
        if kind == INTERFACE and len(d) >= 9:
            self._begin_interface(number=d[2], alternate=d[3], of_class=(d[5], d[6]))
        elif kind == ENDPOINT and len(d) >= 6 and self._stream is not None:
            self._add_endpoint(self._stream, d)
        elif kind == CLASS_INTERFACE and len(d) >= 3 and self.functions:
            if self._interface == (VIDEO_CLASS, CONTROL):
                _add_unit(self.functions[-1], d)
            elif self._stream is not None:
                self._add_format(self._stream, d)

    def _begin_interface(self, number: int, alternate: int, of_class: tuple[int, int]) -> None:
        self._interface, self._alternate, self._stream, self._format = of_class, alternate, None, None
        if of_class == (VIDEO_CLASS, CONTROL) and alternate == 0:
            self.functions.append(VideoFunction(number))
        if of_class == (VIDEO_CLASS, STREAMING) and self.functions:
            streams = self.functions[-1].streams
            self._stream = next((s for s in streams if s.interface == number), None)
            if self._stream is None:
                self._stream = VideoStream(number)
                streams.append(self._stream)

    def _add_endpoint(self, stream: VideoStream, d: bytes) -> None:
        kind = {1: TransferKind.ISOCHRONOUS, 2: TransferKind.BULK}.get(d[3] & 3)
        packet_bytes = _u16(d, 4) & 0x7FF
        if kind is not None and d[2] & DIRECTION_IN and packet_bytes:
            stream.alternates.append(Alternate(self._alternate, d[2], kind, packet_bytes))

    def _add_format(self, stream: VideoStream, d: bytes) -> None:
        made = _format_of(d)
        if made is not None:
            stream.formats.append(made)
            self._format = made
            return
        size = _size_of(d)
        if size is not None and self._format is not None:
            before = self._format
            self._format = stream.formats[-1] = _with_size(before, size)


def _with_size(f: StreamFormat, size: StreamSize) -> StreamFormat:
    return StreamFormat(f.index, f.encoding, f.code, f.interlaced, f.top_first, f.default_size, (*f.sizes, size))


def _add_unit(function: VideoFunction, d: bytes) -> None:
    """Read a header, an input terminal, a selector or a processing unit (tables 3-3, 3-4, 3-6, 3-7 and 3-8)."""
    if d[2] == 0x01 and len(d) >= 11:
        function.version, function.clock_hz = _u16(d, 3), _u32(d, 7)
    elif d[2] == 0x02 and len(d) >= 6:
        function.terminals[d[3]] = _u16(d, 4)
        if _u16(d, 4) == CAMERA_TERMINAL:
            function.camera = _unit(d, 14)
    elif d[2] == 0x04 and len(d) >= 5 and d[4] and len(d) >= 5 + d[4]:
        function.selector, function.pins = d[3], tuple(d[5 : 5 + d[4]])
    elif d[2] == 0x05:
        function.processing = _unit(d, 7)


def _unit(d: bytes, at: int) -> Unit:
    """Read what settings a unit has: their number of bytes stands at `at`, one bit each behind it."""
    if len(d) <= at or len(d) < at + 1 + d[at]:
        return Unit()
    return Unit(d[3], int.from_bytes(d[at + 1 : at + 1 + d[at]], "little"))


def _format_of(d: bytes) -> StreamFormat | None:
    """Read an uncompressed, MJPEG or frame-based format (table 3-1 of their payload documents)."""
    if d[2] == 0x04 and len(d) >= 26:
        known = ENCODING_OF_CODE.get(d[5:9]) if d[9:21] == GUID_TAIL or d[5] == 0x32 else None
        return _format(d, known, _code(d), default=d[22], flags=d[25])
    if d[2] == 0x06 and len(d) >= 10:
        return _format(d, "MJPG", "MJPG", default=d[6], flags=d[9])
    if d[2] == 0x10 and len(d) >= 26:
        return _format(d, None, f"{_code(d)} ({FRAME_BASED})", default=d[22], flags=d[25])
    return None


def _format(d: bytes, encoding: str | None, code: str, *, default: int, flags: int) -> StreamFormat:
    interlaced = bool(flags & 1) and not flags & 2  # bit 1: one field a frame, of which the sizes tell nothing
    return StreamFormat(d[3], encoding, code, interlaced, bool(flags & 4), default, ())


def _code(d: bytes) -> str:
    text = d[5:9].decode("ascii", "replace").strip()
    return text if text.isalnum() and text.isascii() else d[5:21].hex()


def _size_of(d: bytes) -> StreamSize | None:
    """Read the size of an uncompressed or MJPEG frame (table 3-2 of their payload documents)."""
    if d[2] not in (0x05, 0x07) or len(d) < 26:
        return None
    width, height, default = _u16(d, 5), _u16(d, 7), _u32(d, 21)
    continuous = d[25] == 0
    count = min(3 if continuous else d[25], (len(d) - 26) // 4)
    intervals = [i for i in (_u32(d, 26 + 4 * n) for n in range(min(count, 2) if continuous else count)) if i]
    if not 0 < width <= MOST_PX or not 0 < height <= MOST_PX:
        return None
    usable = tuple(sorted(intervals)) or ((default,) if default else ())
    if not usable:
        return None
    return StreamSize(d[3], width, height, default or usable[0], usable, continuous)


def _u16(d: bytes, at: int) -> int:
    return int(struct.unpack_from("<H", d, at)[0])


def _u32(d: bytes, at: int) -> int:
    return int(struct.unpack_from("<I", d, at)[0])
