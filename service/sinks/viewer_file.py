"""What the viewer shows, written to an .rrd file that opens in the same layout."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from service.sinks.queued import SinkFailedError
from service.sinks.quiet_rerun import rr
from service.sinks.viewer_stream import ViewerStream

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.sinks.viewer_drawing import Watch

__all__ = ["ViewerFileSink"]

CAPACITY = 256
"""Frames: ten seconds of television, 80 MB of it at 640x480."""
FLUSH_TICK_S = 0.5
CHECK_EVERY = 12
"""Frames from one look at whether the file still takes data to the next: half a second is what a crash may cost."""
CHECK_TIMEOUT_S = 5.0
NO_ROOM_BYTES = 1_000_000


class ViewerFileSink(ViewerStream):
    """Writes an .rrd file; `rerun FILE.rrd` opens it.

    Parameters
    ----------
    path
        The file; what is there is replaced.
    watch
        What is shown.
    """

    def __init__(self, path: Path, watch: Watch) -> None:
        batching = rr.ChunkBatcherConfig(flush_tick=FLUSH_TICK_S)
        super().__init__("viewer file", CAPACITY, watch, compress=True, batching=batching)
        self.path = path
        self._since_check = 0

    def _do_open(self, stream: rr.RecordingStream) -> None:
        remedy = "choose a folder that this user may write to"
        try:  # rerun's own message does not say enough
            os.close(os.open(self.path, os.O_WRONLY | os.O_CREAT, 0o644))
            stream.set_sinks(rr.FileSink(self.path, write_footer=False))  # a footer grows in memory all session long
        except OSError as error:
            raise ConfigError(f"{self.path}: cannot be written: {error.strerror}; {remedy}") from None
        except RuntimeError as error:
            raise ConfigError(f"{self.path}: cannot be written: {error}; {remedy}") from None

    def _do_consume(self, frame: Frame, results: Sequence[FrameResult]) -> bool:
        super()._do_consume(frame, results)
        self._since_check += 1
        if self._since_check >= CHECK_EVERY:
            self._since_check = 0
            self._check()
        return True

    def _check(self) -> None:
        assert self._stream is not None, "started"
        try:
            self._stream.flush(timeout_sec=CHECK_TIMEOUT_S)
        except RuntimeError as error:
            raise SinkFailedError(f"{self.path} takes no more data: {self._reason(error)}") from error

    def _reason(self, error: RuntimeError) -> str:
        """Say why as far as it can be found out: rerun's writer thread keeps that to itself."""
        try:
            if shutil.disk_usage(self.path.parent).free < NO_ROOM_BYTES:
                return "no space left on device"
        except OSError as gone:
            return gone.strerror or str(gone)
        return str(error)
