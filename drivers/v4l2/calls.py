"""Video4Linux2 as functions on an open device node, over system calls that a test can put a kernel of its own under."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import math
import mmap
import os
import select
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, Self, TypeAlias, TypeVar

from drivers.v4l2.constants import (
    EVENT_SOURCE_CHANGE,
    BufferType,
    CapabilityFlag,
    ControlFlag,
    ControlType,
    FieldOrder,
    SelectionTarget,
    SizeType,
)
from drivers.v4l2.structs import (
    Capability,
    ControlValue,
    DvTimings,
    Event,
    EventSubscription,
    Format,
    FormatDescription,
    Fraction,
    FrameInterval,
    FrameSize,
    InputDescription,
    MenuItem,
    PixFormat,
    QueryControl,
    Request,
    Selection,
    StreamParameters,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = [
    "LinuxCalls",
    "Node",
    "SystemCalls",
    "capabilities",
    "control_value",
    "controls",
    "dv_timings",
    "encodings",
    "frame_period_s",
    "frame_rates_hz",
    "frame_sizes",
    "input_index",
    "inputs",
    "menu",
    "pix_format",
    "query_dv_timings",
    "query_standard",
    "reset_selection",
    "select_input",
    "set_control",
    "set_dv_timings",
    "set_frame_period",
    "set_pix_format",
    "set_standard",
    "source_changes",
    "standard",
    "subscribe_source_change",
]

Argument: TypeAlias = ctypes.Structure | ctypes.c_int | ctypes.c_uint64
T = TypeVar("T", bound=Argument)

UNKNOWN = frozenset({errno.ENOTTY, errno.EINVAL, errno.ENODATA})
"""How drivers say that they lack a request, an index or, on this input, a standard or timings."""
MOST_ENTRIES = 1024
"""Where a list is cut off that a driver never ends."""


class SystemCalls(Protocol):
    """The edge to the kernel. What fails raises OSError with the kernel's errno."""

    def open(self, path: str) -> int:
        """Open a device node for reading and writing, not blocking; gives the descriptor."""
        ...

    def close(self, fd: int) -> None:
        """Close a descriptor."""
        ...

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        """Make a request; the answer is left in `argument`."""
        ...

    def mmap(self, fd: int, length: int, offset: int) -> mmap.mmap:
        """Map device memory."""
        ...

    def poll(self, fd: int, timeout_s: float) -> int:
        """Wait for a frame or an event; gives POLLIN, POLLPRI, POLLERR and POLLHUP as they apply, 0 when in vain."""
        ...


class LinuxCalls:
    """The kernel that this program runs on."""

    def open(self, path: str) -> int:
        """See `SystemCalls`."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self, fd: int) -> None:
        """See `SystemCalls`."""
        os.close(fd)

    def ioctl(self, fd: int, request: int, argument: Argument) -> None:
        """See `SystemCalls`. A signal does not break it off."""
        while True:
            with contextlib.suppress(InterruptedError):
                fcntl.ioctl(fd, request, argument, True)
                return

    def mmap(self, fd: int, length: int, offset: int) -> mmap.mmap:
        """See `SystemCalls`."""
        return mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset)

    def poll(self, fd: int, timeout_s: float) -> int:
        """See `SystemCalls`."""
        waiting = select.poll()
        waiting.register(fd, select.POLLIN | select.POLLPRI)
        ready = waiting.poll(math.ceil(timeout_s * 1000))
        return ready[0][1] if ready else 0


@dataclass(slots=True)
class Node:
    """An open device node."""

    system: SystemCalls
    path: str
    fd: int

    @classmethod
    def open(cls, system: SystemCalls, path: str) -> Self:
        """Open it; raises OSError."""
        return cls(system, path, system.open(path))

    def close(self) -> None:
        """Close it; nothing is raised for a device that is gone."""
        with contextlib.suppress(OSError):
            self.system.close(self.fd)

    def ask(self, request: Request, argument: T) -> T:
        """Make a request and give its argument back, filled in; raises OSError."""
        self.system.ioctl(self.fd, request, argument)
        return argument

    def ask_if_known(self, request: Request, argument: T) -> T | None:
        """As `ask`; None where the device has no such thing."""
        try:
            return self.ask(request, argument)
        except OSError as error:
            if error.errno in UNKNOWN:
                return None
            raise

    def listed(self, request: Request, entry: Callable[[int], T]) -> Iterator[T]:
        """Enumerate: the entries for index 0, 1, ... until the device has no more."""
        for index in range(MOST_ENTRIES):
            found = self.ask_if_known(request, entry(index))
            if found is None:
                return
            yield found


# -- the device, its inputs and their signals --------------------------------------------------------------------------


def capabilities(node: Node) -> tuple[Capability, CapabilityFlag]:
    """Who it is, and what this very node can do."""
    told = node.ask(Request.QUERYCAP, Capability())
    of_the_node = told.capabilities & CapabilityFlag.DEVICE_CAPS
    return told, CapabilityFlag(told.device_caps if of_the_node else told.capabilities)


def inputs(node: Node) -> list[InputDescription]:
    """Its video inputs; none where it knows no such thing."""
    return list(node.listed(Request.ENUMINPUT, lambda index: InputDescription(index=index)))


def input_index(node: Node) -> int:
    """Which input is in use."""
    chosen = node.ask_if_known(Request.G_INPUT, ctypes.c_int())
    return 0 if chosen is None else chosen.value


def select_input(node: Node, index: int) -> None:
    """Switch to an input."""
    node.ask(Request.S_INPUT, ctypes.c_int(index))


def standard(node: Node) -> int:
    """Television standard in use, as StandardBits; 0 where there is none."""
    chosen = node.ask_if_known(Request.G_STD, ctypes.c_uint64())
    return 0 if chosen is None else chosen.value


def set_standard(node: Node, bits: int) -> None:
    """Choose the television standard."""
    node.ask(Request.S_STD, ctypes.c_uint64(bits))


def query_standard(node: Node) -> int | None:
    """Standards that the signal may have, 0 for none; None where the device cannot tell."""
    found = node.ask_if_known(Request.QUERYSTD, ctypes.c_uint64())
    return None if found is None else found.value


def dv_timings(node: Node) -> DvTimings | None:
    """Timings in use; None where the input has none."""
    return node.ask_if_known(Request.G_DV_TIMINGS, DvTimings())


def query_dv_timings(node: Node) -> DvTimings | None:
    """Timings of the signal; None where the device cannot tell. ENOLINK is no signal, ENOLCK and ERANGE no lock."""
    return node.ask_if_known(Request.QUERY_DV_TIMINGS, DvTimings())


def set_dv_timings(node: Node, timings: DvTimings) -> None:
    """Choose the timings."""
    node.ask(Request.S_DV_TIMINGS, timings)


# -- formats -----------------------------------------------------------------------------------------------------------


def encodings(node: Node) -> list[int]:
    """Pixel formats on offer, as fourccs."""
    kind = BufferType.VIDEO_CAPTURE
    return [
        f.pixelformat for f in node.listed(Request.ENUM_FMT, lambda index: FormatDescription(index=index, type=kind))
    ]


def frame_sizes(node: Node, encoding: int) -> list[tuple[int, int]]:
    """Width and height of the pictures on offer, px; the least and the greatest where it takes all between them."""
    sizes: list[tuple[int, int]] = []
    for found in node.listed(Request.ENUM_FRAMESIZES, lambda index: FrameSize(index=index, pixel_format=encoding)):
        if found.type != SizeType.DISCRETE:
            s = found.size
            return [(s.min_width, s.min_height), (s.max_width, s.max_height)]
        sizes.append((found.size.min_width, found.size.max_width))  # a discrete size is the union's first two members
    return sizes


def frame_rates_hz(node: Node, encoding: int, size_px: tuple[int, int]) -> list[float]:
    """Frame rates on offer for a size, Hz, the fastest first; the fastest alone where it takes all below that."""
    width, height = size_px

    def entry(index: int) -> FrameInterval:
        return FrameInterval(index=index, pixel_format=encoding, width=width, height=height)

    rates = []
    for found in node.listed(Request.ENUM_FRAMEINTERVALS, entry):
        if found.shortest.numerator:
            rates.append(found.shortest.denominator / found.shortest.numerator)
        if found.type != SizeType.DISCRETE:
            break
    return sorted(rates, reverse=True)


def pix_format(node: Node) -> PixFormat:
    """Picture format in use."""
    found: PixFormat = node.ask(Request.G_FMT, Format(type=BufferType.VIDEO_CAPTURE)).fmt.pix
    return found


def set_pix_format(node: Node, size_px: tuple[int, int], encoding: int, field: FieldOrder) -> PixFormat:
    """Ask for a picture format; gives what was granted instead, as the device sees fit."""
    wish = Format(type=BufferType.VIDEO_CAPTURE)
    wish.fmt.pix.width, wish.fmt.pix.height = size_px
    wish.fmt.pix.pixelformat, wish.fmt.pix.field = encoding, field
    granted: PixFormat = node.ask(Request.S_FMT, wish).fmt.pix
    return granted


def reset_selection(node: Node, target: SelectionTarget, default: SelectionTarget) -> None:
    """Give a rectangle, of what is captured or of where that is put in the picture, its default."""
    kind = BufferType.VIDEO_CAPTURE
    in_use = node.ask_if_known(Request.G_SELECTION, Selection(type=kind, target=target))
    usual = node.ask_if_known(Request.G_SELECTION, Selection(type=kind, target=default))
    if in_use is not None and usual is not None and bytes(in_use.r) != bytes(usual.r):
        node.ask_if_known(Request.S_SELECTION, Selection(type=kind, target=target, r=usual.r))


def frame_period_s(node: Node) -> float | None:
    """Time from frame to frame, s; None where the device does not tell."""
    return _period_s(node.ask_if_known(Request.G_PARM, StreamParameters(type=BufferType.VIDEO_CAPTURE)))


def set_frame_period(node: Node, period_s: float) -> float | None:
    """Ask for a time from frame to frame; gives what was granted, None where it cannot be chosen."""
    wish = StreamParameters(type=BufferType.VIDEO_CAPTURE)
    wish.parm.capture.timeperframe = Fraction(round(period_s * 1e7), 10_000_000)
    return _period_s(node.ask_if_known(Request.S_PARM, wish))


def _period_s(told: StreamParameters | None) -> float | None:
    period = Fraction() if told is None else told.parm.capture.timeperframe
    return period.numerator / period.denominator if period.numerator and period.denominator else None


# -- controls and events -----------------------------------------------------------------------------------------------


def controls(node: Node) -> list[QueryControl]:
    """Every control that is not disabled, in the order of ids."""
    found: list[QueryControl] = []
    last = 0
    while len(found) < MOST_ENTRIES:
        entry = node.ask_if_known(Request.QUERYCTRL, QueryControl(id=last | ControlFlag.NEXT_CTRL))
        if entry is None or entry.id <= last:
            break
        last = entry.id
        found.append(entry)
    return [c for c in found if not c.flags & ControlFlag.DISABLED]


def menu(node: Node, control: QueryControl) -> dict[int, str]:
    """Values that a menu takes, and what they mean; not every number between the first and the last need be one."""
    items = {}
    for index in range(control.minimum, min(control.maximum, control.minimum + MOST_ENTRIES) + 1):
        item = node.ask_if_known(Request.QUERYMENU, MenuItem(id=control.id, index=index))
        if item is not None:
            numeric = control.type == ControlType.INTEGER_MENU
            items[index] = str(item.item.value) if numeric else text(item.item.name)
    return items


def control_value(node: Node, control_id: int) -> int:
    """Read a control back."""
    return int(node.ask(Request.G_CTRL, ControlValue(id=control_id)).value)


def set_control(node: Node, control_id: int, value: int) -> None:
    """Change a control."""
    node.ask(Request.S_CTRL, ControlValue(id=control_id, value=value))


def subscribe_source_change(node: Node, index: int) -> bool:
    """Ask to be told when an input's signal changes; False where the device tells no such thing."""
    return node.ask_if_known(Request.SUBSCRIBE_EVENT, EventSubscription(type=EVENT_SOURCE_CHANGE, id=index)) is not None


def source_changes(node: Node) -> int:
    """Take the events that wait; gives how many of them are changes of the source."""
    changes = 0
    for _ in range(MOST_ENTRIES):
        try:
            event = node.ask(Request.DQEVENT, Event())
        except OSError as error:
            if error.errno in UNKNOWN | {errno.ENOENT, errno.EAGAIN}:
                break
            raise
        changes += event.type == EVENT_SOURCE_CHANGE
    return changes


def text(raw: bytes) -> str:
    """Give a name as the device spells it."""
    return raw.decode("utf-8", "replace").strip()
