"""Brings frames to the pages: newest only, coded once for all of them, in a thread of its own."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any

from service.console.message import frame_head, frame_message, marks
from service.sinks.pictures import ShownPictures
from service.sinks.queued import QueuedSink

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from drivers.frame import Frame
    from drivers.grabber import Clock
    from service.config.console import ConsoleSettings
    from service.console.board import Board
    from service.console.operations import Operations
    from service.console.trend import Trend
    from service.identity.counting import NamingRule
    from service.results import FrameResult

__all__ = ["ConsoleSink"]

AHEAD = 0.75
"""Of the pause between updates, what must have passed before the next: frames of a 30 Hz source come unevenly."""


class ConsoleSink(QueuedSink):
    """Codes the newest frame for the board.

    Parameters
    ----------
    settings
        [console].
    rule
        How tubes are named.
    live
        Whether frames are timed by this machine's clock; those of recordings count from when they were read.
    start, finish
        Begin and end to serve pages.
    """

    def __init__(
        self,
        settings: ConsoleSettings,
        rule: NamingRule,
        board: Board,
        trend: Trend,
        operations: Operations,
        clock: Clock,
        *,
        live: bool,
        start: Callable[[], None],
        finish: Callable[[float], None],
    ) -> None:
        super().__init__("page", capacity=1)
        self._settings, self._rule, self._board, self._trend, self._operations = (
            settings,
            rule,
            board,
            trend,
            operations,
        )
        self._clock, self._live, self._start, self._finish = clock, live, start, finish
        self._shown = ShownPictures()
        self._sent_ns = -math.inf
        self._uncoded: tuple[Frame, FrameResult] | None = None
        self._coding = threading.Lock()
        board.on_watched(self._code_uncoded)

    def _do_start(self) -> None:
        self._start()

    def _do_finish(self, timeout_s: float) -> None:
        self._finish(timeout_s)

    def _do_abandon(self) -> None:
        self._finish(0.0)

    def _do_consume(self, frame: Frame, results: Sequence[FrameResult]) -> bool:
        result = results[-1]  # of interlaced video the field exposed last
        self._operations.follow(result)
        point = self._trend.add(frame.received_ns, result)
        now_ns = self._clock.monotonic_ns()
        if now_ns - self._sent_ns < AHEAD * 1e9 / self._settings.rate_hz:
            return False
        self._sent_ns = now_ns
        if not self._board.watched:
            self._uncoded = frame, result
            return True
        self._code(frame, result, point)
        return True

    def _code(self, frame: Frame, result: FrameResult, point: Sequence[float | None] | None) -> None:
        with self._coding:
            self._uncoded = None
            picture = self._shown.picture(frame, result.measurement.field)
            head: dict[str, Any] = {
                **frame_head(result, self._rule, self._operations.place_in(result)),
                "grabbed_ms": (frame.timestamp_ns if self._live else frame.received_ns) / 1e6,
                "defect": frame.defect,
                "size_px": [picture.shape[1], picture.shape[0]],
                "trend": point,
            }
            placed = marks(result.measurement, self._rule.lattice)
            self._board.post(frame_message(head, placed, picture, self._settings.jpeg_quality))

    def _code_uncoded(self) -> None:
        """Code the last frame for a page that opens after it: where no other follows, it would show none."""
        if (last := self._uncoded) is not None:
            self._code(*last, None)
