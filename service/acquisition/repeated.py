"""Logging of what may happen on every frame."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import logging

    from drivers.grabber import Clock

__all__ = ["RepeatedLog"]

EVERY_S = 10.0


class RepeatedLog:
    """Log the first of each kind of message at once, then at most one in `every_s` with the count of those left out."""

    def __init__(self, logger: logging.Logger, clock: Clock, every_s: float = EVERY_S) -> None:
        self._logger, self._clock, self._every_ns = logger, clock, int(every_s * 1e9)
        self._lock = threading.Lock()
        self._said_ns: dict[str, int] = {}
        self._left_out: dict[str, int] = {}

    def warning(self, kind: str, message: str, error: BaseException | None = None) -> None:
        """Log a warning of one kind, with `error`'s traceback where details are asked for."""
        now = self._clock.monotonic_ns()
        with self._lock:
            said = self._said_ns.get(kind)
            if said is not None and now - said < self._every_ns:
                self._left_out[kind] = self._left_out.get(kind, 0) + 1
                return
            self._said_ns[kind] = now
            more = self._left_out.pop(kind, 0)
        self._logger.warning("%s%s", message, f" (and {more} more like it)" if more else "")
        if error is not None:
            self._logger.debug("traceback of that", exc_info=error)
