"""The station file's [recording]: whether a session is recorded, where, and what is kept."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from service.config.table import Table

__all__ = ["RecordingSettings", "default_folder", "recording_settings"]


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """[recording].

    Attributes
    ----------
    folder
        Where session folders are made; None: `default_folder`.
    csv, viewer
        What is written beside video, index, results and events.
    operator
        Who is at the station, where nobody says.
    keep_free_mib
        Recording stops where less is left on the disk.
    max_age_days, max_size_gib
        Older sessions, and the oldest of more, are deleted; None: never.
    """

    enabled: bool = False
    folder: Path | None = None
    csv: bool = False
    viewer: bool = True
    operator: str = ""
    keep_free_mib: float = 500.0
    max_age_days: float | None = None
    max_size_gib: float | None = None


def default_folder(environ: Mapping[str, str] | None = None) -> Path:
    """Where sessions are: systemd's state directory, else the user's own data folder."""
    environ = os.environ if environ is None else environ
    if state := environ.get("STATE_DIRECTORY", "").partition(":")[0]:
        return Path(state) / "sessions"
    data = Path(environ.get("XDG_DATA_HOME", ""))
    return (data if data.is_absolute() else Path.home() / ".local/share") / "bowlsight/sessions"


def recording_settings(t: Table, folder: Path) -> RecordingSettings:
    """Read [recording]; `folder` is the station file's."""
    default, named = RecordingSettings(), t.text("folder", None)
    if named is not None and not named.strip():
        raise t.error("folder", "must name a folder, or be left out for the usual one")
    settings = RecordingSettings(
        enabled=t.flag("enabled", default.enabled),
        folder=None if named is None else folder / Path(named).expanduser(),
        csv=t.flag("csv", default.csv),
        viewer=t.flag("viewer", default.viewer),
        operator=t.text("operator", default.operator),
        keep_free_mib=t.number("keep_free_mib", default.keep_free_mib, minimum=0),
        max_age_days=t.number("max_age_days", None, above=0),
        max_size_gib=t.number("max_size_gib", None, above=0),
    )
    t.finish()
    return settings
