"""Plugs a device written in Python into the kernel's virtual USB host controller, vhci_hcd, over a pair of sockets.

The messages are those of the kernel's Documentation/usb/usbip_protocol.rst. One thread answers them and sends the
frames, so that a request is either still waiting or answered when its cancellation comes: in between, the kernel would
drop the device.
"""

import contextlib
import select
import socket
import struct
import threading
import time
from collections import deque
from pathlib import Path

from tests.fakes.uvc import FakeUvcDevice, StallError

CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
EPIPE, ECONNRESET = -32, -104
HIGH_SPEED = 3
HELD_PAYLOADS = 2


class Plug:
    """A device that is plugged in from `attach` to `unplug`.

    Attributes
    ----------
    halted
        Its endpoint stalls until that is cleared.
    hung
        It sends nothing until it is begun anew.
    """

    def __init__(self, device: FakeUvcDevice, port: int = 0):
        self.device, self.port = device, port
        self.halted = self.hung = False
        self.frames = 0
        """How many it sent since it was begun."""
        self._waiting: deque[tuple[int, int]] = deque()
        self._payloads: deque[bytes] = deque()
        self._next_s = 0.0
        self._commits = device.commits

    def attach(self) -> "Plug":
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        (CONTROLLER / "attach").write_text(f"{self.port} {theirs.fileno()} {self.port + 0x10002} {HIGH_SPEED}")
        theirs.close()
        self._thread = threading.Thread(target=self._serve, name="usbip")
        self._thread.start()
        return self

    def unplug(self):
        with contextlib.suppress(OSError):  # it is out already
            (CONTROLLER / "detach").write_text(str(self.port))
        self._thread.join(20.0)
        assert not self._thread.is_alive()
        self._socket.close()

    # -- messages ------------------------------------------------------------------------------------------------------

    def _serve(self):
        with contextlib.suppress(EOFError, OSError):
            while True:
                sending = self.device.streaming and not (self.hung or self.halted)
                pause_s = max(0.0, self._next_s - time.monotonic()) if sending else 1.0
                if select.select([self._socket], [], [], 0.0 if self._payloads and self._waiting else pause_s)[0]:
                    self._take_message()
                self._send_frames()

    def _receive(self, count: int) -> bytes:
        got = b""
        while len(got) < count:
            part = self._socket.recv(count - len(got))
            if not part:
                raise EOFError
            got += part
        return got

    def _take_message(self):
        head = self._receive(48)
        command, number, _, inwards, endpoint = struct.unpack_from(">IIIII", head)
        if command == UNLINK:
            self._cancel(number, struct.unpack_from(">I", head, 20)[0])
            return
        length = struct.unpack_from(">i", head, 24)[0]
        data = b"" if inwards else self._receive(length)
        if endpoint:
            self._waiting.append((number, length))
            return
        kind, request, value, index, _ = struct.unpack_from("<BBHHH", head, 40)
        try:
            answer = self.device.request(kind, request, value, index, length, data)
        except StallError:
            self._answer(number, EPIPE)
            return
        self._look_at(kind, request)
        self._answer(number, 0, answer if inwards else b"", length=None if inwards else length)

    def _look_at(self, kind: int, request: int):
        """What a request does beside its answer."""
        if (kind, request) in {(0x02, 1), (0x00, 9)}:
            self.halted = self.device.streaming = False
        if self.device.commits != self._commits:
            self._commits, self.hung, self.frames = self.device.commits, False, 0
            self._payloads.clear()
            self._next_s = time.monotonic() + self.device.period_ns / 1e9

    def _answer(self, number: int, status: int, data: bytes = b"", length: int | None = None):
        told = len(data) if length is None else length
        self._socket.sendall(struct.pack(">IIIIIiiiii8x", SUBMITTED, number, 0, 0, 0, status, told, 0, 0, 0) + data)

    def _cancel(self, number: int, target: int):
        found = [w for w in self._waiting if w[0] == target]
        for waiting in found:
            self._waiting.remove(waiting)
        status = ECONNRESET if found else 0
        self._socket.sendall(struct.pack(">IIIIIi24x", UNLINKED, number, 0, 0, 0, status))

    # -- frames --------------------------------------------------------------------------------------------------------

    def _send_frames(self):
        if self.halted:
            while self._waiting:
                self._answer(self._waiting.popleft()[0], EPIPE)
        if not self.device.streaming or self.halted or self.hung:
            self._payloads.clear()
            return
        self._make_frames()
        if self._waiting and self._payloads:
            number, length = self._waiting.popleft()
            payload = self._payloads.popleft()
            if len(payload) > length:
                self._payloads.appendleft(payload[length:])
            self._answer(number, 0, payload[:length])

    def _make_frames(self):
        now_s, period_s = time.monotonic(), self.device.period_ns / 1e9
        if now_s < self._next_s:
            return
        self._next_s = max(self._next_s + period_s, now_s - period_s)
        if len(self._payloads) <= HELD_PAYLOADS:
            now_ns = time.monotonic_ns()
            self._payloads.extend(self.device.payloads(self.frames, now_ns - 1_000_000, now_ns))
            self.frames += 1
