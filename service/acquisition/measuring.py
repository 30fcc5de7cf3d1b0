"""Frames in, results out: the step that the live worker and `analyze` share."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from drivers.errors import ConfigError
from drivers.frame import Field
from service.acquisition.ledger import Outcome
from service.acquisition.repeated import RepeatedLog
from service.results import FrameResult
from service.sinks.session.memory import Memory
from service.vision.measurement import Lock, Measurement, Tubes

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from drivers.frame import Frame, Pixels
    from drivers.grabber import Clock
    from service.acquisition.cross_check import CrossCheck
    from service.alignment.interpreter import Interpreter

__all__ = ["FrameMeasurer", "Measurer"]

log = logging.getLogger(__name__)

MEMORY = ("_size_px", "_why_not", "_before", "_generation", "_index")


class Measurer(Protocol):
    """What vision offers: pictures in, measurements out, with a memory from picture to picture."""

    def measure(
        self, pixels: NDArray[np.uint8] | NDArray[np.uint16], time_ns: int, field: str = "unknown"
    ) -> Sequence[Measurement]:
        """Measure a picture: one answer, or two (top and bottom) for an interlaced one."""
        ...

    @property
    def memory(self) -> Mapping[str, Any]:
        """All that earlier pictures left behind."""
        ...

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from a copy of what `memory` was."""
        ...

    def settle_index(self, index: int, shift: tuple[int, int] | None) -> bool:
        """Trust a lattice index that is in doubt; see `Tracker.settle_index`."""
        ...

    def reset(self) -> None:
        """Forget what earlier pictures showed."""
        ...


class FrameMeasurer:
    """Answers every frame: with what vision says, or with no lock and the reason.

    Parameters
    ----------
    measurer
        Vision.
    field
        What to take whole frames for instead of what their source says of them; None: as the source says.
    clock
        Times the rate of repeated warnings.
    interpreter
        Names the tubes and judges the alignment; None where neither is set up.
    check
        Holds measurements against lens and range finder; None where there is neither.
    remake
        Makes vision anew for sound frames of another size; raises ConfigError where they cannot be measured. None: they
        go to the same.
    memory_wanted
        Whether results are to be given what is remembered before their frame.
    """

    def __init__(
        self,
        measurer: Measurer,
        field: Field | None,
        clock: Clock,
        interpreter: Interpreter | None = None,
        check: CrossCheck | None = None,
        remake: Callable[[Frame], Measurer] | None = None,
        memory_wanted: Callable[[], bool] = lambda: False,
    ) -> None:
        self._measurer, self._field, self._interpreter = measurer, field, interpreter
        self._check, self._remake, self._memory_wanted = check, remake, memory_wanted
        self._size_px: dict[Field, tuple[int, int]] = {}
        self._why_not: str | None = None
        self._before: Pixels | None = None
        self._log = RepeatedLog(log, clock)
        self._generation: int | None = None
        self._index = 0

    def answer(self, frame: Frame) -> tuple[tuple[FrameResult, ...], Outcome]:
        """Measure one frame. Never raises for what is in it: an error of the measuring itself is an answer too."""
        memory = self._memory() if self._memory_wanted() else None
        if frame.generation != self._generation:
            self._measurer.reset()
            self._generation = frame.generation
        measurements, outcome = self._measure(frame)
        sequence = self._index if frame.sequence is None else frame.sequence
        self._index = sequence + 1
        results = []
        for m in measurements:
            measurement, priors = (m, None) if self._check is None else self._check.apply(m)
            result = FrameResult(frame.source, sequence, frame.timestamp_ns, frame.generation, measurement)
            if self._check is not None:
                result = replace(result, instruments=priors, outside=self._check.said)
            results.append(result)
        if self._interpreter is not None and not self._interpret(frame, results, self._interpreter):
            outcome = Outcome.FAILED
        if memory is not None:
            results[0] = replace(results[0], memory=memory)
        return tuple(results), outcome

    def _memory(self) -> Memory:
        """All that the next results rest on besides their frames, copied."""
        interpreter = None if self._interpreter is None else self._interpreter.memory
        own = {name: getattr(self, name) for name in MEMORY}
        try:
            return Memory.of({"own": own, "vision": self._measurer.memory, "interpreter": interpreter})
        except TypeError as error:  # the recording goes on without
            log.warning("what is remembered cannot be recorded: %s", error)
            return Memory.none()

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from what was remembered, before the first frame."""
        for name in MEMORY:
            setattr(self, name, memory["own"][name])
        self._measurer.recall(memory["vision"])
        if self._interpreter is not None and memory["interpreter"] is not None:
            self._interpreter.recall(memory["interpreter"])

    def _measure(self, frame: Frame) -> tuple[Sequence[Measurement], Outcome]:
        if frame.defect is not None:
            return [_nothing(frame, f"bad frame: {frame.defect}")], Outcome.PROCESSED
        try:
            self._fit(frame)
            if self._why_not is not None:
                return [_nothing(frame, self._why_not)], Outcome.PROCESSED
            return self._measurer.measure(frame.pixels, frame.timestamp_ns, self._field_of(frame)), Outcome.PROCESSED
        except Exception as error:  # noqa: BLE001 - a mistake in measuring one frame must not end the watch
            said = f"{type(error).__name__}: {error}"
            self._log.warning("measure", f"{frame.source}: frame {frame.sequence} could not be measured: {said}", error)
            return [_nothing(frame, f"measuring failed: {said}")], Outcome.FAILED

    def _fit(self, frame: Frame) -> None:
        """Have vision made anew where the frames are of another size than before."""
        before = self._size_px.get(frame.field)
        self._size_px[frame.field] = frame.size_px
        if self._remake is None or before in (None, frame.size_px):
            return
        try:
            self._measurer, self._why_not = self._remake(frame), None
        except ConfigError as error:
            self._why_not = str(error)
            log.warning("%s; nothing is measured until then", error)

    def _interpret(self, frame: Frame, results: list[FrameResult], interpreter: Interpreter) -> bool:
        """Put names and alignment into the results; False where that failed, and they stay without."""
        fresh = self._before is None or not np.array_equal(self._before, frame.pixels)
        self._before = frame.pixels
        try:
            for i, result in enumerate(results):
                names, alignment = interpreter.read(result.measurement, frame.generation, fresh=fresh)
                outside = {**(result.outside or {}), **interpreter.chosen} or None
                results[i] = replace(result, names=names, alignment=alignment, outside=outside)
                interpreter.settle_index(self._measurer)
        except Exception as error:  # noqa: BLE001 - as above: the measurement itself is sound
            said = f"{type(error).__name__}: {error}"
            self._log.warning("interpret", f"{frame.source}: frame {frame.sequence} could not be judged: {said}", error)
            return False
        return True

    def _field_of(self, frame: Frame) -> Field:
        alone = frame.field in (Field.TOP, Field.BOTTOM)
        return frame.field if alone or self._field is None else self._field


def _nothing(frame: Frame, reason: str) -> Measurement:
    field = frame.field if frame.field in (Field.TOP, Field.BOTTOM) else Field.PROGRESSIVE
    return Measurement(str(field), Lock.NONE, " ".join(reason.split()), (), Tubes.none(), None, frame.timestamp_ns)
