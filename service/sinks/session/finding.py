"""What checking a session finds."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Finding"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is not as it was written, or, where it is not `grave`, that is to be known."""

    file: str
    problem: str
    grave: bool = True

    def __str__(self) -> str:
        return f"{self.file}: {self.problem}"
