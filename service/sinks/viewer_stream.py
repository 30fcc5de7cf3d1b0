"""What the live viewer and its recording share: one rerun stream behind a queue of its own.

A viewer that does not read holds up the stream it is fed from, so each destination has its own: the same application
and recording, drawn twice, and nothing that befalls one reaches the other.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

from service.sinks.queued import QueuedSink
from service.sinks.quiet_rerun import rr
from service.sinks.viewer_blueprint import blueprint
from service.sinks.viewer_drawing import SIZE_PX, FrameDrawing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.sinks.base import SourceState
    from service.sinks.viewer_drawing import Watch

__all__ = ["APPLICATION", "ViewerStream"]

APPLICATION = "bowlsight"
DISTANCE_MM = 1000.0
"""What the views are laid out for until a frame tells better."""


class ViewerStream(QueuedSink):
    """Draws frames into a rerun stream; subclasses say where that leads.

    Parameters
    ----------
    name, capacity
        As in `QueuedSink`.
    watch
        What is shown.
    compress
        As in `FrameDrawing`.
    batching
        When drawn data is sent.
    """

    def __init__(
        self, name: str, capacity: int, watch: Watch, *, compress: bool, batching: rr.ChunkBatcherConfig
    ) -> None:
        super().__init__(name, capacity)
        self._watch, self._drawing = watch, FrameDrawing(watch, compress=compress)
        self._batching = batching
        self._fitted_px: tuple[int, int] | None = None
        self._framed = False
        self._stream: rr.RecordingStream | None = None

    @abstractmethod
    def _do_open(self, stream: rr.RecordingStream) -> None:
        """Lead the stream to where it goes; raises ConfigError where that is not to be had."""

    def _do_start(self) -> None:
        stream = rr.RecordingStream(APPLICATION, recording_id=self._watch.recording_id, batcher_config=self._batching)
        self._do_open(stream)
        stream.send_blueprint(blueprint(SIZE_PX, DISTANCE_MM))
        self._drawing.prepare(stream)
        self._stream = stream

    def _do_consume(self, frame: Frame, results: Sequence[FrameResult]) -> bool:
        assert self._stream is not None, "started"
        size_px = self._drawing.draw(self._stream, frame, results)
        pose = results[0].measurement.pose
        if size_px != self._fitted_px or (pose is not None and not self._framed):
            self._fitted_px, self._framed = size_px, pose is not None
            self._stream.send_blueprint(blueprint(size_px, pose.distance_mm if pose else DISTANCE_MM))
        return True

    def _do_event(self, text: str, level: str) -> None:
        assert self._stream is not None, "started"
        self._drawing.event(self._stream, text, level)

    def _do_state(self, state: SourceState) -> None:
        assert self._stream is not None, "started"
        self._drawing.state(self._stream, state)

    def _do_finish(self, timeout_s: float) -> None:
        stream, self._stream = self._stream, None
        assert stream is not None, "started"
        try:
            stream.flush(timeout_sec=timeout_s)
        finally:
            stream.disconnect()

    def _do_abandon(self) -> None:
        # Rerun flushes all streams at the interpreter's end, without a limit: a stopped viewer would hold up the exit
        rr.unregister_shutdown()
