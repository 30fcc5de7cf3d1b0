"""Files that a command is to write: looked at before anything is measured, so that nothing is lost at the end."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from drivers.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["check_outputs"]


def check_outputs(outputs: Sequence[Path], sources: Sequence[Path]) -> None:
    """Refuse an output that is read from, that is another output too, or that cannot be written; changes none of them.

    Raises
    ------
    ConfigError
        One of them is refused.
    """
    taken = {p.resolve() for p in sources}
    for path in outputs:
        if path.resolve() in taken:
            raise ConfigError(f"{path}: is a source, or another output, already; choose another name")
        taken.add(path.resolve())
        try:
            _try_to_write(path)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be written: {error.strerror}; choose a folder that this user may write to"
            ) from None


def _try_to_write(path: Path) -> None:
    there = path.exists()
    if there and not (path.is_file() or path.is_dir()):
        return  # to open a pipe waits for its reader
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT, 0o644))
    if not there:
        path.unlink()
