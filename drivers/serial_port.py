"""Serial ports by name: opening them with pyserial, reading what they have, closing them, and why one does not open."""

from __future__ import annotations

import errno
import grp
import re
import socket
import termios
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

import serial

from drivers.access import holders
from drivers.errors import DeviceBusyError, DeviceError, DeviceNotFoundError, DevicePermissionError

__all__ = [
    "LINE_ERRORS",
    "SLICE_S",
    "LineSettings",
    "Port",
    "available",
    "in_words",
    "open_port",
    "opening_error",
    "port_fault",
    "shut",
]

SLICE_S = 0.05
"""Longest single wait inside pyserial, and how exactly a deadline is kept."""
CHUNK = 4096
WRITE_TIMEOUT_S = 1.0
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


def available(port: Port) -> bytes:
    """What can be read without waiting; of a socket, only byte by byte. An error after it comes again next time."""
    data = b""
    try:
        while len(data) < CHUNK and (waiting := port.in_waiting):
            data += port.read(waiting)
    except LINE_ERRORS:
        if not data:
            raise
    return data


def shut(port: Port) -> None:
    """Close a port, whatever is the matter with it."""
    if isinstance(port, serial.Serial):
        with suppress(*LINE_ERRORS):
            port.reset_output_buffer()  # else the kernel's close waits up to 30 s for a device that takes nothing
    line = getattr(port, "_socket", None)
    with suppress(*LINE_ERRORS):
        port.close()
    if line is not None:
        line.close()  # pyserial leaves it open where the other end is gone


def in_words(cause: object) -> str:
    """Give a reason in one line."""
    return " ".join(str(cause).split()) or type(cause).__name__


def opening_error(name: str, error: Exception) -> DeviceError:
    """What pyserial raised, as an error of the project's own; sockets hide theirs behind one without a number."""
    known = [e for e in (error, error.__context__) if isinstance(e, OSError) and e.errno is not None]
    code = known[0].errno if known else None
    if any(isinstance(e, socket.gaierror) for e in known):
        return DeviceNotFoundError(name, "there is no host of that name")
    if code in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return DeviceNotFoundError(name, "there is no such port; `bowlsight devices` lists those that there are")
    if code in (errno.EACCES, errno.EPERM):
        group = _group(name)
        return DevicePermissionError(name, f"it is for group {group}: sudo usermod -aG {group} $USER, and log in again")
    if code in (errno.EBUSY, errno.EWOULDBLOCK):
        return DeviceBusyError(
            name, f"it is in use by {', '.join(map(str, holders(name))) or 'another program'}; end that"
        )
    return DeviceNotFoundError(name, f"cannot be opened as a serial port: {in_words(error)}")


def _group(name: str) -> str:
    try:
        group = grp.getgrgid(Path(name).stat().st_gid).gr_name
    except (OSError, KeyError):
        group = "root"
    return "dialout" if group == "root" else group
