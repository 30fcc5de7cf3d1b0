"""The device's buffers, mapped into memory: filled by the device, lent to the driver, given back."""

from __future__ import annotations

import contextlib
import ctypes
import select
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.v4l2.constants import MEMORY_MMAP, BufferFlag, BufferType, FieldOrder
from drivers.v4l2.structs import BufferDescription, Request, RequestBuffers

if TYPE_CHECKING:
    import mmap

    from numpy.typing import NDArray

    from drivers.v4l2.calls import Node

__all__ = ["BufferRing", "Lent", "Ready"]


@dataclass(frozen=True, slots=True)
class Ready:
    """What waiting was ended by; nothing of it where time ran out."""

    frame: bool = False
    event: bool = False
    failure: bool = False
    gone: bool = False


@dataclass(frozen=True, slots=True)
class Lent:
    """A filled buffer, until it is given back.

    Attributes
    ----------
    index
        Which one.
    size_bytes
        How much of it the device filled.
    sequence
        The device's frame number, 32 bits.
    stamp_ns
        The device's time for it, monotonic clock; None where it is another clock's.
    stamped_at_start
        Whether that is when the exposure began, not when the last byte came in.
    field
        Which lines it holds.
    flawed
        Whether the device marked it as bad.
    """

    index: int
    size_bytes: int
    sequence: int
    stamp_ns: int | None
    stamped_at_start: bool
    field: FieldOrder
    flawed: bool


class BufferRing:
    """Buffers of a device, all of them the device's when made. Every call but `release` may raise OSError.

    Parameters
    ----------
    node
        The device, its format agreed.
    count
        How many buffers to ask for; the device may give more, or fewer.
    """

    def __init__(self, node: Node, count: int) -> None:
        self._node = node
        self._memory: list[mmap.mmap] = []
        try:
            for index in range(self._request(count)):
                buffer = node.ask(Request.QUERYBUF, _description(index))
                self._memory.append(node.system.mmap(node.fd, buffer.length, buffer.m.offset))
                node.ask(Request.QBUF, _description(index))
        except BaseException:
            self.release()
            raise

    def _request(self, count: int) -> int:
        wish = RequestBuffers(count=count, type=BufferType.VIDEO_CAPTURE, memory=MEMORY_MMAP)
        return int(self._node.ask(Request.REQBUFS, wish).count)

    def __len__(self) -> int:
        return len(self._memory)

    def start(self) -> None:
        """Let the device stream."""
        self._node.ask(Request.STREAMON, _capture())

    def wait(self, timeout_s: float) -> Ready:
        """Wait for a filled buffer, an event or a failure."""
        seen = self._node.system.poll(self._node.fd, max(0.0, timeout_s))
        return Ready(
            frame=bool(seen & select.POLLIN),
            event=bool(seen & select.POLLPRI),
            failure=bool(seen & (select.POLLERR | select.POLLNVAL)),
            gone=bool(seen & select.POLLHUP),
        )

    def take(self) -> Lent | None:
        """Take the oldest filled buffer; None where there is none."""
        try:
            b = self._node.ask(Request.DQBUF, _description(0))
        except BlockingIOError:
            return None
        monotonic = b.flags & BufferFlag.TIMESTAMP_MASK == BufferFlag.TIMESTAMP_MONOTONIC
        return Lent(
            index=b.index,
            size_bytes=b.bytesused,
            sequence=b.sequence,
            stamp_ns=b.timestamp.tv_sec * 1_000_000_000 + b.timestamp.tv_usec * 1000 if monotonic else None,
            stamped_at_start=b.flags & BufferFlag.TSTAMP_SRC_MASK == BufferFlag.TSTAMP_SRC_SOE,
            field=FieldOrder(b.field),
            flawed=bool(b.flags & BufferFlag.ERROR),
        )

    def newest(self, lent: Lent) -> Lent:
        """Give back a buffer, and those filled after it, but for the last."""
        while (later := self.take()) is not None:
            self.give_back(lent)
            lent = later
        return lent

    def data(self, lent: Lent) -> NDArray[np.uint8]:
        """(n,) bytes of a lent buffer. Keep no reference: memory that is looked at cannot be unmapped."""
        return np.frombuffer(self._memory[lent.index], np.uint8, min(lent.size_bytes, len(self._memory[lent.index])))

    def give_back(self, lent: Lent) -> None:
        """Let the device fill the buffer anew."""
        self._node.ask(Request.QBUF, _description(lent.index))

    def release(self) -> None:
        """Stop the device, unmap and free everything, whatever the device says to it."""
        with contextlib.suppress(OSError):  # gone, or never started
            self._node.ask(Request.STREAMOFF, _capture())
        while self._memory:
            with contextlib.suppress(BufferError):  # unmapped by whoever still looks at it
                self._memory.pop().close()
        with contextlib.suppress(OSError):
            self._request(0)


def _description(index: int) -> BufferDescription:
    return BufferDescription(index=index, type=BufferType.VIDEO_CAPTURE, memory=MEMORY_MMAP)


def _capture() -> ctypes.c_int:
    return ctypes.c_int(BufferType.VIDEO_CAPTURE)
