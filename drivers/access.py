"""Who may open a device node, and who holds it."""

from __future__ import annotations

import grp
import stat
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Holder", "holders", "how_to_permit"]

PROC = Path("/proc")
RULE = "config/deploy/70-bowlsight.rules"


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a device open."""

    pid: int
    command: str

    def __str__(self) -> str:
        return f"{self.command} (pid {self.pid})"


def holders(node: str, proc: Path = PROC) -> list[Holder]:
    """Processes that have a device node open, of those that this user may look at."""
    wanted = Path(node).resolve()
    found = []
    for folder in sorted(proc.glob("[0-9]*"), key=lambda p: int(p.name)):
        try:
            if any(link.readlink() == wanted for link in (folder / "fd").iterdir()):
                found.append(Holder(int(folder.name), (folder / "comm").read_text().strip()))
        except OSError:  # it ended, or is another user's
            continue
    return found


def how_to_permit(node: str) -> str:
    """What to do so that this user may open a device node, as the end of a sentence."""
    try:
        status = Path(node).stat()
        group = grp.getgrgid(status.st_gid).gr_name
    except (OSError, KeyError):
        return f"give it to group video with the udev rule {RULE}"
    group_may = status.st_mode & (stat.S_IRGRP | stat.S_IWGRP) == stat.S_IRGRP | stat.S_IWGRP
    if not group_may or group == "root":
        return f"it is for {group} alone: give it to group video with the udev rule {RULE}"
    return f"it is for group {group}: sudo usermod -aG {group} $USER, and log in again"
