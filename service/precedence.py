"""Which threads go first where a processor is short. Linux ranks threads one by one; elsewhere all go side by side."""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path

__all__ = ["FIRST", "come_along", "go_between", "go_first", "go_last"]

FIRST, LAST = -10, 15
"""Niceness. The systemd unit allows the first."""


def go_first() -> None:
    """Let this thread, and those it starts, run before others; where the system does not allow it, beside them."""
    _rank(FIRST)


def go_last() -> None:
    """Let this thread, and those it starts, run after others."""
    _rank(LAST)


def go_between() -> None:
    """Let this thread, and those it starts, run only when no other wants to: one that does takes its place at once."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(threading.get_native_id(), os.SCHED_IDLE, os.sched_param(0))


def come_along() -> None:
    """Let all threads of this process that go between others run beside them, where the system allows it: it ends."""
    with contextlib.suppress(FileNotFoundError):
        for task in Path("/proc/self/task").iterdir():
            with contextlib.suppress(OSError):  # it may not, or the thread has ended
                if os.sched_getscheduler(int(task.name)) == os.SCHED_IDLE:
                    os.sched_setscheduler(int(task.name), os.SCHED_OTHER, os.sched_param(0))


def _rank(nice: int) -> None:
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), nice)
