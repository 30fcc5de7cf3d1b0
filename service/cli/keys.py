"""Single keys from the terminal, without Enter and without waiting."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["pressed_keys"]


@contextlib.contextmanager
def pressed_keys() -> Iterator[Callable[[], str] | None]:
    """Give a function that tells the keys pressed since it was last asked; None where there is no terminal.

    Ctrl-C stays what it is. A service in the background never reads: the shell would stop it.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        yield None
        return
    handle = sys.stdin.fileno()
    before = termios.tcgetattr(handle)
    tty.setcbreak(handle, termios.TCSANOW)
    try:
        yield lambda: _read(handle)
    finally:
        termios.tcsetattr(handle, termios.TCSANOW, before)


def _read(handle: int) -> str:
    if os.tcgetpgrp(handle) != os.getpgrp() or not select.select([handle], [], [], 0)[0]:
        return ""
    return os.read(handle, 64).decode("ascii", "ignore")
