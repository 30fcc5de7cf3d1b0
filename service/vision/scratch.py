"""Memory for arrays that live within one call: fresh memory has to be mapped page by page, on every picture again."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

__all__ = ["DOUBLE", "SINGLE", "Scratch", "borrowed"]

SINGLE, DOUBLE = np.dtype(np.float32), np.dtype(np.float64)

ALIGNMENT = 64
"""Bytes: a line of the processor's cache, and its widest register."""

_idle: list[Scratch] = []


class Scratch:
    """Memory that arrays are cut from; it grows to what its last use took."""

    def __init__(self) -> None:
        self._memory = np.empty(0, np.uint8)
        self._taken = 0

    def array(self, shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
        """An array with nothing in it yet; it is another's once the scratch has been given back."""
        begin, size = self._taken, math.prod(shape) * kind.itemsize
        self._taken = begin + -(-size // ALIGNMENT) * ALIGNMENT
        if self._taken > len(self._memory):
            return np.empty(shape, kind)
        return self._memory[begin : begin + size].view(kind).reshape(shape)

    def clear(self) -> None:
        """Take all arrays back."""
        if self._taken > len(self._memory):
            memory = np.empty(self._taken + ALIGNMENT, np.uint8)
            self._memory = memory[-memory.ctypes.data % ALIGNMENT :]
        self._taken = 0


@contextmanager
def borrowed() -> Iterator[Scratch]:
    """A scratch of one's own for a while; as many are kept as were in use at a time."""
    try:
        scratch = _idle.pop()
    except IndexError:
        scratch = Scratch()
    try:
        yield scratch
    finally:
        scratch.clear()
        _idle.append(scratch)
