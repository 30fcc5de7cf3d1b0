"""The result log: a JSON line a picture, as `docs/formats.md` describes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from service.sinks.base import SinkStats
from service.sinks.textfile import LineFile

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from drivers.frame import Frame
    from service.results import FrameResult

__all__ = ["JsonlWriter"]


class JsonlWriter:
    """Writes each result before it returns: for `analyze`, which may wait and drops nothing.

    Parameters
    ----------
    path
        The file; None for standard output.
    """

    name = "jsonl"

    def __init__(self, path: Path | None) -> None:
        self._file = LineFile(path)
        self._written = 0

    def start(self) -> None:
        """Open the file; raises ConfigError where it cannot be written."""
        self._file.open()

    def accept(self, frame: Frame, results: Sequence[FrameResult]) -> None:  # noqa: ARG002 - pixels are not logged
        """Write the lines of one frame; raises OSError where there is no room for them."""
        for result in results:
            self._file.write(result.to_json())
        self._written += 1

    def close(self, timeout_s: float) -> None:  # noqa: ARG002 - nothing waits to be written
        """Close the file."""
        self._file.close()

    def stats(self) -> SinkStats:
        """Frames written."""
        return SinkStats(accepted=self._written)
