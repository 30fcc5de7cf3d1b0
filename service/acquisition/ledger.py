"""The exact account of every frame: what the device numbered, what reached us, what became of it."""

from __future__ import annotations

import enum
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.frame import Frame

__all__ = ["Account", "Ledger", "Outcome"]


class Outcome(enum.StrEnum):
    """What became of a sound frame."""

    PROCESSED = "processed"
    SUPERSEDED = "superseded"
    TOO_OLD = "too_old"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Account:
    """The ledger at one moment.

    ``span + unnumbered = delivered + lost`` and
    ``delivered = processed + superseded + too_old + corrupt + failed + in_flight``.

    Attributes
    ----------
    span
        Numbers the device counted through, from the first frame of each stream to its last.
    unnumbered
        Frames delivered that add no number: without one, second fields, repeats.
    lost
        Numbers that never reached us.
    delivered
        Frames the grabber handed over.
    corrupt
        Frames with a defect: shown, never measured.
    processed, failed
        Frames measured, and frames whose measuring raised an error.
    superseded, too_old
        Frames not measured because a newer one was there, or because they had waited too long.
    in_flight
        Frames waiting or being measured; at the end, those that a stop left unmeasured.
    """

    span: int = 0
    unnumbered: int = 0
    lost: int = 0
    delivered: int = 0
    corrupt: int = 0
    processed: int = 0
    superseded: int = 0
    too_old: int = 0
    failed: int = 0
    in_flight: int = 0

    @property
    def unaccounted(self) -> int:
        """Frames that the two equations miss; 0, or there is a mistake in this program."""
        settled = self.processed + self.superseded + self.too_old + self.corrupt + self.failed
        numbers = self.span + self.unnumbered - self.delivered - self.lost
        return abs(numbers) + abs(self.delivered - settled - self.in_flight)

    def balanced(self) -> bool:
        """Whether every frame is accounted for."""
        return self.unaccounted == 0 and self.in_flight >= 0 and self.lost >= 0

    @property
    def dropped(self) -> int:
        """Frames that were there to be measured and were not, wherever that happened."""
        return self.lost + self.superseded + self.too_old

    def lines(self) -> list[str]:
        """The two equations in words, for the summary."""
        unnumbered = f" + {self.unnumbered:,} without a number of their own" if self.unnumbered else ""
        verdict = "every frame accounted for" if self.balanced() else f"NOT BALANCED: {self.unaccounted:,} unaccounted"
        fates = (
            f"{self.delivered:,} delivered = {self.processed:,} processed + {self.superseded:,} superseded"
            f" + {self.too_old:,} too old + {self.corrupt:,} corrupt + {self.failed:,} failed"
            f" + {self.in_flight:,} in flight: {verdict}"
        )
        return [
            f"{self.span:,} numbered by the source{unnumbered} = {self.delivered:,} delivered + {self.lost:,} lost",
            fates,
        ]


class Ledger:
    """Counts every frame once on arrival and once when its fate is settled. Safe from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts = dict.fromkeys((*Outcome, "delivered", "corrupt", "in_flight", "unnumbered", "lost"), 0)
        self._closed_span = 0
        self._first: int | None = None
        self._last = 0

    def begin_stream(self) -> None:
        """Note that the source starts to count anew; what was lost in between nobody can know."""
        with self._lock:
            self._closed_span += self._open_span()
            self._first = None

    def _open_span(self) -> int:
        return 0 if self._first is None else self._last - self._first + 1

    def arrived(self, frame: Frame) -> None:
        """Count a frame that the grabber handed over."""
        with self._lock:
            self._counts["delivered"] += 1
            self._counts["in_flight" if frame.defect is None else "corrupt"] += 1
            self._number(frame.sequence)

    def _number(self, sequence: int | None) -> None:
        if sequence is None or (self._first is not None and sequence <= self._last):
            self._counts["unnumbered"] += 1
            return
        if self._first is None:
            self._first = sequence
        else:
            self._counts["lost"] += sequence - self._last - 1
        self._last = sequence

    def settle(self, frame: Frame, outcome: Outcome) -> None:
        """Count what became of a frame that had arrived. A frame with a defect is settled by its arrival."""
        if frame.defect is not None:
            return
        with self._lock:
            self._counts["in_flight"] -= 1
            self._counts[outcome] += 1

    def account(self) -> Account:
        """The ledger now."""
        with self._lock:
            return Account(span=self._closed_span + self._open_span(), **self._counts)
