"""The live viewer: rerun's data served on loopback, to browsers and native viewers, and the page for the browser."""

from __future__ import annotations

import contextlib
import logging
import shlex
import sysconfig
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from service.precedence import come_along, go_between
from service.sinks.ports import falls_silent, free_port, is_loopback, listens
from service.sinks.quiet_rerun import rr
from service.sinks.viewer_pace import Pace
from service.sinks.viewer_page import ViewerPage, rerun_program
from service.sinks.viewer_stream import ViewerStream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.sinks.base import SourceState
    from service.sinks.viewer_drawing import Watch

__all__ = ["ViewerSink"]

log = logging.getLogger(__name__)

CAPACITY = 2
"""What waits longer than two frames is no longer what the camera sees."""
GRPC_PORT, WEB_PORT = 9876, 9090
START_TIMEOUT_S = 20.0
PACK_TIMEOUT_S = 0.2
SILENT_TIMEOUT_S = 0.2
BY_FRAME = rr.ChunkBatcherConfig(flush_tick=1.0, flush_num_bytes=2**30, flush_num_rows=2**20)
"""Send nothing before a frame is complete: half of one would be shown with half of the last."""


class ViewerSink(ViewerStream):
    """Shows frames live. Whatever becomes of a viewer costs frames of this sink only, and they are counted.

    Parameters
    ----------
    watch
        What is shown.
    address
        Where to listen: an IPv4 address of loopback, for there is no authentication.
    port, web_port
        Of the data and of the page; None: 9876 and 9090, or the next free ones.
    memory_limit
        What is kept for viewers that come later: 512MiB hold the last minute of 640x480.
    """

    def __init__(
        self,
        watch: Watch,
        *,
        address: str = "127.0.0.1",
        port: int | None = None,
        web_port: int | None = None,
        memory_limit: str = "512MiB",
    ) -> None:
        super().__init__("viewer", CAPACITY, watch, compress=False, batching=BY_FRAME)
        self._address, self._memory_limit = address, memory_limit
        self._wanted_port, self._wanted_web_port = port, web_port
        self._page: ViewerPage | None = None
        self._pace: Pace | None = None
        self._packed = True
        self._port: int | None = None

    @property
    def url(self) -> str:
        """What to open in a browser, once started."""
        assert self._page is not None, "started"
        return self._page.url

    @property
    def grpc_url(self) -> str:
        """What to open in a native viewer, once started."""
        assert self._page is not None, "started"
        return self._page.grpc_url

    @property
    def native_command(self) -> str:
        """The command that opens the native viewer, once started."""
        script = Path(sysconfig.get_path("scripts")) / "rerun"
        return shlex.join([str(script if script.exists() else rerun_program()), self.grpc_url])

    def close(self, timeout_s: float) -> None:
        """As every sink; the page goes first."""
        if self._page is not None:
            self._page.close()
        super().close(timeout_s)

    def _do_consume(self, frame: Frame, results: Sequence[FrameResult]) -> bool:
        assert self._pace is not None, "started"
        if not (self._packed or self._send()) or not self._pace.due():
            return False
        super()._do_consume(frame, results)
        self._send()
        return True

    def _do_event(self, text: str, level: str) -> None:
        super()._do_event(text, level)
        self._begin_to_send()

    def _do_state(self, state: SourceState) -> None:
        super()._do_state(state)
        self._begin_to_send()

    def _begin_to_send(self) -> None:
        """Send what was drawn, without waiting for it: events may come by the hundred."""
        assert self._stream is not None, "started"
        with contextlib.suppress(RuntimeError):
            self._stream.flush(timeout_sec=0.0)

    def _send(self) -> bool:
        """Wait until rerun has packed what was drawn; False where it has not in time, and is to get no more until then.

        Its threads have what time the others leave. Frames that it lacks the time for are better let go here, where
        they are counted, than put by there, to be shown when they are old.
        """
        assert self._stream is not None, "started"
        try:
            self._stream.flush(timeout_sec=PACK_TIMEOUT_S)
        except RuntimeError:
            self._packed = False
        else:
            self._packed = True
        return self._packed

    def _do_finish(self, timeout_s: float) -> None:
        deadline = time.monotonic() + timeout_s
        come_along()  # on a busy machine rerun would need many seconds to send what is left, and to end
        super()._do_finish(timeout_s)
        assert self._port is not None, "started"
        # Its server ends when it gets to it, and not at all before viewers that are still there
        falls_silent(self._address, self._port, min(SILENT_TIMEOUT_S, (deadline - time.monotonic()) / 2))

    def _do_open(self, stream: rr.RecordingStream) -> None:
        address = self._address
        if not is_loopback(address):
            raise ConfigError(
                f"viewer address = {address!r}: must be of this machine, as 127.0.0.1: nobody who looks on is asked "
                "for a password; from elsewhere come by way of ssh -L"
            )
        port = free_port(address, self._wanted_port, GRPC_PORT, "viewer port")
        web_port = free_port(address, self._wanted_web_port, WEB_PORT, "viewer web port")
        sink = rr.GrpcServerSink(address, port, server_memory_limit=self._memory_limit)
        _in_the_background(lambda: stream.set_sinks(sink))
        if not listens(address, port, START_TIMEOUT_S):
            raise ConfigError(f"viewer port = {port} at {address}: rerun does not listen there; name another port")
        self._page = ViewerPage(address, web_port, f"rerun+http://{address}:{port}/proxy")
        self._page.start()
        self._pace, self._port = Pace(port), port
        for what, used, default in (("port", port, GRPC_PORT), ("web port", web_port, WEB_PORT)):
            if getattr(self, f"_wanted_{what.replace(' ', '_')}") is None and used != default:
                log.warning("viewer: %s %d is in use; listening on %d instead", what, default, used)


def _in_the_background(start: Callable[[], None]) -> None:
    """Call `start` so that the threads which it starts run only when no other wants to.

    Rerun packs every picture, which takes a good part of a core: beside measuring, not before it. The system gives a
    thread's rank to those that it starts, and takes no rank back that was given up: hence a thread for this alone.
    """
    with ThreadPoolExecutor(1, "bowlsight-viewer-start", initializer=go_between) as thread:
        thread.submit(start).result()
