"""Bytes to and from a serial device: a port of this machine, or a converter on the network.

A channel opens itself when it is first used, and again when it was lost: after 0.25 s, doubling to 5 s until something
is heard again. Nothing here waits for that. A call that comes too early says so, and how long there is to wait.
"""

from __future__ import annotations

import errno
import grp
import logging
import re
import socket
import termios
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol
from urllib.parse import urlsplit

import serial

from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceStateError,
)
from drivers.grabber import SystemClock

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.grabber import Clock

__all__ = ["ByteChannel", "ChannelCounters", "LineSettings", "Port", "SerialChannel", "open_port", "port_fault"]

log = logging.getLogger(__name__)

SLICE_S = 0.05
"""Longest single wait inside pyserial, and how exactly a deadline is kept."""
CHUNK = 4096
WRITE_TIMEOUT_S = 1.0
FIRST_WAIT_S, LONGEST_WAIT_S = 0.25, 5.0
SCHEMES = ("socket", "rfc2217", "loop")
LINE_ERRORS = (OSError, ValueError, termios.error)
"""What pyserial lets through: its own SerialException is an OSError, termios.error is none."""


@dataclass(frozen=True, slots=True)
class LineSettings:
    """Speed and framing. Plain sockets and `loop://` ignore them."""

    baudrate: int = 9600
    data_bits: int = 8
    parity: str = "N"
    stop_bits: int = 1

    @classmethod
    def of(cls, baudrate: int, framing: str) -> LineSettings:
        """Take a framing as people write it, such as 8N1 or 7E1; raises ValueError where it is none."""
        if not (m := re.fullmatch(r"([78])([NEO])([12])", framing)):
            raise ValueError("must be data bits, parity and stop bits, such as 8N1 or 7E1")
        return cls(baudrate, int(m[1]), m[2], int(m[3]))


@dataclass(slots=True)
class ChannelCounters:
    """What happened on a channel since it was made."""

    opened: int = 0
    refused: int = 0
    lost: int = 0
    bytes_sent: int = 0
    bytes_received: int = 0


class Port(Protocol):
    """What is used of pyserial's ports."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once; for sockets 1 where there are any, or where the other end has gone."""
        ...

    def read(self, size: int, /) -> bytes:
        """Read up to `size` bytes, waiting at most a slice."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Write all."""
        ...

    def close(self) -> None:
        """Close."""
        ...


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


def port_fault(port: str) -> str | None:
    """Say in words why `port` names no serial port, or None: it is checked for its form, not looked for."""
    scheme, separator, rest = port.partition("://")
    if not separator:
        return None if port.startswith("/") else "must be a path such as /dev/serial/by-id/..., or socket://HOST:PORT"
    if scheme not in SCHEMES:
        return f"{scheme}:// is no kind of port; give a path, socket://HOST:PORT, rfc2217://HOST:PORT or loop://"
    try:
        parts = urlsplit(port)
        complete = parts.hostname and parts.port
    except ValueError:
        complete = None
    return None if complete or (scheme == "loop" and not rest) else f"must be like {scheme}://HOST:PORT"


def open_port(port: str, line: LineSettings) -> Port:
    """Open a port with pyserial, its reads cut into slices; raises one of LINE_ERRORS."""
    opened: Port = serial.serial_for_url(
        port,
        baudrate=line.baudrate,
        bytesize=line.data_bits,
        parity=line.parity,
        stopbits=line.stop_bits,
        # Set once: every change of it makes pyserial negotiate all settings of an rfc2217 line anew.
        timeout=SLICE_S,
        # rfc2217 refuses any; its socket times out by itself after 5 s.
        write_timeout=None if port.startswith("rfc2217:") else WRITE_TIMEOUT_S,
        exclusive=None if "://" in port else True,
    )
    return opened


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
                data = _available(port) or (b"" if late else port.read(1))
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
            _shut(port)

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
            failure = _opening_error(self.name, error)
            self._back_off(failure.message)
            raise failure from error
        self.counters.opened += 1
        log.info("%s: opened", self.name)
        return self._port

    def _lost(self, cause: Exception | str) -> DeviceDisconnectedError:
        self.counters.lost += 1
        self.close()
        self._back_off(f"connection lost ({_words(cause)})")
        log.info("%s: %s", self.name, self._reason)
        return DeviceDisconnectedError(self.name, f"{self._reason}; check its cable and power")

    def _back_off(self, reason: str) -> None:
        self._reason = reason
        self._due_ns = self.clock.monotonic_ns() + round(self._wait_s * 1e9)
        self._wait_s = min(2 * self._wait_s, LONGEST_WAIT_S)

    def _check_aborted(self) -> None:
        if self._aborted:
            raise DeviceStateError(self.name, "the channel was ended; make a new one")


def _available(port: Port) -> bytes:
    """What can be read without waiting; of a socket, only byte by byte. An error after it comes again next time."""
    data = b""
    try:
        while len(data) < CHUNK and (waiting := port.in_waiting):
            data += port.read(waiting)
    except LINE_ERRORS:
        if not data:
            raise
    return data


def _shut(port: Port) -> None:
    if isinstance(port, serial.Serial):
        with suppress(*LINE_ERRORS):
            port.reset_output_buffer()  # else the kernel's close waits up to 30 s for a device that takes nothing
    line = getattr(port, "_socket", None)
    with suppress(*LINE_ERRORS):
        port.close()
    if line is not None:
        line.close()  # pyserial leaves it open where the other end is gone


def _words(cause: object) -> str:
    return " ".join(str(cause).split()) or type(cause).__name__


def _opening_error(name: str, error: Exception) -> DeviceError:
    """What pyserial raised, as an error of the project's own; sockets hide theirs behind one without a number."""
    known = [e for e in (error, error.__context__) if isinstance(e, OSError) and e.errno is not None]
    code = known[0].errno if known else None
    if any(isinstance(e, socket.gaierror) for e in known):
        return DeviceNotFoundError(name, "there is no host of that name")
    if code in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return DeviceNotFoundError(name, "there is no such port; `bowlsight devices` lists those that there are")
    if code in (errno.EACCES, errno.EPERM):
        return DevicePermissionError(name, f"this user may not open it; add the user to the group {_group(name)}")
    if code in (errno.EBUSY, errno.EWOULDBLOCK):
        return DeviceBusyError(name, "another program holds it; end that one")
    return DeviceNotFoundError(name, f"cannot be opened as a serial port: {_words(error)}")


def _group(name: str) -> str:
    try:
        group = grp.getgrgid(Path(name).stat().st_gid).gr_name
    except (OSError, KeyError):
        group = "root"
    return "dialout" if group == "root" else group
