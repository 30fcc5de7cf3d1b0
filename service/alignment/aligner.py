"""From picture to picture: the target, the averages, the verdict's memory."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

from service.alignment.bands import Bands
from service.alignment.entry import entry
from service.alignment.geometry import StationGeometry, compare, guide_foot, tube_end
from service.alignment.parallelism import SlopeWindow, arm_slope
from service.alignment.result import Alignment
from service.alignment.targets import NEAREST, Target, nearest_place, state_at
from service.alignment.verdict import NOT_POINTING, Help, Judgement, Sight, Verdict, judge
from service.identity.names import NamingError
from service.vision.measurement import Doubt

if TYPE_CHECKING:
    from collections.abc import Mapping

    from service.alignment.parallelism import Averaged
    from service.identity.anchors import NamedLattice
    from service.identity.names import TubeName
    from service.vision.lattice import Lattice
    from service.vision.measurement import Measurement

    Place: TypeAlias = tuple[int, int]
    Obstacle: TypeAlias = tuple[str, Help]

__all__ = ["Aligner", "AlignmentSettings"]

NOT_JUDGED = Judgement(Verdict.CANNOT_JUDGE)
MEMORY = ("target", "used", "_window", "_before", "_seen_ns", "_last")


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentSettings:
    """[alignment] of a station file.

    Attributes
    ----------
    geometry, bands
        What is fixed, and what is good enough.
    target
        As `parse_target` reads it.
    stale_after_s
        A picture that is older, or has been the same for longer, is not judged.
    average_s
        What parallelism is averaged over.
    """

    geometry: StationGeometry
    bands: Bands = field(default_factory=Bands)
    target: str = "nearest"
    stale_after_s: float = 0.5
    average_s: float = 1.0


class Aligner:
    """Judges picture after picture of one stream.

    Parameters
    ----------
    settings
        The station's.
    lattice
        The tubesheet.
    target
        Which tube is meant; may be set anew at any time, from any thread.
    """

    def __init__(self, settings: AlignmentSettings, lattice: Lattice, target: Target = NEAREST) -> None:
        self.settings, self.target = settings, target
        self.used = target
        """The target of the last picture."""
        self._lattice = lattice
        self.reset()

    def reset(self) -> None:
        """Forget the pictures so far."""
        self._window = SlopeWindow(self.settings.average_s)
        self._before: tuple[tuple[int, int], Judgement] | None = None
        self._seen_ns: int | None = None
        self._last: Averaged | None = None

    @property
    def memory(self) -> dict[str, Any]:
        """The target, and what the pictures so far left behind; see `Measurer.memory` of vision."""
        return {name: getattr(self, name) for name in MEMORY}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from a copy of what `memory` was."""
        for name in MEMORY:
            setattr(self, name, memory[name])

    def update(
        self,
        measurement: Measurement,
        named: NamedLattice | None,
        now_ns: int,
        *,
        generation: int = 0,
        fresh: bool = True,
    ) -> Alignment:
        """Judge one picture.

        Parameters
        ----------
        named
            What names its tubes; None where nothing does.
        now_ns
            On the clock of `Measurement.time_ns`.
        generation
            The epoch of the lattice index: a target's lattice place of another epoch is another tube.
        fresh
            Whether the picture differs from the one before it.
        """
        if fresh or self._seen_ns is None:
            self._seen_ns = measurement.time_ns
        target = self._bound(measurement, generation)
        sight = Sight(measurement, stale=now_ns - self._seen_ns > self.settings.stale_after_s * 1e9)
        if sight.stale or measurement.pose is None:
            self._before, self._last = None, None
            self._window.clear()
            judgement = judge(sight, self.settings.bands, None)
            return Alignment(self._seen_ns, str(target), measurement.lock, judgement)
        place, obstacle = self._place(measurement, named, target, generation)
        parallelism = self._averaged(measurement, fresh=fresh)
        if place is None:
            self._before = None
            judgement = judge(replace(sight, obstacle=obstacle), self.settings.bands, None)
            return Alignment(self._seen_ns, str(target), measurement.lock, judgement, parallelism=parallelism)
        about = Alignment(self._seen_ns, str(target), measurement.lock, NOT_JUDGED, parallelism=parallelism)
        return self._judged(sight, place, _identified(about, place, measurement, named))

    def aged(self, alignment: Alignment, now_ns: int) -> Alignment:
        """The same alignment, looked at later: stale once its picture is too old."""
        if now_ns - alignment.time_ns <= self.settings.stale_after_s * 1e9:
            return alignment
        reason = f"the last picture is {(now_ns - alignment.time_ns) / 1e9:.1f} s old"
        return replace(alignment, judgement=Judgement(Verdict.STALE, (reason,), (Help.SOURCE,)))

    def _bound(self, measurement: Measurement, generation: int) -> Target:
        """The target; a lattice place that was given before the first index belongs to that one."""
        target = self.target
        if measurement.pose is not None and (bound := target.bound(generation, measurement.index)) is not target:
            self.target = target = bound
        self.used = target
        return target

    def _averaged(self, measurement: Measurement, *, fresh: bool) -> Averaged | None:
        """Parallelism; a repeated picture says nothing new."""
        if fresh:
            slope = arm_slope(measurement, self._lattice, self.settings.geometry)
            self._last = None if slope is None else self._window.add(measurement.time_ns, slope)
        return self._last

    def _place(
        self, measurement: Measurement, named: NamedLattice | None, target: Target, generation: int
    ) -> tuple[Place | None, Obstacle | None]:
        """The target's lattice place, or why there is none."""
        if target.name is not None:
            return _place_named(target.name, named, measurement)
        if target.place is not None:
            if target.generation != generation:
                return None, (f"place {target} was that of a tube before the source was reopened", Help.TARGET)
            if target.index != measurement.index and Doubt.INDEX not in measurement.doubt:
                return None, (f"place {target} was chosen in another lattice index, which was in doubt", Help.TARGET)
            return target.place, None
        assert measurement.pose is not None, "checked"
        foot = guide_foot(measurement.pose, self.settings.geometry.guide)
        if foot is None:
            return None, (NOT_POINTING, Help.ALIGN_SETUP)
        return nearest_place(foot, self._lattice, measurement.tubes), None

    def _judged(self, sight: Sight, place: Place, about: Alignment) -> Alignment:
        m, geometry = sight.measurement, self.settings.geometry
        assert m.pose is not None, "checked"
        tube = tube_end(m, place, self._lattice)
        lean = compare(m.pose, self._lattice, geometry, tube)
        hit = None if lean is None else entry(lean, tube, geometry)
        before = self._before[1] if self._before is not None and self._before[0] == place else None
        judgement = judge(replace(sight, state=about.state, lean=lean, entry=hit), self.settings.bands, before)
        self._before = place, judgement
        return replace(about, judgement=judgement, tube=tube, lean=lean, entry=hit)


def _place_named(
    name: TubeName, named: NamedLattice | None, measurement: Measurement
) -> tuple[Place | None, Obstacle | None]:
    if named is None:
        if Doubt.INDEX in measurement.doubt:
            return None, (f"which tube is {name}: the lattice index is in doubt", Help.INDEX)
        return None, (f"which tube is {name}: no anchor names the tubes", Help.ANCHOR)
    known = named.rule.map
    if known is not None and not known.approximate and not known.holds(name):
        return None, (f"there is no tube {name} on map {known.name}", Help.TARGET)
    try:
        return named.place_of(name), None
    except NamingError as error:
        return None, (str(error), Help.TARGET)


def _identified(about: Alignment, place: Place, measurement: Measurement, named: NamedLattice | None) -> Alignment:
    """Say which tube it is, and what stands there."""
    name = None if named is None else named.name_of(*place)
    known = None if named is None else named.rule.map
    return replace(
        about,
        place=place,
        name=name,
        state=state_at(measurement.tubes, place),
        on_map=None if known is None or name is None else known.holds(name),
        map_approximate=None if known is None else known.approximate,
    )
