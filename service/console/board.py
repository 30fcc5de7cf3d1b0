"""Where the newest message waits for the pages: written by one thread, read by the server's loop."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable

__all__ = ["Board", "Posted"]


@dataclass(frozen=True, slots=True)
class Posted:
    """A message and its number: pages that have not taken it when the next one comes never see it."""

    number: int
    message: bytes


class Board:
    """Holds the newest frame's message, and wakes those who wait for it. Nothing here waits for a page."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._waiting: set[asyncio.Event] = set()
        self._wanted: Callable[[], None] | None = None
        self.newest: Posted | None = None

    @property
    def watched(self) -> bool:
        """Whether any page is open: if none is, nothing need be coded."""
        return bool(self._waiting)

    def attach(self, loop: asyncio.AbstractEventLoop | None) -> None:
        """Name the loop that pages are served from; None: there is none any more."""
        with self._lock:
            self._loop = loop

    def on_watched(self, wanted: Callable[[], None]) -> None:
        """Have `wanted` called whenever a page opens: it may want a frame that was not coded."""
        self._wanted = wanted

    def post(self, message: bytes) -> None:
        """Put up the newest message, from any thread; returns at once."""
        number = 1 if self.newest is None else self.newest.number + 1
        self.newest = Posted(number, message)
        with self._lock:
            if self._loop is not None and not self._loop.is_closed():
                self._loop.call_soon_threadsafe(self.wake)

    def wake(self) -> None:
        """Wake those who wait; in the loop's thread."""
        for event in self._waiting:
            event.set()

    def join(self, event: asyncio.Event) -> None:
        """Have `event` set with every new message; in the loop's thread."""
        self._waiting.add(event)
        if self._wanted is not None:
            self._wanted()

    def leave(self, event: asyncio.Event) -> None:
        """Undo `join`."""
        self._waiting.discard(event)
