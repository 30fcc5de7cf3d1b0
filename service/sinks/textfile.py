"""A text file that holds whole lines only, whatever happens while it is written."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import TYPE_CHECKING

from drivers.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["LineFile"]


class LineFile:
    """Writes lines to a file, or to standard output where `path` is None; each reaches the system before the next.

    A line that finds no room is taken back, so that the file ends with the last whole one.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._handle: int | None = None
        self._end = 0

    def open(self) -> None:
        """Begin an empty file; raises ConfigError where it cannot be written."""
        if self.path is None:
            return
        try:
            self._handle = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)
        except OSError as error:
            raise ConfigError(
                f"{self.path}: cannot be written: {error.strerror}; choose a folder that this user may write to"
            ) from None

    def write(self, line: str) -> None:
        """Append a line; raises OSError naming the file where it cannot be written whole."""
        if self._handle is None:
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
            return
        data = (line + "\n").encode("utf-8", "surrogateescape")
        try:
            rest = data
            while rest:
                rest = rest[os.write(self._handle, rest) :]
        except OSError as error:
            with contextlib.suppress(OSError):  # a device or pipe has no length to cut
                os.ftruncate(self._handle, self._end)
            error.filename = str(self.path)
            raise
        self._end += len(data)

    def close(self) -> None:
        """Close it. May be repeated."""
        handle, self._handle = self._handle, None
        if handle is not None:
            os.close(handle)
