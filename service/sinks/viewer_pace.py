"""How fast a viewer takes what it is sent.

Rerun puts by hundreds of megabytes for a viewer that falls behind, which then shows what was minutes ago. Who watches
live is better off with fewer frames that are new.
"""

from __future__ import annotations

import collections
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Pace", "backlog_bytes"]

BEHIND_BYTES = 3_000_000
"""Less than the kernel would take: ten frames of 640x480."""
PERIOD_S = 0.5
"""From frame to frame while a viewer is behind."""
LOOK_S = 0.25
"""From one look at the kernel's tables, which takes milliseconds, to the next."""
ESTABLISHED = "01"
TABLES = (Path("/proc/self/net/tcp"), Path("/proc/self/net/tcp6"))


def backlog_bytes(port: int, tables: tuple[Path, ...] = TABLES) -> int:
    """Bytes that wait in the kernel for the slowest client of `port`: unsent here, and unread there if it runs here."""
    waiting: collections.Counter[str] = collections.Counter()
    suffix = f":{port:04X}"
    for table in tables:
        for line in table.read_text().splitlines()[1:] if table.exists() else []:
            local, remote, state, queues = line.split(maxsplit=5)[1:5]
            if state != ESTABLISHED:
                continue
            unsent, unread = queues.split(":")
            if local.endswith(suffix):
                waiting[remote] += int(unsent, 16)
            elif remote.endswith(suffix):
                waiting[local] += int(unread, 16)
    return max(waiting.values(), default=0)


class Pace:
    """Says which frames to send: all of them, or two a second while a viewer is behind."""

    def __init__(
        self, port: int, backlog: Callable[[int], int] = backlog_bytes, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._port, self._backlog, self._monotonic = port, backlog, monotonic
        self._sent_s = self._looked_s = -math.inf
        self._behind = False

    def due(self) -> bool:
        """Whether the next frame is to be sent."""
        now = self._monotonic()
        if now - self._looked_s >= LOOK_S:
            self._looked_s = now
            self._behind = self._backlog(self._port) > BEHIND_BYTES
        if self._behind and now - self._sent_s < PERIOD_S:
            return False
        self._sent_s = now
        return True
