"""Having another thread do something, and waiting for what comes of it."""

from __future__ import annotations

import queue
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, TypeVar

from service.sinks.session.control import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Asked"]

T = TypeVar("T")
CAPACITY = 16
TIMEOUT_S = 5.0


class Asked:
    """What other threads want done; the one that serves it does it between other things."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[tuple[Callable[[], Any], Future[Any]]] = queue.Queue(CAPACITY)

    def ask(self, what: Callable[[], T], timeout_s: float = TIMEOUT_S) -> T:
        """Have it done; gives what it gives, raises what it raises, or RecordingError where nobody serves in time."""
        answer: Future[T] = Future()
        try:
            self._waiting.put_nowait((what, answer))
            return answer.result(timeout_s)
        except (TimeoutError, queue.Full):
            done = "" if answer.cancel() else "; it may be done yet"
            raise RecordingError(f"the disk does not answer{done}; see whether it is full or gone") from None

    def serve(self, do: Callable[[Callable[[], Any]], Any]) -> None:
        """Do all that waits, each by `do`, which may translate its errors."""
        while True:
            try:
                what, answer = self._waiting.get_nowait()
            except queue.Empty:
                return
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(do(what))
                except Exception as error:  # noqa: BLE001 - who asked is told
                    answer.set_exception(error)
