"""Telling systemd that the service is ready, lives and stops: sd_notify(3) as far as it is needed."""

from __future__ import annotations

import logging
import os
import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.grabber import Clock

__all__ = ["ServiceManager"]

log = logging.getLogger(__name__)

SHARE = 0.5
"""Of the watchdog's time, after which it is told again: sd_watchdog_enabled(3) recommends half."""


class ServiceManager:
    """The service manager that started this process; where none did, nothing is told to anybody.

    Parameters
    ----------
    clock
        Paces `alive`.
    environ, pid
        The process's own, where None.
    """

    def __init__(self, clock: Clock, environ: Mapping[str, str] | None = None, pid: int | None = None) -> None:
        environ = os.environ if environ is None else environ
        self._clock = clock
        self._address = _address(environ.get("NOTIFY_SOCKET", ""))
        self.watchdog_s = _watchdog_s(environ, os.getpid() if pid is None else pid)
        """Time within which the manager wants to hear of us; None where it does not wait for it."""
        self._next_ns = 0

    def ready(self, status: str) -> bool:
        """Say that the service does its work, and how, in one line."""
        return self._tell(f"READY=1\nSTATUS={_line(status)}")

    def status(self, status: str) -> bool:
        """Say in one line how the service does."""
        return self._tell(f"STATUS={_line(status)}")

    def stopping(self) -> bool:
        """Say that the service ends."""
        return self._tell("STOPPING=1")

    def alive(self) -> bool:
        """Say that the service lives; as often as called, no more often than needed. Call it where work is done."""
        if self.watchdog_s is None or self._clock.monotonic_ns() < self._next_ns:
            return False
        self._next_ns = self._clock.monotonic_ns() + round(SHARE * self.watchdog_s * 1e9)
        return self._tell("WATCHDOG=1")

    def _tell(self, message: str) -> bool:
        """Send a message, or leave it: a service manager that does not listen must not stop the service."""
        if self._address is None:
            return False
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sending:
                sending.setblocking(False)
                sending.connect(self._address)
                sending.send(message.encode())
        except OSError as error:
            log.warning("systemd cannot be told %s: %s", message.partition("=")[0], error.strerror)
            return False
        return True


def _address(named: str) -> str | None:
    """Give the socket's address: a path, or a name without one that begins with @."""
    if named.startswith("@"):
        return f"\0{named[1:]}"
    return named if named.startswith("/") else None


def _watchdog_s(environ: Mapping[str, str], pid: int) -> float | None:
    microseconds, meant = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", str(pid))
    return int(microseconds) / 1e6 if microseconds.isdecimal() and int(microseconds) and meant == str(pid) else None


def _line(text: str) -> str:
    return " ".join(text.split())
