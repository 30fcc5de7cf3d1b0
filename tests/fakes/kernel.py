"""A kernel at the system-call edge, with video devices that do what real ones were seen to do, faults included."""

import errno
import mmap
import os
import select
from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np

from drivers.sequence import SEQUENCE_NUMBERS
from drivers.v4l2.constants import (
    BufferFlag,
    CapabilityFlag,
    ControlFlag,
    ControlId,
    ControlType,
    FieldOrder,
    InputCapability,
    SizeType,
    StandardBits,
    fourcc,
    fourcc_text,
)
from drivers.v4l2.grabber import V4l2Grabber
from drivers.v4l2.structs import BtTimings, DvTimings, Fraction, QueryControl, Rectangle, Request

ANALOGUE = StandardBits.NTSC | StandardBits.PAL | StandardBits.SECAM
ALL_FIELDS = frozenset(FieldOrder) - {FieldOrder.ANY, FieldOrder.SEQ_TB, FieldOrder.SEQ_BT}
PROGRESSIVE = frozenset({FieldOrder.NONE})
WOVEN_ONLY = frozenset({FieldOrder.NONE, FieldOrder.INTERLACED})
SINGLE = {FieldOrder.TOP, FieldOrder.BOTTOM, FieldOrder.ALTERNATE}


def picture(sequence: int, channel: int = 0, size=(48, 64)) -> np.ndarray:
    """(height, width) uint8: noise that belongs to this frame of this input, and to no other."""
    return np.random.default_rng([sequence, channel]).integers(0, 256, size, np.uint8)


def encode(grey: np.ndarray, encoding: str, stride: int) -> bytes:
    """The bytes that a device sends for an 8-bit picture; deeper formats hold 4, 16 or 257 times its values."""
    height, width = grey.shape
    if encoding in ("MJPG", "JPEG"):
        smooth = cv2.GaussianBlur(grey, (0, 0), 3)
        return cv2.imencode(".jpg", smooth)[1].tobytes()
    lines = np.full((height, stride), 7, np.uint8)
    if encoding in ("GREY", "NV12"):
        lines[:, :width] = grey
    elif encoding in ("YUYV", "UYVY"):
        lines[:, encoding == "UYVY" : 2 * width : 2] = grey
    else:
        deep = grey.astype(np.uint16) * {"Y10": 4, "Y12": 16}.get(encoding, 257)
        lines[:, : 2 * width] = deep.astype(">u2" if encoding.endswith("-BE") else "<u2").view(np.uint8)
    chroma = np.full(height // 2 * stride if encoding == "NV12" else 0, 128, np.uint8)
    return lines.tobytes() + chroma.tobytes()


def timings(width: int, height: int, rate_hz: float, *, interlaced: bool = False) -> DvTimings:
    made = DvTimings()
    clock = round(rate_hz * (width + 160) * (height + 45))
    made.timings.bt = BtTimings(
        width=width, height=height, interlaced=interlaced, pixelclock=clock, hsync=160, vsync=45
    )
    return made


@dataclass
class FakeInput:
    name: str
    std: int = ANALOGUE
    status: int = 0
    timings: DvTimings | int | None = None
    """Of a digital input's signal, or the errno that asking for it gives."""
    changes: int = 0
    """Source changes that wait to be told."""


def setting(
    id_: int, name: str, low=0, high=255, step=1, default=128, kind=ControlType.INTEGER, flags=0, items=None
) -> QueryControl:
    query = QueryControl(id_, kind, name.encode(), low, high, step, default, flags)
    query.items = items or {}
    return query


USUAL_CONTROLS = (
    setting(ControlId.BRIGHTNESS, "Brightness"),
    setting(ControlId.CONTRAST, "Contrast", default=32),
    setting(ControlId.SATURATION, "Saturation"),
    setting(ControlId.HUE, "Hue", low=-128, high=127, default=0),
)


@dataclass(eq=False)
class Buffer:
    memory: mmap.mmap
    used: int = 0
    flags: int = 0
    field: int = FieldOrder.NONE
    stamp_ns: int = 0
    sequence: int = 0


@dataclass(eq=False)
class FakeDevice:
    """A capture device; what it does wrong is said in `faults`, by the number of frames since it streams.

    Faults: drop (numbered, never delivered), uncounted (neither), error (flagged), short (half a buffer), empty,
    junk (bytes that are no JPEG), eio (a fatal error until stopped), hang (no frame any more until stopped), gone
    (unplugged), fieldless (does not say which field it is), spurious (poll says that there is a frame, there is none).
    """

    inputs: list[FakeInput] = field(default_factory=lambda: [FakeInput(f"S-Video {i}") for i in range(4)])
    encodings: tuple[str, ...] = ("GREY", "YUYV")
    size: tuple[int, int] = (64, 48)
    most: tuple[int, int] = (64, 48)
    fields: frozenset = ALL_FIELDS
    standard: int = int(StandardBits.PAL)
    rate_hz: float = 25.0
    controls: tuple = USUAL_CONTROLS
    stops_to_switch: bool = True
    padding: int = 0
    """Bytes between lines."""
    ahead_ns: int = 0
    stamp_flags: int = int(BufferFlag.TIMESTAMP_MONOTONIC)
    first_sequence: int = 0
    capabilities: int = CapabilityFlag.VIDEO_CAPTURE | CapabilityFlag.STREAMING
    lacks: frozenset = frozenset()
    fails: dict = field(default_factory=dict)
    """Requests that fail, and the errno with which."""
    refuses_control: dict = field(default_factory=dict)
    faults: dict = field(default_factory=dict)
    selections: dict = field(default_factory=dict)
    """Rectangles left by another program, by target: 0 crop, 0x100 compose."""

    def __post_init__(self):
        self.timings = {i: timings(640, 480, 60) for i in range(len(self.inputs))}
        self.values = {c.id: c.default_value for c in self.controls}
        self.channel, self.field, self.encoding = 0, FieldOrder.ANY, self.encodings[0]
        self.gone = self.broken = False
        self.owner = None
        self.buffers: list[Buffer] = []
        self.mapped: list[mmap.mmap] = []
        self.streaming_since_ns = None
        self.numbered = 0
        self.requests = []
        self._idle()

    # -- streaming -----------------------------------------------------------------------------------------------------

    def _idle(self):
        self.streaming_since_ns = None
        self.broken = False
        self.hung = self.spurious = False
        self.queued: deque[int] = deque()
        self.done: deque[int] = deque()
        self.ticks = self.skipped = 0

    @property
    def input(self) -> FakeInput:
        return self.inputs[self.channel]

    @property
    def period_ns(self) -> int:
        return round(1e9 / self.rate_hz)

    @property
    def tick_ns(self) -> int:
        return self.period_ns // 2 if self.field is FieldOrder.ALTERNATE else self.period_ns

    def next_ns(self) -> int | None:
        if self.streaming_since_ns is None or self.hung or self.broken or self.gone:
            return None
        return self.streaming_since_ns + (self.ticks + 1) * self.tick_ns

    def catch_up(self, now_ns: int):
        while (due_ns := self.next_ns()) is not None and due_ns <= now_ns:
            self._tick(due_ns)

    def _tick(self, due_ns: int):
        number, second = divmod(self.ticks, 2) if self.field is FieldOrder.ALTERNATE else (self.ticks, 0)
        fault = self.faults.get(number)
        if fault in ("gone", "eio", "hang"):
            del self.faults[number]
            self.gone, self.broken, self.hung = fault == "gone", fault == "eio", fault == "hang"
            return
        self.ticks += 1
        self.skipped += fault == "uncounted" and not second
        self.spurious = fault == "spurious"
        if fault in ("drop", "uncounted", "spurious") or not self.queued:
            return
        index = self.queued.popleft()
        self._fill(self.buffers[index], number, second, due_ns, fault)
        self.done.append(index)

    def _fill(self, buffer: Buffer, number: int, second: int, due_ns: int, fault: str | None):
        width, height = self.size
        single, order = self.field in SINGLE, (FieldOrder.TOP, FieldOrder.BOTTOM)
        if self.field is FieldOrder.ALTERNATE:
            buffer.field = order[second ^ bool(self.standard & StandardBits.LINES_525)]
        else:
            buffer.field = self.field
        grey = picture(number, self.channel, (height * (2 if single else 1), width))
        if single:
            grey = grey[int(buffer.field == FieldOrder.BOTTOM) :: 2]
        data = encode(grey, self.encoding, self.stride)
        data = {"short": data[: len(data) // 2], "empty": b"", "junk": b"\xff\xd8\xff" + b"?" * 200}.get(fault, data)
        buffer.memory[: len(data)] = data
        buffer.used, buffer.stamp_ns = len(data), due_ns + self.ahead_ns
        buffer.sequence = (self.first_sequence + number - self.skipped) % SEQUENCE_NUMBERS
        buffer.flags = self.stamp_flags | (BufferFlag.ERROR if fault == "error" else 0)
        if fault == "fieldless":
            buffer.field = FieldOrder.ANY

    @property
    def stride(self) -> int:
        per_px = 1 if self.encoding in ("GREY", "NV12", "MJPG", "JPEG") else 2
        return self.size[0] * per_px + self.padding

    # -- requests ------------------------------------------------------------------------------------------------------

    def answer(self, fd: int, request: Request, a, now_ns: int):
        if self.gone:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        self.requests.append(request)
        if request in self.fails:
            raise OSError(self.fails[request], os.strerror(self.fails[request]))
        if request in self.lacks:
            self._refuse(errno.ENOTTY)
        self.catch_up(now_ns)
        getattr(self, f"_{request.name.lower()}")(fd, a, now_ns)

    def _refuse(self, number: int):
        raise OSError(number, os.strerror(number))

    def _check(self, ok: bool, number: int = errno.EINVAL):
        if not ok:
            self._refuse(number)

    def _querycap(self, fd, a, now_ns):
        a.driver, a.card, a.bus_info = b"fake", b"Fake grabber", b"platform:fake"
        a.capabilities, a.device_caps = self.capabilities | CapabilityFlag.DEVICE_CAPS, self.capabilities

    def _enum_fmt(self, fd, a, now_ns):
        self._check(a.index < len(self.encodings))
        a.pixelformat = fourcc(self.encodings[a.index])

    def _enum_framesizes(self, fd, a, now_ns):
        self._check(a.index == 0)
        a.type = SizeType.DISCRETE
        a.size.min_width, a.size.max_width = self.most

    def _enum_frameintervals(self, fd, a, now_ns):
        self._check(a.index == 0)
        a.type, a.shortest = SizeType.DISCRETE, Fraction(1, round(self.rate_hz))

    def _g_fmt(self, fd, a, now_ns):
        pix = a.fmt.pix
        pix.width, pix.height = self.size
        pix.pixelformat, pix.field, pix.bytesperline = fourcc(self.encoding), self.field, self.stride
        pix.sizeimage = self.stride * pix.height

    def _s_fmt(self, fd, a, now_ns):
        self._check(self.owner is None, errno.EBUSY)
        pix = a.fmt.pix
        asked, usual = FieldOrder(pix.field), FieldOrder.INTERLACED if self.input.std else FieldOrder.NONE
        order = usual if asked is FieldOrder.ANY else asked
        self.field = order if order in self.fields else next(f for f in (usual, FieldOrder.NONE) if f in self.fields)
        most = self.most
        if self.input.timings is not None:
            most = (self.timings[self.channel].timings.bt.width, self.timings[self.channel].timings.bt.height)
        tallest = most[1] // 2 if self.field in SINGLE else most[1]
        self.size = min(pix.width or most[0], most[0]), min(pix.height or tallest, tallest)
        name = fourcc_text(pix.pixelformat)
        self.encoding = name if name in self.encodings else self.encodings[0]
        self._g_fmt(fd, a, now_ns)

    def _g_selection(self, fd, a, now_ns):
        self._check(a.target in (0, 0x100, 1, 0x101))
        whole = (0, 0, *(self.most if a.target < 0x100 else self.size))
        a.r = Rectangle(*(self.selections.get(a.target, whole)))

    def _s_selection(self, fd, a, now_ns):
        self._check(self.owner is None, errno.EBUSY)
        self.selections[a.target] = (a.r.left, a.r.top, a.r.width, a.r.height)

    def _g_parm(self, fd, a, now_ns):
        a.parm.capture.timeperframe = Fraction(1_000_000, round(1_000_000 * self.rate_hz))

    def _s_parm(self, fd, a, now_ns):
        period = a.parm.capture.timeperframe
        self.rate_hz = min(25.0, period.denominator / period.numerator)
        self._g_parm(fd, a, now_ns)

    def _enuminput(self, fd, a, now_ns):
        self._check(a.index < len(self.inputs))
        chosen = self.inputs[a.index]
        a.name, a.type, a.std, a.status = chosen.name.encode(), 2, chosen.std, chosen.status
        a.capabilities = InputCapability.STD if chosen.std else 0
        if chosen.timings is not None:
            a.capabilities = InputCapability.DV_TIMINGS

    def _g_input(self, fd, a, now_ns):
        a.value = self.channel

    def _s_input(self, fd, a, now_ns):
        self._check(self.owner is None or not self.stops_to_switch, errno.EBUSY)
        self.channel = a.value

    def _g_std(self, fd, a, now_ns):
        self._check(bool(self.input.std), errno.ENODATA)
        a.value = self.standard

    def _s_std(self, fd, a, now_ns):
        self._check(self.owner is None or not self.stops_to_switch, errno.EBUSY)
        self._check(bool(self.input.std & a.value))
        self.standard = a.value

    def _querystd(self, fd, a, now_ns):
        self._check(bool(self.input.std), errno.ENODATA)
        a.value = 0 if self.input.status else self.standard

    def _g_dv_timings(self, fd, a, now_ns):
        self._check(self.input.timings is not None, errno.ENODATA)
        a.timings.bt = self.timings[self.channel].timings.bt

    def _query_dv_timings(self, fd, a, now_ns):
        self._check(self.input.timings is not None, errno.ENODATA)
        if isinstance(self.input.timings, int):
            self._refuse(self.input.timings)
        a.timings.bt = self.input.timings.timings.bt

    def _s_dv_timings(self, fd, a, now_ns):
        self._check(self.owner is None, errno.EBUSY)
        self.timings[self.channel] = DvTimings.from_buffer_copy(a)

    def _queryctrl(self, fd, a, now_ns):
        after = a.id & ~ControlFlag.NEXT_CTRL
        found = next((c for c in sorted(self.controls, key=lambda c: c.id) if c.id > after), None)
        self._check(found is not None)
        for name, *_ in QueryControl._fields_:
            setattr(a, name, getattr(found, name))

    def _control(self, id_: int) -> QueryControl:
        self._check(id_ in self.values)
        return next(c for c in self.controls if c.id == id_)

    def _querymenu(self, fd, a, now_ns):
        item = self._control(a.id).items.get(a.index)
        self._check(item is not None)
        if isinstance(item, int):
            a.item.value = item
        else:
            a.item.name = item.encode()

    def _g_ctrl(self, fd, a, now_ns):
        self._control(a.id)
        a.value = self.values[a.id]

    def _s_ctrl(self, fd, a, now_ns):
        if a.id in self.refuses_control:
            self._refuse(self.refuses_control[a.id])
        c = self._control(a.id)
        self._check(c.minimum <= a.value <= c.maximum, errno.ERANGE)
        self.values[a.id] = a.value

    def _subscribe_event(self, fd, a, now_ns):
        pass

    def _dqevent(self, fd, a, now_ns):
        self._check(self.input.changes > 0, errno.ENOENT)
        self.input.changes -= 1
        a.type = 5

    # -- buffers -------------------------------------------------------------------------------------------------------

    def _reqbufs(self, fd, a, now_ns):
        self._check(self.owner in (None, fd), errno.EBUSY)
        self._idle()
        size = max(self.stride * self.size[1] * 2, 4096)
        self.buffers = [Buffer(mmap.mmap(-1, size)) for _ in range(a.count)]
        self.owner = fd if self.buffers else None

    def _querybuf(self, fd, a, now_ns):
        self._check(a.index < len(self.buffers))
        a.length, a.m.offset = len(self.buffers[a.index].memory), a.index * 4096

    def _qbuf(self, fd, a, now_ns):
        self._check(a.index not in self.queued)
        self.queued.append(a.index)

    def _dqbuf(self, fd, a, now_ns):
        self.spurious = False
        self._check(self.streaming_since_ns is not None)
        self._check(not self.broken, errno.EIO)
        self._check(bool(self.done), errno.EAGAIN)
        a.index = self.done.popleft()
        b = self.buffers[a.index]
        a.bytesused, a.flags, a.field, a.sequence = b.used, b.flags, b.field, b.sequence
        a.timestamp.tv_sec, a.timestamp.tv_usec = divmod(b.stamp_ns // 1000, 1_000_000)

    def _streamon(self, fd, a, now_ns):
        self._check(bool(self.buffers))
        self.streaming_since_ns = now_ns

    def _streamoff(self, fd, a, now_ns):
        self._idle()

    def poll(self) -> int:
        if self.gone:
            return select.POLLPRI | select.POLLERR | select.POLLHUP
        event = select.POLLPRI if self.input.changes else 0
        if self.broken:
            return event | select.POLLERR
        return event | (select.POLLIN if self.done or self.spurious else 0)


class FakeKernel:
    """System calls on fake devices; waiting moves the clock.

    Parameters
    ----------
    clock
        A ManualClock.
    devices
        By device node.
    """

    def __init__(self, clock, devices: dict[str, FakeDevice]):
        self.clock, self.devices = clock, devices
        self.refusals: dict[str, int] = {}
        """Nodes that cannot be opened, and the errno with which."""
        self.fds: dict[int, FakeDevice] = {}
        self._last_fd = 1000

    def open(self, path: str) -> int:
        if path in self.refusals or path not in self.devices or self.devices[path].gone:
            number = self.refusals.get(path, errno.ENOENT)
            raise OSError(number, os.strerror(number), path)
        self._last_fd += 1
        self.fds[self._last_fd] = self.devices[path]
        return self._last_fd

    def close(self, fd: int) -> None:
        device = self.fds.pop(fd)
        if device.owner == fd:
            device.owner = None
            device._idle()

    def ioctl(self, fd: int, request: int, argument) -> None:
        self.fds[fd].answer(fd, Request(request), argument, self.clock.now_ns)

    def mmap(self, fd: int, length: int, offset: int) -> mmap.mmap:
        memory = self.fds[fd].buffers[offset // 4096].memory
        assert length == len(memory)
        self.fds[fd].mapped.append(memory)
        return memory

    def poll(self, fd: int, timeout_s: float) -> int:
        device, deadline_ns = self.fds[fd], self.clock.now_ns + round(timeout_s * 1e9)
        while True:
            device.catch_up(self.clock.now_ns)
            if ready := device.poll():
                return ready
            next_ns = device.next_ns()
            if next_ns is None or next_ns > deadline_ns:
                self.clock.now_ns = deadline_ns
                return 0
            self.clock.now_ns = next_ns


def fake_grabber(clock, *, grabber=None, **device):
    """A grabber on a fake device, and that device; `grabber` holds its own arguments."""
    made = FakeDevice(**device)
    kernel = FakeKernel(clock, {"/dev/video0": made})
    return V4l2Grabber("/dev/video0", system=kernel, clock=clock, **(grabber or {})), made
