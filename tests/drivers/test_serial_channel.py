import errno
import os
import socket
import struct
import termios
import threading
from pathlib import Path

import pytest
import serial
from serial.urlhandler import protocol_socket

from drivers import serial_port
from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceStateError,
)
from drivers.serial_channel import SerialChannel
from drivers.serial_port import LineSettings, port_fault
from tests.fakes.clock import HurriedClock, ManualClock
from tests.fakes.serial_devices import FakeRangeFinder, PtyLine, Rfc2217Line, SocketLine

ANSWER_S = 60.0
"""How long an answer is waited for that must come; never how long it takes."""

rfc2217_is_dated = pytest.mark.filterwarnings("ignore:set(Daemon|Name)..:DeprecationWarning")


class FakePort:
    """A port whose reads and whose `in_waiting` do what the test says; a silent read takes a slice of time."""

    def __init__(self, clock, reads=()):
        self.clock, self.reads = clock, list(reads)
        self.written, self.closed = [], 0
        self.waiting_fails = None

    @property
    def in_waiting(self):
        if self.waiting_fails:
            raise self.waiting_fails
        return 0

    def read(self, size):
        step = self.reads.pop(0) if self.reads else b""
        if isinstance(step, Exception):
            raise step
        if not step:
            self.clock.advance(serial_port.SLICE_S)
        return step

    def write(self, data):
        self.written.append(data)

    def close(self):
        self.closed += 1


class Ports:
    """An opener that gives one port after another, or raises; and when it was asked."""

    def __init__(self, clock, *steps):
        self.clock, self.steps, self.asked_ns = clock, list(steps), []

    def __call__(self, name, line):
        self.asked_ns.append(self.clock.now_ns)
        step = self.steps.pop(0) if len(self.steps) > 1 else self.steps[0]
        if isinstance(step, Exception):
            raise step
        return step


def channel_of(*steps):
    clock = ManualClock()
    opener = Ports(clock, *steps)
    return SerialChannel("/dev/fake", clock=clock, opener=opener), opener, clock


@pytest.mark.parametrize("port", ["/dev/ttyUSB0", "/dev/serial/by-id/x", "socket://h:1", "rfc2217://h:1", "loop://"])
def test_these_are_ports(port):
    assert port_fault(port) is None


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("ttyUSB0", "path such as"),
        ("", "path such as"),
        ("COM1", "path such as"),
        ("spy:///dev/ttyS0", "spy:// is no kind of port"),
        ("socket://", "socket://HOST:PORT"),
        ("socket://h", "socket://HOST:PORT"),
        ("socket://h:x", "socket://HOST:PORT"),
        ("socket://h:99999", "socket://HOST:PORT"),
        ("rfc2217://:1", "rfc2217://HOST:PORT"),
        ("loop://x", "must be like"),
        ("socket://[::1", "socket://HOST:PORT"),
    ],
)
def test_these_are_none_and_it_is_said_why(port, words):
    assert words in port_fault(port)


@pytest.mark.parametrize("framing", ["", "8N3", "9N1", "8n1", "8N1 ", "8M1"])
def test_a_framing_that_is_none_is_refused(framing):
    assert LineSettings.of(19200, "7E1") == LineSettings(19200, 7, "E", 1)
    with pytest.raises(ValueError, match="7E1"):
        LineSettings.of(9600, framing)


# -- real lines --------------------------------------------------------------------------------------------------------


def ask(channel, question=b"q\r"):
    channel.send(question)
    data = b""
    while not data.endswith(b"\n"):
        data += (piece := channel.receive(ANSWER_S))
        assert piece, "no answer"
    return data


def hear_out(channel):
    """Receive until the line is lost."""
    data = b""
    for _ in range(1000):
        try:
            data += channel.receive(ANSWER_S)
        except DeviceDisconnectedError:
            return data
    pytest.fail("never lost")


def test_what_is_sent_into_a_loop_comes_back():
    channel = SerialChannel("loop://")
    channel.send(b"hello")
    data = b""
    while len(data) < 5:
        data += channel.receive(ANSWER_S)
    assert data == b"hello"
    assert (channel.counters.opened, channel.counters.bytes_sent, channel.counters.bytes_received) == (1, 5, 5)
    channel.close()


def test_silence_ends_at_the_deadline(tmp_path):
    with PtyLine(tmp_path, FakeRangeFinder(b"")) as line:
        channel = SerialChannel(line.path)
        assert channel.receive(0) == b""
        assert channel.receive(0.12) == b""
        channel.close()


def test_an_unplugged_port_is_told_and_found_again_where_its_link_points(tmp_path):
    clock = HurriedClock()
    channel = SerialChannel(str(tmp_path / "usb-fake-port0"), clock=clock)
    with PtyLine(tmp_path, FakeRangeFinder(b"one\n")) as line:
        assert ask(channel) == b"one\n"
        node = Path(line.path).readlink()
    with pytest.raises(DeviceDisconnectedError, match="connection lost"):
        channel.receive(ANSWER_S)
    stand_in = os.openpty()  # so that the next one has another number
    clock.advance(10)
    with pytest.raises(DeviceNotFoundError, match="no such port"):
        channel.connect()
    clock.advance(10)
    with PtyLine(tmp_path, FakeRangeFinder(b"two\n")) as line:
        assert Path(line.path).readlink() != node
        assert ask(channel) == b"two\n"
        assert channel.connect() == 2
        assert (channel.counters.lost, channel.counters.refused) == (1, 1)
        channel.close()
    for fd in stand_in:
        os.close(fd)


def test_a_port_that_takes_nothing_more_is_lost_not_waited_for(monkeypatch):
    monkeypatch.setattr(serial_port, "WRITE_TIMEOUT_S", 0.1)
    master, slave = os.openpty()
    channel = SerialChannel(os.ttyname(slave))
    with pytest.raises(DeviceDisconnectedError, match="Write timeout"):
        channel.send(bytes(1 << 20))
    os.close(master)
    os.close(slave)


def test_a_port_that_another_holds_is_busy(tmp_path):
    with PtyLine(tmp_path, FakeRangeFinder(b"one\n")) as line:
        first, second = SerialChannel(line.path), SerialChannel(line.path)
        first.connect()
        with pytest.raises(DeviceBusyError, match=rf"in use by .*pid {os.getpid()}"):
            second.connect()
        first.close()
        first.close()


def test_what_is_no_port_is_told_in_a_line(tmp_path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder").mkdir()
    for name, words in (("none", "no such port"), ("file", "cannot be opened"), ("folder", "cannot be opened")):
        with pytest.raises(DeviceNotFoundError, match=words) as error:
            SerialChannel(str(tmp_path / name)).connect()
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", [SocketLine, pytest.param(Rfc2217Line, marks=rfc2217_is_dated)])
def test_a_converter_on_the_network_answers_hangs_up_and_is_found_again(kind):
    clock = HurriedClock()
    with kind(FakeRangeFinder(b"a\xffb\n")) as line:
        channel = SerialChannel(line.path, clock=clock)
        assert ask(channel) == b"a\xffb\n"
        line.hang_up()
        hear_out(channel)
        clock.advance(10)
        assert ask(channel) == b"a\xffb\n"
        assert (channel.connect(), line.connections) == (2, 2)
        channel.close()
    clock.advance(10)
    with pytest.raises(DeviceNotFoundError, match="refused"):
        channel.connect()


def test_what_came_before_a_hang_up_is_not_lost_with_it():
    listener = socket.create_server(("127.0.0.1", 0))
    channel = SerialChannel(f"socket://127.0.0.1:{listener.getsockname()[1]}")
    channel.connect()
    server, _ = listener.accept()
    server.sendall(b"last words")
    server.close()
    listener.close()
    assert hear_out(channel) == b"last words"


def test_a_socket_reset_by_its_other_end_is_closed_and_not_left_to_chance():
    listener = socket.create_server(("127.0.0.1", 0))
    channel = SerialChannel(f"socket://127.0.0.1:{listener.getsockname()[1]}")
    channel.connect()
    held = channel._port._socket
    server, _ = listener.accept()
    server.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    server.close()
    listener.close()
    hear_out(channel)
    assert held.fileno() == -1


def test_a_converter_that_does_not_answer_is_given_up(monkeypatch):
    monkeypatch.setattr(protocol_socket, "POLL_TIMEOUT", 0.2)
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    listener.listen(0)
    address = listener.getsockname()
    fill = [socket.socket() for _ in range(4)]
    for s in fill:
        s.setblocking(False)
        s.connect_ex(address)
    with pytest.raises(DeviceNotFoundError, match="timed out"):
        SerialChannel(f"socket://127.0.0.1:{address[1]}").connect()
    for s in (*fill, listener):
        s.close()


def test_a_wait_is_ended_from_another_thread(tmp_path):
    with PtyLine(tmp_path, FakeRangeFinder(b"")) as line:
        channel, ended = SerialChannel(line.path), []
        channel.connect()

        def wait():
            with pytest.raises(DeviceStateError, match="ended"):
                channel.receive(600)
            ended.append(True)

        thread = threading.Thread(target=wait)
        thread.start()
        channel.abort()
        thread.join(ANSWER_S)
        assert ended
        with pytest.raises(DeviceStateError):
            channel.send(b"x")
        channel.close()


# -- the back-off, on ports of paper -----------------------------------------------------------------------------------


def test_attempts_to_open_are_spaced_out_and_waited_for_by_nobody():
    channel, opener, clock = channel_of(serial.SerialException(errno.ENOENT, "gone"))
    for _ in range(2400):
        with pytest.raises((DeviceNotFoundError, DeviceDisconnectedError)):
            channel.connect()
        clock.advance(0.01)
    at_s = [round((t - 1_000_000_000) / 1e9, 2) for t in opener.asked_ns]
    assert at_s == [0, 0.25, 0.75, 1.75, 3.75, 7.75, 12.75, 17.75, 22.75]
    assert channel.counters.refused == len(at_s)


def test_a_port_that_opens_but_hangs_up_at_once_is_backed_off_too_until_something_is_heard():
    clock = ManualClock()
    hung = [FakePort(clock, [serial.SerialException("device disconnected?")]) for _ in range(3)]
    spoke = FakePort(clock, [b"x", OSError(errno.EIO, "I/O error")])
    opener = Ports(clock, *hung, spoke, FakePort(clock))
    channel = SerialChannel("/dev/fake", clock=clock, opener=opener)
    waits = []
    for _ in range(4):
        hear_out(channel)
        lost_ns = clock.now_ns
        while channel._port is None:
            try:
                channel.connect()
            except DeviceDisconnectedError:
                clock.advance(0.05)
        waits.append(round((clock.now_ns - lost_ns) / 1e9, 2))
    assert waits == [0.25, 0.5, 1.0, 0.25]
    assert all(port.closed == 1 for port in (*hung, spoke))
    assert channel.counters.lost == 4


@pytest.mark.parametrize(
    "failure",
    [OSError(errno.EIO, "Input/output error"), termios.error(5, "I/O error"), serial.PortNotOpenError()],
)
def test_whatever_pyserial_raises_is_a_lost_line(failure):
    clock = ManualClock()
    port = FakePort(clock)
    port.waiting_fails = failure
    channel = SerialChannel("/dev/fake", clock=clock, opener=Ports(clock, port))
    with pytest.raises(DeviceDisconnectedError, match="/dev/fake: connection lost"):
        channel.receive(1)


@pytest.mark.parametrize(
    ("failure", "kind", "words"),
    [
        (serial.SerialException(errno.EACCES, "x"), DevicePermissionError, "usermod -aG dialout"),
        (serial.SerialException(errno.ENODEV, "x"), DeviceNotFoundError, "bowlsight devices"),
        (serial.SerialException(errno.EBUSY, "x"), DeviceBusyError, "in use by another program"),
        (termios.error(22, "Invalid argument"), DeviceNotFoundError, "Invalid argument"),
        (ValueError("Not a valid\nbaudrate"), DeviceNotFoundError, "Not a valid baudrate"),
    ],
)
def test_why_a_port_does_not_open_is_said_with_a_remedy(failure, kind, words):
    channel, _, _ = channel_of(failure)
    with pytest.raises(kind, match=words):
        channel.connect()


def test_a_host_that_has_no_address_is_no_riddle():
    def opener(name, line):
        failure = serial.SerialException("Could not open port: [Errno -2] Name or service not known")
        failure.__context__ = socket.gaierror(-2, "Name or service not known")
        raise failure

    with pytest.raises(DeviceNotFoundError, match="no host of that name"):
        SerialChannel("socket://nowhere:1", clock=ManualClock(), opener=opener).connect()


def test_a_dropped_line_is_opened_again_when_it_is_due():
    clock = ManualClock()
    ports = [FakePort(clock), FakePort(clock, [b"x"])]
    channel = SerialChannel("/dev/fake", clock=clock, opener=Ports(clock, *ports))
    channel.drop("never opened")
    assert channel.connect() == 1
    channel.drop("silent")
    assert ports[0].closed == 1
    with pytest.raises(DeviceDisconnectedError, match="silent"):
        channel.connect()
    clock.advance(0.25)
    assert channel.receive(1) == b"x"
    assert channel.connect() == 2
