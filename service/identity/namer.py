"""Names from picture to picture: kept as long as the lattice index is, dropped with it."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from service.identity.anchors import settle
from service.identity.names import NamingError
from service.vision.measurement import Doubt

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from service.identity.anchors import Anchor, NamedLattice
    from service.identity.counting import NamingRule
    from service.vision.measurement import Measurement

__all__ = ["AskedAnchors", "IndexSettler", "TubeNamer"]

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class AskedAnchors:
    """Anchors, and the lattice index that they were read from; None: known from the start, for the first there is."""

    anchors: tuple[Anchor, ...]
    generation: int | None = None
    index: int | None = None


class IndexSettler(Protocol):
    """Follows the lattice; see `Tracker.settle_index`."""

    def settle_index(self, index: int, shift: tuple[int, int] | None) -> bool:
        """Trust an index that is in doubt, from the next picture on; False where it is not the present one."""
        ...


class TubeNamer:
    """Holds the operator's anchors against what the pictures show.

    Parameters
    ----------
    rule
        How this plant names its tubes.
    anchors
        Known from the start: they hold for the first index that there is.
    """

    def __init__(self, rule: NamingRule, anchors: Sequence[Anchor] = ()) -> None:
        self.rule = rule
        self.named: NamedLattice | None = None
        """What names the tubes of the last index that was trusted."""
        self.problem: str | None = None
        """Why the last anchors name nothing."""
        self.taken: AskedAnchors | None = None
        """Anchors that took effect with the last picture; None where none did."""
        self.tell: Callable[[str, str], None] = lambda _text, _level: None
        """Told, with INFO or WARN, what becomes of anchors. Must return at once."""
        self._asked = AskedAnchors(tuple(anchors)) if anchors else None
        self._settling: tuple[int, tuple[int, int] | None] | None = None

    def anchor(self, anchors: Sequence[Anchor], generation: int, index: int) -> None:
        """Take these for the anchors from the next picture on; from any thread.

        Parameters
        ----------
        generation, index
            Of the picture that they were read from: in another one, their places may be those of other tubes.
        """
        self._asked = AskedAnchors(tuple(anchors), generation, index)

    @property
    def memory(self) -> dict[str, Any]:
        """What names tubes, and what is still to be taken; see `Measurer.memory` of vision."""
        return {"named": self.named, "problem": self.problem, "asked": self._asked}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from a copy of what `memory` was."""
        self.named, self.problem, self._asked = memory["named"], memory["problem"], memory["asked"]

    def update(self, measurement: Measurement, generation: int) -> NamedLattice | None:
        """What names this picture's tubes; None where nothing does, or where the index is in doubt."""
        self.taken = self._settling = None
        if self.named is not None and self.named.generation != generation:
            self._fail(f"anchor {self.named.anchors[0]} is dropped: the source was reopened, and counting began anew")
        if measurement.pose is None:
            return None
        doubtful, asked = Doubt.INDEX in measurement.doubt, self._asked
        if asked is not None and not (doubtful and asked.generation is None):
            if self._asked is asked:  # else somebody has asked anew meanwhile
                self._asked = None
            self._take(asked, measurement, generation)
        if doubtful or self.named is None or self.named.index != measurement.index:
            return None
        return self.named

    def _take(self, asked: AskedAnchors, measurement: Measurement, generation: int) -> None:
        first = asked.anchors[0]
        if asked.generation not in (None, generation):
            self.taken = asked
            self._fail(f"anchor {first} came too late: the source was reopened, and counting began anew")
        elif asked.index not in (None, measurement.index):
            self._say_problem(f"anchor {first} came too late: the lattice index may have slipped since; anchor again")
        else:
            self.taken = None if asked.generation is None else asked
            self._settle(asked.anchors, measurement, generation)

    def _settle(self, anchors: tuple[Anchor, ...], measurement: Measurement, generation: int) -> None:
        assert measurement.pose is not None, "only a pose tells how the sheet lies"
        try:
            named = settle(self.rule, anchors, measurement.pose.rotation, generation, measurement.index)
        except NamingError as error:
            self._fail(str(error))
            return
        self.problem, before = None, self.named
        if Doubt.INDEX not in measurement.doubt:
            self.named = named
            return
        shift = None if before is None else _slipped_by(before, named)
        self._settling = measurement.index, shift
        if shift is None:
            self.named = named
            gone = "" if before is None else f"; dropped: {', '.join(map(str, before.anchors))}"
            self._say(f"anchor {anchors[0]} settles the lattice index, which begins anew with it{gone}", "WARN")
        else:
            slipped = f"had slipped by {shift[0]}, {shift[1]} (row, column)" if any(shift) else "had not slipped"
            self._say(f"anchor {anchors[0]} settles the lattice index, which {slipped}", "INFO")

    @property
    def begins_anew(self) -> bool:
        """Whether, by an anchor that took effect with the last picture, places count anew from the next one on."""
        return self._settling is not None and self._settling[1] is None

    def settle_index(self, settler: IndexSettler) -> None:
        """Have an index trusted that an anchor settled with the last picture, where one did."""
        if self._settling is not None and not settler.settle_index(*self._settling):
            self._fail("the anchor came too late: the lattice index may have slipped since; anchor again")

    def _fail(self, problem: str) -> None:
        self.named = None
        self._say_problem(problem)

    def _say_problem(self, problem: str) -> None:
        self.problem = problem
        self._say(problem, "WARN")

    def _say(self, text: str, level: str) -> None:
        log.log(logging.WARNING if level == "WARN" else logging.INFO, "%s", text)
        self.tell(text, level)


def _slipped_by(before: NamedLattice, now: NamedLattice) -> tuple[int, int] | None:
    """By how many rows and columns places are less now than they were; None where the two do not count alike."""
    anchor = now.anchors[0]
    place = before.counting.place(anchor.name)
    if place is None or before.counting.matrix.tolist() != now.counting.matrix.tolist():
        return None
    return place[0] - anchor.row, place[1] - anchor.column
