"""Saying what happens to the source."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Tell"]

log = logging.getLogger(__name__)


class Tell:
    """Says what happens to the source: into the log, and to whoever shows events."""

    def __init__(self, source: str, listener: Callable[[str, str], None] | None = None) -> None:
        self._source, self._listener = source, listener

    def __call__(self, text: str, level: str = "WARN") -> None:
        """Tell a line of text: INFO, WARN or ERROR."""
        line = text if text.startswith(self._source) else f"{self._source}: {text}"
        log.log({"INFO": logging.INFO, "WARN": logging.WARNING}.get(level, logging.ERROR), "%s", line)
        if self._listener is not None:
            self._listener(line, level)
