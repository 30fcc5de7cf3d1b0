"""What a measurement means to the operator: the tubes' names, and how the guide stands to its tube."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.alignment.aligner import Aligner
    from service.alignment.result import Alignment
    from service.identity.namer import TubeNamer
    from service.vision.measurement import Measurement

__all__ = ["Interpreter"]


class Interpreter:
    """Names and judges picture after picture of one stream, by these pictures alone: replayed, they mean the same.

    Parameters
    ----------
    namer
        Knows the tubes' names, once an anchor is set.
    aligner
        Judges; None where no guide is set up.
    """

    def __init__(self, namer: TubeNamer, aligner: Aligner | None) -> None:
        self.namer, self.aligner = namer, aligner
        self._generation: int | None = None

    def read(
        self, measurement: Measurement, generation: int, *, fresh: bool = True
    ) -> tuple[Sequence[str | None], Alignment | None]:
        """Names of a measurement's tubes (none where nothing names them), and the alignment.

        Parameters
        ----------
        generation
            Of its frame: the tracker begins a new lattice index with each.
        fresh
            Whether its picture differs from the one before.
        """
        if generation != self._generation:
            self._generation = generation
            if self.aligner is not None:
                self.aligner.reset()
        named = self.namer.update(measurement, generation)
        names: Sequence[str | None] = ()
        if named is not None:
            tubes = measurement.tubes
            names = [None if n is None else str(n) for n in named.names_of(tubes.row, tubes.column)]
        if self.aligner is None:
            return names, None
        now_ns = measurement.time_ns
        return names, self.aligner.update(measurement, named, now_ns, generation=generation, fresh=fresh)
