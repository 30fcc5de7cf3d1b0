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

BACKLOG_BYTES = 50_000
"""Below what a native viewer that does not read lets the kernel take: 0.2 MB. A browser lets it take 10."""
LOOK_S, LOOKS = 0.5, 3
"""A viewer is behind that had a backlog at so many looks at the kernel's tables in a row; a look takes milliseconds."""
PERIOD_S = 0.5
"""From frame to frame while a viewer is behind."""
ESTABLISHED = "01"
TABLE = Path("/proc/self/net/tcp")


def backlog_bytes(port: int, table: Path = TABLE) -> int:
    """Bytes that wait in the kernel for the slowest client of `port`: unsent here, and unread there if it runs here."""
    waiting: collections.Counter[str] = collections.Counter()
    suffix = f":{port:04X}"
    for line in table.read_text().splitlines()[1:]:
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
        self._backlogs = 0

    def due(self) -> bool:
        """Whether the next frame is to be sent."""
        now = self._monotonic()
        if now - self._looked_s >= LOOK_S:
            self._looked_s = now
            self._backlogs = self._backlogs + 1 if self._backlog(self._port) > BACKLOG_BYTES else 0
        if self._backlogs >= LOOKS and now - self._sent_s < PERIOD_S:
            return False
        self._sent_s = now
        return True
