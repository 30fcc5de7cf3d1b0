"""Which threads go first where a processor is short."""

from __future__ import annotations

import contextlib
import os
import threading

__all__ = ["go_first"]

NICE = -10


def go_first() -> None:
    """Let this thread, and those it starts, run before others; where the system does not allow it, beside them."""
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)  # Linux: of a thread
