"""Names from picture to picture: kept as long as the lattice index is, dropped with it."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from service.identity.anchors import settle
from service.identity.names import NamingError
from service.vision.measurement import Doubt

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.identity.anchors import Anchor, NamedLattice
    from service.identity.counting import NamingRule
    from service.vision.measurement import Measurement

__all__ = ["TubeNamer"]

log = logging.getLogger(__name__)


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
        """What names the tubes of the present index, whether or not it is in doubt just now."""
        self.problem: str | None = None
        """Why the last anchors name nothing."""
        self.taken: tuple[tuple[Anchor, ...], int] | None = None
        """Anchors that took effect with the last picture, and their generation; None where none did."""
        self._asked: tuple[tuple[Anchor, ...], int | None] | None = (tuple(anchors), None) if anchors else None

    def anchor(self, anchors: Sequence[Anchor], generation: int) -> None:
        """Take these for the anchors from the next picture on, unless its index is in doubt; from any thread.

        Parameters
        ----------
        generation
            Of the picture that they were read from: in another one, their places are those of other tubes.
        """
        self._asked = tuple(anchors), generation

    def update(self, measurement: Measurement, generation: int) -> NamedLattice | None:
        """What names this picture's tubes; None where nothing does, or where the index is in doubt."""
        self.taken = None
        if self.named is not None and self.named.generation != generation:
            self._fail(f"anchor {self.named.anchors[0]} is dropped: the source was reopened, and counting began anew")
        if measurement.pose is None:
            return None
        if Doubt.INDEX in measurement.doubt:
            self._turn_away()
            return None
        asked, self._asked = self._asked, None
        if asked is not None:
            anchors, known = asked
            self.taken = None if known is None else (anchors, known)
            if known not in (None, generation):
                self._fail(f"anchor {anchors[0]} came too late: the source was reopened, and counting began anew")
            else:
                self._settle(anchors, measurement, generation)
        return self.named

    def _turn_away(self) -> None:
        """Take no anchor while the index is in doubt: once that is mended, its place is another tube's."""
        if self._asked is None or self._asked[1] is None:  # from the start: none was read from a picture
            return
        (anchors, _), self._asked = self._asked, None
        self.problem = (
            f"anchor {anchors[0]} is not taken: the lattice index is in doubt; move back to where it was not, or start "
            "the service anew, and anchor again"
        )
        log.warning("%s", self.problem)

    def _settle(self, anchors: tuple[Anchor, ...], measurement: Measurement, generation: int) -> None:
        assert measurement.pose is not None, "only a pose tells how the sheet lies"
        try:
            self.named, self.problem = settle(self.rule, anchors, measurement.pose.rotation, generation), None
        except NamingError as error:
            self._fail(str(error))

    def _fail(self, problem: str) -> None:
        self.named, self.problem = None, problem
        log.warning("%s", problem)
