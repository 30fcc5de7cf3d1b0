"""What an operator may do: choose the target, anchor names, acknowledge, record, mark, verify, switch the input."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from service.alignment.targets import NEAREST, Target, parse_target
from service.console.watched import RefusedError
from service.identity.anchors import Anchor, check_anchors
from service.identity.names import NamingError
from service.sinks.session.control import RecordingError

if TYPE_CHECKING:
    from drivers.grabber import Clock
    from service.alignment.desk import AlarmDesk, Tell
    from service.alignment.interpreter import Interpreter
    from service.console.watched import Watched
    from service.results import FrameResult
    from service.sinks.session.control import SessionControl

__all__ = ["Operations"]


class Operations:
    """Carries out what is asked on the page. Callable from any thread; what cannot be done raises RefusedError.

    Parameters
    ----------
    interpreter
        Names the tubes and judges the alignment.
    desk
        The alarms.
    watched
        The live service.
    recorder
        Records sessions; None where nothing is recorded.
    tell
        Told of all that was done, for the sessions' record.
    """

    def __init__(
        self,
        interpreter: Interpreter,
        desk: AlarmDesk,
        watched: Watched,
        recorder: SessionControl | None,
        clock: Clock,
        tell: Tell,
    ) -> None:
        self._interpreter, self._desk, self._watched = interpreter, desk, watched
        self._recorder, self._clock, self._tell = recorder, clock, tell
        self._rule = interpreter.namer.rule
        self._unaligned = NEAREST  # the target where there is no guide to align: a tube to keep in sight
        self._present: tuple[int, int] | None = None

    # -- what is chosen ----------------------------------------------------------------------------------------------

    @property
    def target(self) -> Target:
        """The tube that is meant."""
        aligner = self._interpreter.aligner
        return self._unaligned if aligner is None else aligner.target

    def follow(self, result: FrameResult) -> None:
        """Take note of a frame: what is asked from now on is asked of its lattice."""
        reopened = self._present is None or self._present[0] != result.generation
        if reopened or result.measurement.pose is not None:
            self._present = result.generation, result.measurement.index

    def place_in(self, result: FrameResult) -> tuple[int, int] | None:
        """Lattice place of the target in a frame; None where it has none."""
        if result.alignment is not None:
            return result.alignment.place
        target, named = self.target, self._interpreter.namer.named
        index = result.generation, result.measurement.index
        if target.place is not None:
            return target.place if (target.generation, target.index) == index else None
        if target.name is None or named is None or (named.generation, named.index) != index:
            return None
        try:
            return named.place_of(target.name)
        except NamingError:
            return None

    def naming(self) -> dict[str, Any]:
        """What names the tubes now, and why nothing does."""
        namer = self._interpreter.namer
        anchors = () if namer.named is None else namer.named.anchors
        return {"anchors": [str(a) for a in anchors], "problem": namer.problem}

    # -- commands ----------------------------------------------------------------------------------------------------

    def choose(self, tube: str, generation: int | None, operator: str, index: int | None = None) -> str:
        """Choose the target: "nearest", a name, or a place "ROW,COLUMN" of a picture's generation and lattice index."""
        try:
            target = parse_target(tube, self._rule)
        except NamingError as error:
            raise RefusedError(str(error)) from None
        if target.place is not None:
            generation, index = self._shown(generation, index)
            target = replace(target, generation=generation, index=index)
        aligner = self._interpreter.aligner
        if aligner is None:
            self._unaligned = target
        else:
            aligner.target = target
        self._told(f"target is {target}", operator, target=str(target), generation=target.generation)
        return str(target)

    def anchor(
        self, row: int, column: int, name: str, generation: int | None, operator: str, index: int | None = None
    ) -> str:
        """Name the tube at a lattice place, and thereby all others; an index that is in doubt is settled by it."""
        try:
            anchor = Anchor(row, column, self._rule.parse(name))
            check_anchors(self._rule, [anchor])
        except NamingError as error:
            raise RefusedError(str(error)) from None
        generation, index = self._shown(generation, index)
        self._interpreter.namer.anchor([anchor], generation, index)
        self._told(f"anchor {anchor}", operator, anchors=[str(anchor)], generation=generation)
        return str(anchor)

    def _shown(self, generation: int | None, index: int | None) -> tuple[int, int]:
        """Generation and lattice index of the picture shown, where they are those asked for."""
        if self._present is None:
            raise RefusedError("there is no picture yet; wait for one")
        if generation not in (None, self._present[0]):
            raise RefusedError("the source was reopened since that picture: its places are other tubes; choose again")
        if index not in (None, self._present[1]):
            raise RefusedError("the lattice index may have slipped since that picture; choose again")
        return self._present

    def acknowledge(self, key: str | None, operator: str) -> bool:
        """Note that an alarm was seen, or with None all."""
        return self._desk.acknowledge(self._clock.monotonic_ns(), key, operator)

    def record(self, on: bool, operator: str) -> str | None:
        """Start or stop recording; gives the session's folder."""
        recorder = self._recording()
        if on and recorder.state.folder is not None:
            raise RefusedError("a session is being recorded already")
        try:
            if on:
                recorder.start_recording()
            else:
                recorder.stop_recording()
        except RecordingError as error:
            raise RefusedError(str(error)) from None
        self._told("recording started" if on else "recording stopped", operator)
        folder = recorder.state.folder
        return None if folder is None else str(folder)

    def mark(self, text: str, operator: str) -> dict[str, Any]:
        """Note that data acquisition begins or ends here; gives the evidence record."""
        try:
            record = self._recording().mark(text, operator)
        except RecordingError as error:
            raise RefusedError(str(error)) from None
        return {"number": record.number, "sha256": record.sha256}

    def verify(self, claim: str | None, operator: str, reason: str | None) -> dict[str, Any]:
        """Put the last frame on record, with the tube that it is claimed to be."""
        try:
            if claim is not None:
                self._rule.parse(claim)
            record = self._recording().verify(claim, operator, reason)
        except (NamingError, RecordingError) as error:
            raise RefusedError(str(error)) from None
        seen = {key: record.values.get(key) for key in ("tube_claimed", "tube_seen", "agrees", "verdict")}
        return {"number": record.number, "sha256": record.sha256, **seen}

    def _recording(self) -> SessionControl:
        if self._recorder is None:
            raise RefusedError("nothing can be recorded here; set [recording] of the station file")
        return self._recorder

    def select_input(self, name: str, operator: str) -> None:
        """Switch to another video input."""
        offered = self._watched.status().inputs
        if name not in offered:
            raise RefusedError(f"there is no input {name!r}; there is {', '.join(offered) or 'one only'}")
        self._watched.select_input(name)
        self._told(f"input is {name}", operator, input=name)

    def _told(self, what: str, operator: str, **more: Any) -> None:
        by = f", by {operator}" if operator else ""
        self._tell(f"{what}{by}", "INFO", kind="operator", operator=operator, **more)
