"""One session while it is being recorded: its frames, and what was measured of them, in the order of measuring."""

from __future__ import annotations

import collections
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from service.sinks.evidence import EvidenceLog
from service.sinks.session.places import EVIDENCE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.sinks.evidence import EvidenceRecord
    from service.sinks.session.plan import Session
    from service.sinks.session.writer import SessionWriter

__all__ = ["FrameKey", "RunningSession", "frame_key"]

PENDING_CAPACITY: Final = 4000
FrameKey: TypeAlias = tuple[int, int | None, int, int, str]


def frame_key(frame: Frame) -> FrameKey:
    """What tells a frame from all others of its source."""
    return frame.generation, frame.sequence, frame.timestamp_ns, frame.received_ns, str(frame.field)


class RunningSession:
    """Writes one session, in one thread. Calls raise OSError, or FFmpeg's error, where there is no room."""

    def __init__(self, session: Session, wall_ns: Callable[[], int], *, awaits_memory: bool = False) -> None:
        self.awaits_memory = awaits_memory
        """Whether no frame counts as measured yet, for what was remembered before the first one is still to come."""
        self.writer: SessionWriter = session.writer
        self._evidence = EvidenceLog(
            self.writer.folder / EVIDENCE,
            self.writer.sha256,
            session.context,
            witness=self.writer.evidence,
            wall_ns=wall_ns,
        )
        self._pending: collections.deque[tuple[FrameKey, int]] = collections.deque(maxlen=PENDING_CAPACITY)
        """Frames recorded of which it is not known yet whether they were measured, and their numbers."""
        self._first_ns: int | None = None
        self._last_ns = -1
        self._mark: tuple[str, str, Frame] | None = None

    @property
    def folder(self) -> Path:
        """Where it is written."""
        return self.writer.folder

    @property
    def evidence(self) -> int:
        """Evidence records so far."""
        return self._evidence.count

    def record(self, frame: Frame, wall_ns: int) -> None:
        """Append a frame that was received at that UTC."""
        number = self.writer.record(frame, wall_ns)
        self._pending.append((frame_key(frame), number))
        self._last_ns = frame.received_ns
        if self._first_ns is None:
            self._first_ns = frame.received_ns

    def answer(self, key: FrameKey | None, results: Sequence[FrameResult], *, no_more_frames: bool) -> bool:
        """Append what was measured of a frame; False where that frame is still to be recorded.

        Parameters
        ----------
        key
            The frame's; None: answers were lost here.
        no_more_frames
            Whether one that was not recorded until now never will be.
        """
        if key is None:
            if not self.awaits_memory:
                self.writer.answer(None, ())
            return True
        number = self._number_of(key)
        if number is None and self._last_ns <= key[3] and not no_more_frames:
            return False
        if self.awaits_memory and not self._remember(number, results):
            return True
        if number is not None or (self._first_ns is not None and key[3] >= self._first_ns):
            self.writer.answer(number, results)
        return True

    def _remember(self, number: int | None, results: Sequence[FrameResult]) -> bool:
        """Write what was remembered before the first frame that was recorded; False where this is not yet that one."""
        if number is None or (memory := results[0].memory) is None:
            return False
        self.awaits_memory = False
        self.writer.remember(memory)
        return True

    def _number_of(self, key: FrameKey) -> int | None:
        """The frame's number in the session; those before it were not measured, and never will be."""
        at = next((i for i, (known, _) in enumerate(self._pending) if known == key), None)
        if at is None:
            return None
        number = self._pending[at][1]
        for _ in range(at + 1):
            self._pending.popleft()
        return number

    def verify(
        self, frame: Frame, result: FrameResult, claim: str | None, operator: str, reason: str | None
    ) -> EvidenceRecord:
        """Put a frame on record."""
        record = self._evidence.verify(frame, result, claim, operator, reason)
        self._tell(record, f"verification {record.number}: {record.values['verdict'] or record.values['lock']}")
        return record

    def mark(self, frame: Frame, result: FrameResult, text: str, operator: str) -> EvidenceRecord:
        """Note a mark, with the frame before it; the next one measured follows by `after_mark`."""
        record = self._evidence.verify(frame, result, None, operator, kind="before", mark=text)
        self._tell(record, f"mark: {text}")
        self._mark = text, operator, frame
        return record

    def after_mark(self, frame: Frame, result: FrameResult) -> None:
        """Put the frame after a mark on record, where one is owed."""
        if self._mark is not None and self._mark[2] is not frame:
            (text, operator, _), self._mark = self._mark, None
            self._tell(self._evidence.verify(frame, result, None, operator, kind="after", mark=text), f"after: {text}")

    def _tell(self, record: EvidenceRecord, text: str) -> None:
        more: dict[str, Any] = {"record": record.number, "operator": record.values["operator"]}
        self.writer.event("mark" if record.values["mark"] is not None else "verify", text, **more)
