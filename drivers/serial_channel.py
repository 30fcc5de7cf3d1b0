"""Bytes to and from a serial device: a port of this machine, or a converter on the network.

A channel opens itself when it is first used, and again when it was lost: after 0.25 s, doubling to 5 s until something
is heard again. Nothing here waits for that. A call that comes too early says so, and how long there is to wait.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from drivers.errors import DeviceDisconnectedError, DeviceStateError
from drivers.grabber import SystemClock
from drivers.serial_port import LINE_ERRORS, LineSettings, available, in_words, open_port, opening_error, shut

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.grabber import Clock
    from drivers.serial_port import Port

__all__ = ["ByteChannel", "ChannelCounters", "SerialChannel"]

log = logging.getLogger(__name__)

FIRST_WAIT_S, LONGEST_WAIT_S = 0.25, 5.0


@dataclass(slots=True)
class ChannelCounters:
    """What happened on a channel since it was made."""

    opened: int = 0
    refused: int = 0
    lost: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0


class ByteChannel(Protocol):
    """A line to one device. One thread at a time uses it; `abort` may be called from any."""

    @property
    def name(self) -> str:
        """How errors and people call it."""
        ...

    @property
    def clock(self) -> Clock:
        """Where deadlines and time stamps come from."""
        ...

    def connect(self) -> int:
        """Open the line if it is not; returns how often it was opened. Raises DeviceError."""
        ...

    def send(self, data: bytes) -> None:
        """Send all of `data`. Raises DeviceError."""
        ...

    def receive(self, timeout_s: float) -> bytes:
        """Take what has arrived, or wait for it; b"" where nothing came in time. Raises DeviceError."""
        ...

    def drop(self, reason: str) -> None:
        """Close the line as one that was lost; it opens again when it is due."""
        ...

    def abort(self) -> None:
        """End every wait soon and refuse what comes after."""
        ...

    def close(self) -> None:
        """Close the line. May be repeated."""
        ...


class SerialChannel:
    """A `ByteChannel` over pyserial.

    Parameters
    ----------
    port
        A path (best one under /dev/serial/by-id, which survives a replug), ``socket://HOST:PORT``,
        ``rfc2217://HOST:PORT`` or ``loop://``.
    line
        Speed and framing.
    clock
        For deadlines and back-off.
    opener
        Opens the port; tests put their own here.
    """

    def __init__(
        self,
        port: str,
        line: LineSettings | None = None,
        *,
        clock: Clock | None = None,
        opener: Callable[[str, LineSettings], Port] = open_port,
    ) -> None:
        self.name = port
        self.clock: Clock = clock or SystemClock()
        self.counters = ChannelCounters()
        self._line, self._opener = line or LineSettings(), opener
        self._port: Port | None = None
        self._wait_s = FIRST_WAIT_S
        self._due_ns: int | None = None
        self._reason = ""
        self._aborted = False

    def connect(self) -> int:
        """Open the line if it is not; returns how often it was opened.

        Raises
        ------
        DeviceNotFoundError, DeviceBusyError, DevicePermissionError
            It cannot be opened now.
        DeviceDisconnectedError
            It failed a moment ago and is not due yet.
        """
        self._opened()
        return self.counters.opened

    def send(self, data: bytes) -> None:
        """Send all of `data`; raises as `connect`, or DeviceDisconnectedError where the line is lost meanwhile."""
        port = self._opened()
        try:
            port.write(data)
        except LINE_ERRORS as error:
            raise self._lost(error) from error
        self.counters.bytes_sent += len(data)

    def receive(self, timeout_s: float) -> bytes:
        """Take what has arrived, or wait for it; b"" where nothing came in time. Raises as `send`."""
        port = self._opened()
        deadline_ns = self.clock.monotonic_ns() + round(timeout_s * 1e9)
        while True:
            try:
                late = self.clock.monotonic_ns() >= deadline_ns
                data = available(port) or (b"" if late else port.read(1))
            except LINE_ERRORS as error:
                raise self._lost(error) from error
            if data:
                self.counters.bytes_received += len(data)
                self._wait_s = FIRST_WAIT_S  # an open port proves nothing: only one that speaks is back
            if data or late:
                return data
            self._check_aborted()

    def drop(self, reason: str) -> None:
        """Close the line as one that was lost; it opens again when it is due."""
        if self._port is not None:
            self._lost(reason)

    def abort(self) -> None:
        """End every wait within a slice and refuse what comes after. Safe from any thread."""
        self._aborted = True

    def close(self) -> None:
        """Close the line. May be repeated; the channel opens again when it is used again."""
        port, self._port = self._port, None
        if port is not None:
            shut(port)

    def _opened(self) -> Port:
        self._check_aborted()
        if self._port is not None:
            return self._port
        left_s = 0.0 if self._due_ns is None else (self._due_ns - self.clock.monotonic_ns()) / 1e9
        if left_s > 0:
            raise DeviceDisconnectedError(self.name, f"{self._reason}; tried again in {left_s:.1f} s")
        try:
            self._port = self._opener(self.name, self._line)
        except LINE_ERRORS as error:
            self.counters.refused += 1
            failure = opening_error(self.name, error)
            self._back_off(failure.message)
            raise failure from error
        self.counters.opened += 1
        log.info("%s: opened", self.name)
        return self._port

    def _lost(self, cause: Exception | str) -> DeviceDisconnectedError:
        self.counters.lost += 1
        self.close()
        self._back_off(f"connection lost ({in_words(cause)})")
        log.info("%s: %s", self.name, self._reason)
        return DeviceDisconnectedError(self.name, f"{self._reason}; check its cable and power")

    def _back_off(self, reason: str) -> None:
        self._reason = reason
        self._due_ns = self.clock.monotonic_ns() + round(self._wait_s * 1e9)
        self._wait_s = min(2 * self._wait_s, LONGEST_WAIT_S)

    def _check_aborted(self) -> None:
        if self._aborted:
            raise DeviceStateError(self.name, "the channel was ended; make a new one")
