"""What the command line does to a terminal: one-line messages, a status line, logging, interruption."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import shutil
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import FrameType

__all__ = ["Interrupted", "StatusLine", "interruptible", "logging_to_terminal", "say", "secure_streams"]

ERASE = "\r\x1b[K"
SEPARATOR = " · "
PLAIN_EVERY_S = 5.0


def secure_streams() -> None:
    """See to it that printing never fails for a stream that is closed or a letter that it does not know."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # also: no file opened later gets its number, and what libraries print into it
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 - open to the end
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def say(message: str) -> None:
    """Print one line on standard error, whatever the message holds."""
    start = ERASE if sys.stderr.isatty() else ""
    print(f"{start}bowlsight: {' '.join(message.split())}", file=sys.stderr, flush=True)


class Interrupted(KeyboardInterrupt):
    """The user, or the system, asked for an end."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.signal = number


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Turn the first SIGINT, SIGTERM or SIGHUP into `Interrupted`; the stop that follows is not interrupted again.

    A SIGHUP that is ignored already (nohup) stays so.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked = False

    def on_signal(number: int, frame: FrameType | None) -> None:
        del frame
        nonlocal asked
        if not asked:
            asked = True
            raise Interrupted(number)

    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Formatter(logging.Formatter):
    """One line a message, above the status line; in full, with tracebacks, where verbose."""

    def __init__(self, *, verbose: bool) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")
        self._verbose = verbose

    def format(self, record: logging.LogRecord) -> str:
        start = ERASE if sys.stderr.isatty() else ""
        if self._verbose:
            return start + super().format(record)
        error = record.exc_info[1] if record.exc_info else None
        said = f"{record.getMessage()}: {error}" if error else record.getMessage()
        return f"{start}bowlsight: {' '.join(said.split())}"


@contextlib.contextmanager
def logging_to_terminal(*, verbose: bool) -> Iterator[None]:
    """Show the warnings of `service` and `drivers` on standard error; with `verbose` all they say, with times."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Formatter(verbose=verbose))
    loggers = [logging.getLogger(name) for name in ("service", "drivers")]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.DEBUG if verbose else logging.WARNING)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)
            logger.setLevel(logging.NOTSET)


class StatusLine:
    """One line on standard output, rewritten in place; plain lines, now and then, where that is no terminal."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._terminal = now_s, sys.stdout.isatty()
        self._said_s: float | None = None

    def show(self, parts: Sequence[str], brief: Sequence[str]) -> None:
        """Show the parts if they fit, else of the brief ones those that do, the first ones first."""
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            whole = SEPARATOR.join(parts)
            print(f"{ERASE}{whole if len(whole) <= width else _fitting(brief, width)}", end="", flush=True)
        elif self._said_s is None or self._now_s() - self._said_s >= PLAIN_EVERY_S:
            self._said_s = self._now_s()
            print(SEPARATOR.join(parts), flush=True)

    def clear(self) -> None:
        """Take the line away."""
        if self._terminal:
            print(ERASE, end="", flush=True)


def _fitting(parts: Sequence[str], width: int) -> str:
    text = ""
    for part in parts:
        longer = f"{text}{SEPARATOR}{part}" if text else part[:width]
        if len(longer) > width:
            break
        text = longer
    return text
