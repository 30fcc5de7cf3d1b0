"""Seeing to it that recording fills neither the disk nor its folder."""

from __future__ import annotations

import shutil
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from service.sinks.session.control import RecordingError
from service.sinks.session.retention import delete_old

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from service.config.recording import RecordingSettings

__all__ = ["Upkeep", "free_bytes"]

DISK_EVERY_S, RETENTION_EVERY_S = 1.0, 600.0
MIB: Final = 2**20


def free_bytes(folder: Path) -> int:
    """What is free where a folder is; raises OSError."""
    return shutil.disk_usage(folder).free


class Upkeep:
    """Looks at the disk every second, and deletes old sessions every ten minutes, in a thread that is none of ours.

    Parameters
    ----------
    root
        The folder of sessions.
    settings
        What is to be kept, and kept free.
    told
        Takes what was deleted, in words; from any thread.
    wall_s
        UTC since 1970.
    free
        What is free where a folder is.
    """

    def __init__(
        self,
        root: Path,
        settings: RecordingSettings,
        told: Callable[[str], None],
        wall_s: Callable[[], float],
        free: Callable[[Path], int] = free_bytes,
    ) -> None:
        self._root, self._settings, self._told, self._wall_s, self._free = root, settings, told, wall_s, free
        self._looked_s = self._kept_s = float("-inf")
        self._keeping: threading.Thread | None = None

    def look(self, now_s: float, folder: Path | None) -> None:
        """Do what is due; raises RecordingError where the disk of the session in `folder` is all but full."""
        if now_s - self._kept_s >= RETENTION_EVERY_S and (self._keeping is None or not self._keeping.is_alive()):
            self._kept_s = now_s
            self._keeping = threading.Thread(target=self._keep, name="bowlsight-retention", daemon=True)
            self._keeping.start()
        if folder is not None and now_s - self._looked_s >= DISK_EVERY_S:
            self._looked_s = now_s
            self._check_room(folder)

    def _check_room(self, folder: Path) -> None:
        left, keep = self._free(folder) / MIB, self._settings.keep_free_mib
        if left < keep:
            raise RecordingError(
                f"{folder}: {left:.0f} MiB are left on the disk, and {keep:g} MiB are to stay free;"
                " delete old sessions, or set [recording] max_size_gib"
            )

    def _keep(self) -> None:
        with suppress(OSError):  # no such folder yet
            s = self._settings
            for text in delete_old(self._root, self._wall_s(), s.max_age_days, s.max_size_gib):
                self._told(text)

    def close(self, timeout_s: float) -> None:
        """Wait a little for what is being deleted; the rest goes the next time."""
        if self._keeping is not None:
            self._keeping.join(timeout_s)
