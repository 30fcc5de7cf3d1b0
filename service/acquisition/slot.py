"""Handing frames from one thread to another: the newest only, or every one in order."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from drivers.frame import Frame

__all__ = ["FrameQueue", "HandOver", "NewestSlot"]

WAIT_S = 0.5
"""Longest single wait for room: a producer looks up this often even if nobody wakes it."""


class HandOver(Protocol):
    """One producer, one consumer."""

    def put(self, frame: Frame) -> Frame | None:
        """Hand a frame over; returns the one that will now never be taken, if there is one."""
        ...

    def take(self, timeout_s: float) -> Frame | None:
        """Wait for a frame; None where none came in time."""
        ...

    def close(self) -> None:
        """Say that no more will be put. What was put before can still be taken."""
        ...

    @property
    def exhausted(self) -> bool:
        """Whether it is closed and empty."""
        ...

    @property
    def depth(self) -> int:
        """Frames waiting."""
        ...


class NewestSlot:
    """Holds one frame, the newest: putting never waits, and the consumer never falls behind.

    A frame with a defect, which nobody measures, never takes the place of a sound one that waits.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._closed = False

    def put(self, frame: Frame) -> Frame | None:
        """Replace the waiting frame, which is returned."""
        with self._changed:
            waiting = self._frame
            if self._closed or (frame.defect is not None and waiting is not None and waiting.defect is None):
                return frame
            self._frame = frame
            self._changed.notify()
            return waiting

    def take(self, timeout_s: float) -> Frame | None:
        """Wait for a frame; None where none came in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._closed, timeout_s)
            frame, self._frame = self._frame, None
            return frame

    def close(self) -> None:
        """Say that no more will be put."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def exhausted(self) -> bool:
        """Whether it is closed and empty."""
        with self._changed:
            return self._closed and self._frame is None

    @property
    def depth(self) -> int:
        """Frames waiting."""
        return int(self._frame is not None)


class FrameQueue:
    """Every frame, in order, with a bound.

    `put` waits for room, for sources that can wait (a recording at full speed). `offer` never waits, for sources that
    cannot: what finds no room is counted in `overflowed`. With `waits`, `offer` waits as `put` does.
    """

    def __init__(self, capacity: int, *, waits: bool = False) -> None:
        if capacity < 1:
            raise ValueError(f"a queue of {capacity} frames holds none; give at least 1")
        self._changed = threading.Condition()
        self._frames: deque[Frame] = deque()
        self._capacity, self._waits = capacity, waits
        self._closed = False
        self.overflowed = 0
        """Frames that `offer` turned away."""

    def put(self, frame: Frame) -> Frame | None:
        """Append a frame when there is room; it comes back where the queue was closed meanwhile."""
        with self._changed:
            while len(self._frames) >= self._capacity and not self._closed:
                self._changed.wait(WAIT_S)
            return None if self._append(frame) else frame

    def offer(self, frame: Frame) -> bool:
        """Append a frame if there is room now."""
        if self._waits:
            return self.put(frame) is None
        with self._changed:
            taken = len(self._frames) < self._capacity and self._append(frame)
            self.overflowed += not taken
            return taken

    def _append(self, frame: Frame) -> bool:
        if self._closed:
            return False
        self._frames.append(frame)
        self._changed.notify_all()
        return True

    def take(self, timeout_s: float) -> Frame | None:
        """Wait for the oldest frame; None where none came in time."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._frames or self._closed, timeout_s) or not self._frames:
                return None
            self._changed.notify_all()
            return self._frames.popleft()

    def close(self) -> None:
        """Say that no more will be put."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def exhausted(self) -> bool:
        """Whether it is closed and empty."""
        with self._changed:
            return self._closed and not self._frames

    @property
    def depth(self) -> int:
        """Frames waiting."""
        return len(self._frames)
