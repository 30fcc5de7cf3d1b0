"""What a measurement means to the operator: the tubes' names, and how the guide stands to its tube."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from service.alignment.aligner import Aligner
    from service.alignment.result import Alignment
    from service.identity.anchors import NamedLattice
    from service.identity.namer import IndexSettler, TubeNamer
    from service.vision.measurement import Measurement, Tubes

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
        self._named: NamedLattice | None = None
        self._told: dict[tuple[int, int], str | None] = {}
        self.chosen: dict[str, Any] = {}
        """What the operator chose meanwhile and took effect with the last picture, in JSON's own types."""

    @property
    def memory(self) -> dict[str, Any]:
        """What the pictures so far, and the operator, left behind; see `Measurer.memory` of vision."""
        aligner = None if self.aligner is None else self.aligner.memory
        return {"generation": self._generation, "namer": self.namer.memory, "aligner": aligner}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from a copy of what `memory` was."""
        self._generation = memory["generation"]
        self.namer.recall(memory["namer"])
        if self.aligner is not None:
            self.aligner.recall(memory["aligner"])

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
        before = None if self.aligner is None else self.aligner.used
        named = self.namer.update(measurement, generation)
        self.chosen = {}
        if self.namer.taken is not None:
            taken = self.namer.taken
            anchors = [str(anchor) for anchor in taken.anchors]
            self.chosen = {"anchors": anchors, "generation": taken.generation, "index": taken.index}
            if self.namer.begins_anew:
                self.chosen["begins_anew"] = True
        names: Sequence[str | None] = () if named is None else self._texts(named, measurement.tubes)
        if self.aligner is None:
            return names, None
        now_ns = measurement.time_ns
        alignment = self.aligner.update(measurement, named, now_ns, generation=generation, fresh=fresh)
        if before is not None and not self.aligner.used.continues(before):
            self.chosen["target"] = self.aligner.used.to_dict()
        return names, alignment

    def settle_index(self, settler: IndexSettler) -> None:
        """Have a lattice index trusted that an anchor settled with the last picture, where one did."""
        self.namer.settle_index(settler)

    def _texts(self, named: NamedLattice, tubes: Tubes) -> Sequence[str | None]:
        """Names in words; those that were told before are kept, as most tubes are in the next picture too."""
        if named is not self._named:
            self._named, self._told = named, {}
        places = list(zip(tubes.row.tolist(), tubes.column.tolist(), strict=True))
        for place in places:
            if place not in self._told:
                name = named.name_of(*place)
                self._told[place] = None if name is None else str(name)
        return [self._told[place] for place in places]
