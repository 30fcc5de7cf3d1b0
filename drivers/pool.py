"""Memory for frames, used again when nobody looks at it any more."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from drivers.frame import Pixels

__all__ = ["FramePool", "read_only"]


class FramePool:
    """A ring of pictures of one size.

    Whoever holds a picture, or a view of it, or a view of that, keeps its memory: every such view refers to the
    memory itself, and the ring passes over memory that is referred to. Where all is held, there is new memory for
    that picture alone. Writing into memory that was never touched would cost a page fault for every 4 kB.

    Parameters
    ----------
    shape
        (height, width).
    dtype
        uint8 or uint16.
    count
        Pictures kept ready.
    """

    def __init__(self, shape: tuple[int, int], dtype: type[np.uint8 | np.uint16], count: int) -> None:
        self._shape, self._dtype = shape, dtype
        self._ring = [self._new() for _ in range(count)]
        self._next = 0
        self._free_references = self._references(0)
        self.overflowed = 0
        """How often all of the ring was held."""

    def _new(self) -> Pixels:
        memory: Pixels = np.empty(self._shape, self._dtype)  # type: ignore[assignment]
        memory.fill(0)
        return memory

    def _references(self, at: int) -> int:
        return sys.getrefcount(self._ring[at])

    def take(self) -> Pixels:
        """Memory to write a picture into, which nobody else refers to. Hand out `read_only` views of it only."""
        for step in range(len(self._ring)):
            at = (self._next + step) % len(self._ring)
            if self._references(at) <= self._free_references:
                self._next = at + 1
                return self._ring[at]
        self.overflowed += 1
        return self._new()


def read_only(memory: Pixels) -> Pixels:
    """Give a view to hand out."""
    view = memory.view()
    view.flags.writeable = False
    return view
