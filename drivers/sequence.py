"""Frame numbers as devices count them: in 32 bits."""

from __future__ import annotations

from typing import Final

__all__ = ["SEQUENCE_NUMBERS", "SequenceExtender"]

SEQUENCE_NUMBERS: Final = 1 << 32


class SequenceExtender:
    """Carries a 32-bit frame number on past its wrap, so that it grows from `start` to `stop`."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._shift = 0

    def restart(self) -> None:
        """Forget the past: the device counts anew."""
        self._last, self._shift = None, 0

    def resume(self) -> None:
        """Go on from the last number although the device counts anew, as after a stop between two reads."""
        if self._last is not None:
            self._shift, self._last = self._shift + self._last + 1, None

    def extend(self, number: int) -> int:
        """Give the number without its wraps: the nearest to the last one that agrees with it in 32 bits."""
        last = number if self._last is None else self._last
        half = SEQUENCE_NUMBERS // 2
        self._last = last + (number - last + half) % SEQUENCE_NUMBERS - half
        return self._last + self._shift
