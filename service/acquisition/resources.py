"""What this process holds of the machine's memory, descriptors and threads."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Resources", "resources"]

PROC = Path("/proc/self")


@dataclass(frozen=True, slots=True)
class Resources:
    """At one moment; None where the system does not tell.

    Attributes
    ----------
    rss_bytes
        Memory resident.
    fds, threads
        Files open, and threads of any library.
    """

    rss_bytes: int | None = None
    fds: int | None = None
    threads: int | None = None


def resources(proc: Path = PROC) -> Resources:
    """What this process holds now."""
    try:
        pages = int((proc / "statm").read_text(encoding="ascii").split()[1])
        fds, threads = (sum(1 for _ in (proc / of).iterdir()) for of in ("fd", "task"))
    except (OSError, ValueError, IndexError):
        return Resources()
    return Resources(pages * os.sysconf("SC_PAGE_SIZE"), fds, threads)
