"""What of a session is missing, and when: told by the source's own count, the recorder, and the marks of bad frames."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from drivers.session_index import Fault, Measured, Overflow, Row

if TYPE_CHECKING:
    from drivers.session_index import Item

__all__ = ["MOST_LOSSES", "SILENT_NS", "Loss", "Losses"]

SILENT_NS: Final = 1_000_000_000
"""No frame for so long is told of."""
MERGED_NS: Final = 5_000_000_000
MOST_LOSSES: Final = 100


@dataclass(slots=True)
class Loss:
    """Frames that were lost, or a time without any, in close succession.

    Attributes
    ----------
    kind
        In words.
    from_ns, until_ns
        UTC, since 1970.
    frames
        How many; 0 where only time is known.
    """

    kind: str
    from_ns: int
    until_ns: int
    frames: int = 0


class Losses:
    """Reads along with a session's index.

    Attributes
    ----------
    totals
        Frames by kind, whether or not they are listed; of times without a frame, how often.
    listed
        The first of them, what is close together in one.
    """

    MISSING: Final = "frames that the source counted and that never came"
    NO_ROOM: Final = "frames that found no room in the recorder"
    BAD: Final = "bad frames"
    SILENT: Final = "times without a frame"
    UNKNOWN: Final = "results whose frame the recorder lost"
    FAULTS: Final = "lines of the index that cannot be trusted"

    def __init__(self) -> None:
        self.totals: Counter[str] = Counter()
        self.listed: list[Loss] = []
        self.numbered = False
        """Whether the source counts its frames: only then can frames be missed that never came."""
        self._before: Row | None = None
        self._now_ns = 0

    def take(self, item: Item) -> None:
        """Take what the index says next."""
        match item:
            case Row():
                self._row(item)
            case Overflow():
                self._note(self.NO_ROOM, item.frames)
            case Measured(number=None):
                self._note(self.UNKNOWN, 1)
            case Fault(torn=False):
                self._note(self.FAULTS, 1)
            case _:
                pass

    def _row(self, row: Row) -> None:
        before, self._before, self._now_ns = self._before, row, row.wall_ns
        self.numbered = self.numbered or row.sequence is not None
        if before is not None:
            if row.wall_ns - before.wall_ns > SILENT_NS:
                self.totals[self.SILENT] += 1
                self._list(Loss(self.SILENT, before.wall_ns, row.wall_ns))
            self._missing(before, row)
        if row.defect is not None:
            self._note(f"{self.BAD}: {row.defect}", 1)

    def _missing(self, before: Row, row: Row) -> None:
        """Note what the source's own count leaves out."""
        if row.sequence is None or before.sequence is None or row.generation != before.generation:
            return
        if (missing := row.sequence - before.sequence - 1) > 0:
            self._note(self.MISSING, missing, before.wall_ns)

    def _note(self, kind: str, frames: int, since_ns: int | None = None) -> None:
        self.totals[kind] += frames
        self._list(Loss(kind, self._now_ns if since_ns is None else since_ns, self._now_ns, frames))

    def _list(self, loss: Loss) -> None:
        last = next((known for known in reversed(self.listed[-8:]) if known.kind == loss.kind), None)
        if last is not None and loss.frames and loss.from_ns - last.until_ns <= MERGED_NS:
            last.until_ns, last.frames = loss.until_ns, last.frames + loss.frames
        elif len(self.listed) < MOST_LOSSES:
            self.listed.append(loss)
