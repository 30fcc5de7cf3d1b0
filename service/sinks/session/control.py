"""What may be asked of a recorder while it runs: by the operator's page, or by a test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from pathlib import Path

    from service.sinks.evidence import EvidenceRecord

__all__ = ["RecordingError", "RecordingState", "SessionControl"]


class RecordingError(Exception):
    """What was asked cannot be done now; why, in a line."""


@dataclass(frozen=True, slots=True)
class RecordingState:
    """The recorder at one moment.

    Attributes
    ----------
    folder
        The session that is being recorded; None: nothing is.
    last
        That session, or else the last one there was.
    failure
        Why recording stopped, where nobody asked for that; None: it did not.
    frames, measured, evidence
        Frames recorded, of these measured, and evidence records, of this session or the last one.
    overflowed
        Frames that found no room and are not recorded.
    waiting
        Frames not yet written.
    """

    folder: Path | None = None
    failure: str | None = None
    frames: int = 0
    measured: int = 0
    evidence: int = 0
    overflowed: int = 0
    waiting: int = 0
    last: Path | None = None


class SessionControl(Protocol):
    """Starting and stopping a recording, marks and verifications. Callable from any thread; each call waits."""

    @property
    def state(self) -> RecordingState:
        """How recording does."""
        ...

    def start_recording(self) -> Path:
        """Begin a new session; gives its folder. Raises RecordingError."""
        ...

    def stop_recording(self) -> Path | None:
        """End the session, if there is one; gives its folder."""
        ...

    def mark(self, text: str, operator: str = "") -> EvidenceRecord:
        """Note that data acquisition begins or ends here; puts the frames before and after on record.

        Gives the record of the frame before. Raises RecordingError.
        """
        ...

    def verify(self, claim: str | None, operator: str = "", reason: str | None = None) -> EvidenceRecord:
        """Put the last frame measured on record; see `EvidenceLog.verify`. Raises RecordingError."""
        ...
