"""The firmware of a USB video grabber with four inputs: descriptors, requests and payloads, faults included."""

import struct
from dataclasses import dataclass, field

import cv2
import numpy as np

CLOCK_HZ = 48_000_000
BULK_ENDPOINT, PACKET_BYTES = 0x81, 512
GUID_TAIL = bytes.fromhex("00001000800000aa00389b71")
GUIDS = {"YUYV": b"YUY2", "UYVY": b"UYVY", "NV12": b"NV12", "GREY": b"Y800", "Y16": b"Y16 ", "H264": b"H264"}
SELECTOR_UNIT, PROCESSING_UNIT = 5, 6
SETTINGS = {(PROCESSING_UNIT, 2): (2, 0, 255, 1, 128)}
"""By entity and selector: bytes, minimum, maximum, step, default."""
BITS = {
    PROCESSING_UNIT: {1: 8, 2: 0, 3: 1, 4: 9, 6: 2, 7: 3, 11: 12},
    1: {2: 1, 3: 2, 4: 3, 6: 5, 8: 17},
}
"""Bits in bmControls, by entity and selector."""
STRINGS = ("Lab", "Fake UVC grabber")


class StallError(Exception):
    """A request that the device does not know."""


def noise(number: int, channel: int, size_px: tuple[int, int]) -> np.ndarray:
    """(height, width) uint8: what belongs to this frame of this input, and to no other."""
    width, height = size_px
    return np.random.default_rng([number, channel]).integers(0, 256, (height, width), np.uint8)


def numbered(number: int, channel: int, size_px: tuple[int, int]) -> np.ndarray:
    """The same, with the number and the input at its beginning, and smooth enough for a JPEG."""
    made = cv2.GaussianBlur(noise(number, channel, size_px), (0, 0), 2)
    made[0, :32] = np.unpackbits(np.array([number], ">u4").view(np.uint8)) * 255
    made[1, :8] = channel
    return made


def number_in(pixels: np.ndarray) -> tuple[int, int]:
    """Which frame, of which input, a numbered picture is."""
    return int(np.packbits(pixels[0, :32] > 127).view(">u4")[0]), int(pixels[1, 0])


def encoded(grey: np.ndarray, encoding: str) -> bytes:
    """The bytes of a picture as the class sends them: without padding."""
    if encoding == "MJPG":
        return cv2.imencode(".jpg", cv2.GaussianBlur(grey, (0, 0), 3))[1].tobytes()
    if encoding in ("YUYV", "UYVY"):
        both = np.full((*grey.shape, 2), 128, np.uint8)
        both[..., int(encoding == "UYVY")] = grey
        return both.tobytes()
    if encoding == "Y16":
        return (grey.astype("<u2") * 257).tobytes()
    chroma = np.full(grey.size // 2 if encoding == "NV12" else 0, 128, np.uint8)
    return grey.tobytes() + chroma.tobytes()


def descriptor(kind: int, *parts) -> bytes:
    """A descriptor, its length put before it; a pair is a value and the number of its bytes."""
    body = b"".join(
        p if isinstance(p, bytes) else bytes([p]) if isinstance(p, int) else p[0].to_bytes(p[1], "little")
        for p in parts
    )
    return bytes([len(body) + 2, kind]) + body


@dataclass(eq=False)
class FakeUvcDevice:
    """A grabber; what it does wrong is said in `faults`, by the number of the frame since it streams.

    Faults: err (the ERR bit), short (half of the frame), long (more than a frame), no_eof, no_toggle (of the frame
    identifier), headerless (a payload without a header), empty (headers alone), junk (no JPEG), no_times (garbage).
    """

    encodings: tuple[str, ...] = ("YUYV", "MJPG")
    sizes: tuple[tuple[int, int], ...] = ((64, 48), (32, 24))
    intervals: tuple[int, ...] = (400_000, 800_000)
    continuous: bool = False
    inputs: int = 4
    serial: str | None = "SN1"
    bulk: bool = True
    alternate: int = 0
    version: int = 0x0110
    interlace: int = 0
    clock_hz: int = CLOCK_HZ
    payload_bytes: int = 3072
    header_bytes: int = 12
    picture: object = noise
    settings_there: dict = field(default_factory=lambda: dict(SETTINGS))
    camera: bool = False
    """Whether its first input is a camera, with settings of its own."""
    faults: dict = field(default_factory=dict)
    refused: set = field(default_factory=set)
    """Requests that it stalls, as (interface, entity, selector)."""
    grants: dict = field(default_factory=dict)
    """What it answers to a probe, whatever was asked: format, size, interval, frame_bytes, payload_bytes."""

    def __post_init__(self):
        self.streaming = False
        self.channel = 1
        self.values = {place: usual for place, (*_, usual) in self.settings_there.items()}
        self.commits = 0
        self.settings = {"format": 1, "size": 1, "interval": self.intervals[0]}
        self.fid = 0

    # -- descriptors ---------------------------------------------------------------------------------------------------

    def device_descriptor(self) -> bytes:
        strings = (1, 2, 3 if self.serial else 0)
        return descriptor(1, (0x200, 2), 0xEF, 2, 1, 64, (0x1209, 2), (1, 2), (0x100, 2), *strings, 1)

    def string_descriptor(self, index: int) -> bytes:
        if index == 0:
            return descriptor(3, (0x0409, 2))
        texts = {1: STRINGS[0], 2: STRINGS[1], 3: self.serial}
        if not texts.get(index):
            raise StallError
        return descriptor(3, texts[index].encode("utf-16le"))

    def configuration_descriptor(self) -> bytes:
        association = descriptor(0x0B, 0, 2, 0x0E, 3, 0, 0)
        body = association + self._control_interface() + self._streaming_interface()
        return descriptor(2, (9 + len(body), 2), 2, 1, 0, 0x80, 250) + body

    def _control_interface(self) -> bytes:
        terminals = b"".join(descriptor(0x24, 2, n + 1, (0x0401, 2), 0, 0) for n in range(self.camera, self.inputs))
        if self.camera:
            terminals += descriptor(0x24, 2, 1, (0x0201, 2), 0, 0, *[0] * 6, 3, (self._bits(1), 3))
        selector = descriptor(0x24, 4, SELECTOR_UNIT, self.inputs, *range(1, self.inputs + 1), 0)
        processing = descriptor(0x24, 5, PROCESSING_UNIT, SELECTOR_UNIT, (0, 2), 2, (self._bits(PROCESSING_UNIT), 2), 0)
        if self.version >= 0x0110:
            processing = descriptor(
                0x24, 5, PROCESSING_UNIT, SELECTOR_UNIT, (0, 2), 2, (self._bits(PROCESSING_UNIT), 2), 0, 0
            )
        units = terminals + selector + processing + descriptor(0x24, 3, 7, (0x0101, 2), 0, PROCESSING_UNIT, 0)
        header = descriptor(0x24, 1, (self.version, 2), (13 + len(units), 2), (self.clock_hz, 4), 1, 1)
        return descriptor(4, 0, 0, 0, 0x0E, 1, 0, 0) + header + units

    def _bits(self, entity: int) -> int:
        return sum(1 << BITS[entity][selector] for e, selector in self.settings_there if e == entity)

    def _streaming_interface(self) -> bytes:
        formats = b"".join(self._format(n + 1, e) for n, e in enumerate(self.encodings))
        total = 13 + len(self.encodings) + len(formats)
        header = descriptor(
            0x24, 1, len(self.encodings), (total, 2), BULK_ENDPOINT, 0, 7, 0, 0, 0, 1, *[0] * len(self.encodings)
        )
        endpoint = descriptor(5, BULK_ENDPOINT, 2, (PACKET_BYTES, 2), 0)
        if not self.bulk:
            endpoint = descriptor(5, BULK_ENDPOINT, 5, (0x1400, 2), 1)
        number = self.alternate or (0 if self.bulk else 1)
        first = descriptor(4, 1, 0, int(not number), 0x0E, 2, 0, 0) + header + formats
        return first + (descriptor(4, 1, number, 1, 0x0E, 2, 0, 0) if number else b"") + endpoint

    def _format(self, index: int, encoding: str) -> bytes:
        sizes = b"".join(self._size(7 if encoding == "MJPG" else 5, n + 1, s) for n, s in enumerate(self.sizes))
        color = descriptor(0x24, 0x0D, 1, 1, 4)
        if encoding == "MJPG":
            return descriptor(0x24, 6, index, len(self.sizes), 1, 1, 0, 0, self.interlace, 0) + sizes + color
        guid = GUIDS[encoding] + GUID_TAIL
        kind = 0x10 if encoding == "H264" else 4
        return descriptor(0x24, kind, index, len(self.sizes), guid, 16, 1, 0, 0, self.interlace, 0) + sizes + color

    def _size(self, subtype: int, index: int, size: tuple[int, int]) -> bytes:
        width, height = size
        steps = (self.intervals[0], self.intervals[-1], 1) if self.continuous else self.intervals
        count = 0 if self.continuous else len(self.intervals)
        numbers = [(v, 4) for v in (1, 1 << 30, width * height * 2, self.intervals[0])]
        return descriptor(0x24, subtype, index, 0, (width, 2), (height, 2), *numbers, count, *[(i, 4) for i in steps])

    # -- requests ------------------------------------------------------------------------------------------------------

    def request(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes:
        """Answer a control request; raises StallError."""
        if (kind, request) == (0x80, 6):
            return self._descriptor(value >> 8, value & 0xFF)[:length]
        if (kind, request) == (0x80, 0):
            return bytes(2)[:length]
        if (kind, request) in {(0x00, 9), (0x00, 5), (0x01, 11)}:
            return b""
        if (kind, request) == (0x02, 1):
            self.streaming = False
            return b""
        if kind in (0x21, 0xA1):
            return self._class_request(request, index & 0xFF, index >> 8, value >> 8, data)[:length]
        raise StallError

    def _descriptor(self, kind: int, index: int) -> bytes:
        if kind == 1:
            return self.device_descriptor()
        if kind == 2:
            return self.configuration_descriptor()
        if kind == 3:
            return self.string_descriptor(index)
        raise StallError

    def _class_request(self, request: int, interface: int, entity: int, selector: int, data: bytes) -> bytes:
        if (interface, entity, selector) in self.refused:
            raise StallError
        if (interface, entity) == (1, 0) and selector in (1, 2):
            return self._negotiate(request, selector, data)
        if (interface, entity, selector) == (0, SELECTOR_UNIT, 1):
            if request == 1:
                self.channel = data[0]
            return self._about(request, 1, 1, self.inputs, 1, 1, self.channel)
        if interface == 0 and (entity, selector) in self.values:
            size, *limits = self.settings_there[entity, selector]
            if request == 1:
                self.values[entity, selector] = int.from_bytes(data, "little", signed=limits[0] < 0)
            return self._about(request, size, *limits, self.values[entity, selector])
        raise StallError

    def _about(self, request: int, size: int, least: int, most: int, step: int, usual: int, now: int) -> bytes:
        """Answer a request about a setting."""
        if request == 1:
            return b""
        if request == 0x85:
            return size.to_bytes(2, "little")
        answers = {0x81: now, 0x82: least, 0x83: most, 0x84: step, 0x86: 3, 0x87: usual}
        if request not in answers:
            raise StallError
        return answers[request].to_bytes(1 if request == 0x86 else size, "little", signed=least < 0)

    def _negotiate(self, request: int, selector: int, data: bytes) -> bytes:
        if request == 1:
            _, chosen, size, interval = struct.unpack_from("<HBBI", data)
            self.settings = {"format": chosen or 1, "size": size or 1, "interval": interval or self.intervals[0]}
            if selector == 2:
                self.commits += 1
                self.streaming = self.bulk
                self.fid = 0
            return b""
        if request == 0x85:
            return len(self._granted()).to_bytes(2, "little")
        return b"\x03" if request == 0x86 else self._granted()

    def _granted(self) -> bytes:
        width, height = self.size_px
        g = self.settings | {"frame_bytes": 2 * width * height, "payload_bytes": self.payload_bytes} | self.grants
        head = struct.pack("<HBBI", 1, g["format"], g["size"], g["interval"])
        made = head + bytes(10) + struct.pack("<III", g["frame_bytes"], g["payload_bytes"], self.clock_hz)
        return made.ljust(26 if self.version < 0x110 else 34 if self.version < 0x150 else 48, b"\0")[: g.get("length")]

    # -- frames --------------------------------------------------------------------------------------------------------

    @property
    def size_px(self) -> tuple[int, int]:
        return self.sizes[(self.settings["size"] - 1) % len(self.sizes)]

    @property
    def encoding(self) -> str:
        return self.encodings[(self.settings["format"] - 1) % len(self.encodings)]

    @property
    def period_ns(self) -> int:
        return self.settings["interval"] * 100

    def payloads(self, number: int, captured_ns: int, sent_ns: int) -> list[bytes]:
        """The payloads of a frame."""
        fault = self.faults.get(number)
        data = encoded(self.picture(number, self.channel - 1, self.size_px), self.encoding)
        extra = {"short": data[: len(data) // 2], "long": data + data[:99], "empty": b""}
        data = extra.get(fault, b"\xff\xd8\xff" + b"?" * 200 if fault == "junk" else data)
        room = self.payload_bytes - self.header_bytes
        parts = [data[at : at + room] for at in range(0, len(data), room)] or [b""]
        made = [self._header(fault, n == len(parts) - 1, captured_ns, sent_ns) + part for n, part in enumerate(parts)]
        if fault == "headerless":
            made[len(made) // 2] = b"\0" + made[len(made) // 2][1:]
        self.fid ^= fault != "no_toggle"
        return made

    def _header(self, fault: str | None, last: bool, captured_ns: int, sent_ns: int) -> bytes:
        bits = 0x80 | self.fid | (0x02 if last and fault != "no_eof" else 0) | (0x40 if fault == "err" else 0)
        captured, sent = (t * self.clock_hz // 10**9 & 0xFFFFFFFF for t in (captured_ns, sent_ns))
        if fault == "no_times":
            captured, sent = 0xDEADBEEF, 7
        if self.header_bytes < 12:
            return bytes([self.header_bytes, bits]).ljust(self.header_bytes, b"\0")
        head = struct.pack("<BBIIH", 12, bits | 0x0C, captured, sent, sent_ns // 1_000_000 & 0x7FF)
        return bytes([self.header_bytes]) + head[1:] + bytes(self.header_bytes - 12)
