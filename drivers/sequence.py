"""Frame numbers as devices count them: in 32 bits."""

from __future__ import annotations

from typing import Final

__all__ = ["SEQUENCE_NUMBERS", "SequenceExtender"]

SEQUENCE_NUMBERS: Final = 1 << 32


class SequenceExtender:
    """Carries a 32-bit frame number on past its wrap, so that it grows from `start` to `stop`."""

    def __init__(self) -> None:
        self._last: int | None = None

    def restart(self) -> None:
        """Forget the past: the device counts anew."""
        self._last = None

    def extend(self, number: int) -> int:
        """Give the number without its wraps: the nearest to the last one that agrees with it in 32 bits."""
        if self._last is None:
            self._last = number
        else:
            half = SEQUENCE_NUMBERS // 2
            self._last += (number - self._last + half) % SEQUENCE_NUMBERS - half
        return self._last
