"""Devices that answer on real lines: pseudo-terminals, sockets and rfc2217 on loopback, each served by a thread."""

import contextlib
import os
import select
import socket
import threading
import tty
from abc import ABC, abstractmethod
from pathlib import Path

import serial
from serial import rfc2217

ENDS_WITHIN_S = 10.0


class FakeCamera:
    """A block camera at VISCA address 1: answers what a Sony answers, and can be told to do it badly."""

    def __init__(self, *, zoom=0x2000, focus=0x1234, autofocus=True, digital_zoom=True):
        self.zoom, self.focus, self.autofocus, self.digital_zoom = zoom, focus, autofocus, digital_zoom
        self.executing = 0
        self.mute = False
        self.noise = b""
        self.error = None
        self.heard = []
        self._rest = b""

    def hear(self, data):
        *packets, self._rest = (self._rest + data).split(b"\xff")
        return b"".join(self.noise + self._answer(p) for p in packets if not self.mute)

    def _answer(self, packet):
        self.heard.append(packet)
        if packet == b"\x88\x30\x01":
            return b"\x88\x30\x02\xff"
        if packet == b"\x88\x01\x00\x01":
            return b"\x88\x01\x00\x01\xff"
        if self.error is not None:
            return bytes((0x90, 0x60, self.error, 0xFF))
        if packet == b"\x81\x09\x04\x47":
            return b"\x90\x50" + nibbles(self.zoom) + b"\xff"
        if packet == b"\x81\x09\x7e\x7e\x00":
            mode = self.autofocus + 2 * self.digital_zoom
            said = (*nibbles(self.zoom), 0, 0, *nibbles(self.focus), 0, mode, self.executing)
            return b"\x90\x50" + bytes(said) + b"\xff"
        if packet[:-1] == b"\x81\x01\x04\x38":
            self.autofocus = packet[-1] == 2
        elif packet[:-1] == b"\x81\x01\x04\x06":
            self.digital_zoom = packet[-1] == 2
        else:
            return b"\x90\x60\x02\xff"
        return b"\x90\x41\xff\x90\x51\xff"


class FakeRangeFinder:
    """Answers each line with `says`, whatever it was asked."""

    def __init__(self, says):
        self.says = says
        self.heard = []
        self._rest = b""

    def hear(self, data):
        *lines, self._rest = (self._rest + data).replace(b"\r\n", b"\r").split(b"\r")
        self.heard += lines
        return self.says * len(lines)


def nibbles(number):
    return bytes(int(digit, 16) for digit in f"{number:04x}")


class Served(ABC):
    """Whatever a thread serves until it is told to end."""

    def __init__(self, device):
        self.device = device
        self._wake, self._bell = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name=f"fake-{type(self).__name__}", daemon=True)

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace):
        self.unplug()

    def unplug(self):
        """End the service and hang up; the thread closes what it reads from, else nothing would be hung up."""
        if self._thread.is_alive():
            self._bell.send(b"x")
            self._thread.join(ENDS_WITHIN_S)
            assert not self._thread.is_alive()
        self._wake.close()
        self._bell.close()

    @abstractmethod
    def _run(self):
        """Serve until the bell rings, in the thread."""


class PtyLine(Served):
    """A pseudo-terminal, with a link to it as /dev/serial/by-id has; plugged in again it is another one."""

    def __init__(self, folder, device, name="usb-fake-port0"):
        super().__init__(device)
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = str(Path(folder) / name)
        with contextlib.suppress(FileNotFoundError):
            Path(self.path).unlink()
        Path(self.path).symlink_to(os.ttyname(self.slave))
        self._thread.start()

    def _run(self):
        while True:
            ready, _, _ = select.select([self.master, self._wake], [], [])
            if self._wake in ready:
                break
            if answer := self.device.hear(os.read(self.master, 4096)):
                os.write(self.master, answer)
        os.close(self.slave)
        os.close(self.master)
        Path(self.path).unlink()


class SocketLine(Served):
    """A converter on the network; `plain` bytes, one connection after another."""

    scheme = "socket"

    def __init__(self, device):
        super().__init__(device)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.path = f"{self.scheme}://127.0.0.1:{self._listener.getsockname()[1]}"
        self.connections = 0
        self._thread.start()

    def hang_up(self):
        """Break off the connection there is; the next is taken."""
        self._bell.send(b"h")

    def _run(self):
        with self._listener:
            while self._ready(self._listener):
                connection, _ = self._listener.accept()
                self.connections += 1
                with connection:
                    if not self._serve(connection):
                        return

    def _ready(self, source):
        """Wait for `source`: False where the bell rang instead."""
        ready, _, _ = select.select([source, self._wake], [], [])
        return self._wake not in ready

    def _serve(self, connection):
        """Serve one connection; False where all is to end."""
        talk = self._talk(connection)
        while True:
            if not self._ready(connection):
                return self._wake.recv(1) == b"h"
            try:
                data = connection.recv(4096)
            except ConnectionError:
                return True
            if not data:
                return True
            talk(data)

    def _talk(self, connection):
        return lambda data: connection.sendall(self.device.hear(data))


class Rfc2217Line(SocketLine):
    """The same, speaking rfc2217."""

    scheme = "rfc2217"

    def _talk(self, connection):
        port = serial.serial_for_url("loop://")
        manager = rfc2217.PortManager(port, _Writer(connection))

        def talk(data):
            heard = b"".join(manager.filter(data))
            connection.sendall(b"".join(manager.escape(self.device.hear(heard))))

        return talk


class _Writer:
    def __init__(self, connection):
        self.write = connection.sendall
