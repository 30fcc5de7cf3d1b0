import contextlib
import itertools
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

import pytest

from drivers.errors import ConfigError
from service.sinks import viewer
from service.sinks.ports import free_port
from service.sinks.viewer import ViewerSink
from service.sinks.viewer_drawing import Watch
from tests.fakes.drawn import LATTICE, made_up, noise
from tests.fakes.rrd import PATIENCE_S, Client, Rrd, wait_until

HERE = "127.0.0.1"
ROOT = Path(__file__).parents[2]


def some_port(base):
    return free_port(HERE, None, base, "port")


@pytest.fixture
def ranked():
    """A sink as it is: rerun's threads run when no others want to."""
    sink = ViewerSink(Watch(LATTICE), port=some_port(29876), web_port=some_port(29090))
    sink.start()
    yield sink
    sink.close(PATIENCE_S)


@pytest.fixture
def sink(monkeypatch, request):
    """One whose rerun has all the time it needs: on a busy machine it would get none, and let frames go."""
    monkeypatch.setattr(viewer, "go_between", lambda: None)
    monkeypatch.setattr(viewer, "PACK_TIMEOUT_S", PATIENCE_S)
    return request.getfixturevalue("ranked")


@pytest.fixture
def clients(tmp_path):
    started = []

    def start(sink):
        n = len(started)
        started.append(Client(sink.grpc_url, tmp_path / f"client{n}.rrd", some_port(29955 + n)))
        return started[-1]

    yield start
    for client in started:
        client.end()


def feed(sink, numbers, size=(160, 120)):
    """Hand frames over, each once the last was dealt with."""
    pixels = noise(size)
    for i in numbers:
        frame, result = made_up(i, size=size, pixels=pixels)
        sink.accept(frame, (result,))
        wait_until(lambda: sink.stats().depth == 0)


def listeners():
    """Addresses that this process and its children listen on, out of the kernel's tables."""
    inodes = set()
    for fd in Path("/proc/self/fd").iterdir():
        try:
            target = str(fd.readlink())
        except OSError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = set()
    for table in ("/proc/self/net/tcp", "/proc/self/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:] if Path(table).exists() else []:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                address, port = fields[1].split(":")
                found.add((address, int(port, 16)))
    return found


def wait_until_listening(expected):
    """Rerun's server ends when it gets to it: one of the last test may be there yet."""
    wait_until(lambda: listeners() == expected)


def port_of(url):
    return int(url.split(":")[-1].split("/")[0])


def test_it_listens_on_loopback_only_and_on_two_ports(sink):
    urllib.request.urlopen(f"{sink.url}?x", timeout=PATIENCE_S).close()
    wait_until_listening({("0100007F", port_of(sink.url)), ("0100007F", port_of(sink.grpc_url))})


def test_nothing_listens_once_it_is_closed(sink, monkeypatch):
    monkeypatch.setattr(viewer, "SILENT_TIMEOUT_S", PATIENCE_S)  # rerun ends when it gets to it
    feed(sink, range(3))
    sink.close(PATIENCE_S)
    assert listeners() == set()
    children = Path(f"/proc/self/task/{threading.get_native_id()}/children")
    assert not children.exists() or "rerun" not in children.read_text()


def test_a_viewer_gets_every_frame_with_its_results(sink, clients):
    feed(sink, range(5))  # before it comes: what is kept for late comers
    client = clients(sink)
    client.wait_for_bytes(50_000)
    feed(sink, range(5, 40))
    entities = "/picture", "/picture/tubes", "/status", "/trend/distance"
    wait_until(lambda: all(39 in Rrd(client.path).frames(entity) for entity in entities))
    rrd = Rrd(client.path)
    for entity in entities:
        assert rrd.frames(entity) == list(range(40)), entity
    assert rrd.column("/trend/distance", "Scalars:scalars")[39][0] == pytest.approx(403.9)
    pixels = bytes(rrd.column("/picture", "Image:buffer")[0][0])
    assert len(pixels) == 160 * 120
    assert pixels == noise((160, 120)).tobytes()
    assert sink.stats().dropped == 0


def test_it_ends_in_time_although_a_viewer_looks_on(sink, clients):
    client = clients(sink)
    feed(sink, range(3))
    client.wait_for_bytes(10_000)
    sink.close(1.0)
    assert not sink.running


def test_two_viewers_get_the_same(sink, clients):
    both = clients(sink), clients(sink)
    feed(sink, range(20))
    for client in both:
        wait_until(lambda path=client.path: 19 in Rrd(path).frames())
        assert Rrd(client.path).frames() == list(range(20))


def test_events_reach_the_viewer_without_a_frame(sink, clients):
    client = clients(sink)
    sink.event("source lost", "ERROR")
    wait_until(lambda: "/events" in Rrd(client.path).rows)
    assert Rrd(client.path).column("/events", "TextLog:level") == [["ERROR"]]


@pytest.mark.parametrize("end", [signal.SIGSTOP, signal.SIGKILL])
def test_a_stopped_or_killed_viewer_delays_nobody(sink, clients, end, tmp_path):
    client = clients(sink)
    feed(sink, range(10), size=(1280, 720))
    client.wait_for_bytes(100_000)
    client.process.send_signal(end)
    feed(sink, range(10, 60), size=(1280, 720))  # 46 MB, far more than the kernel takes
    other = clients(sink)
    feed(sink, range(60, 62))
    sink.close(2.0)
    stats = sink.stats()
    assert stats.accepted == 62
    assert stats.failed == 0
    client.end()
    other.end()
    sink._thread.join(PATIENCE_S)


def test_a_viewer_that_stops_reading_costs_frames_that_are_counted(sink, clients):
    client = clients(sink)
    feed(sink, range(5), size=(1280, 720))
    client.wait_for_bytes(100_000)
    client.process.send_signal(signal.SIGSTOP)
    deadline, i = time.monotonic() + PATIENCE_S, 5
    pixels = noise((1280, 720))
    while not sink.stats().dropped and time.monotonic() < deadline:
        frame, result = made_up(i, size=(1280, 720), pixels=pixels)
        sink.accept(frame, (result,))
        time.sleep(0.02)
        i += 1
    assert sink.stats().dropped > 0
    client.process.send_signal(signal.SIGCONT)
    numbers = itertools.count(i + 1)
    wait_until(lambda: (feed(sink, [next(numbers)]), max(Rrd(client.path).frames(), default=0) > i)[1])


def test_frames_that_rerun_has_no_time_to_pack_are_let_go_and_counted(sink, monkeypatch):
    feed(sink, [0])
    asked = iter([False, False, True])  # after frame 1, before frame 2, before frame 3

    def flush(timeout_sec):
        if not next(asked, True):
            raise RuntimeError("Flush timed out - not all messages were sent.")

    monkeypatch.setattr(sink._stream, "flush", flush)
    feed(sink, range(1, 4))
    assert (sink.stats().accepted, sink.stats().dropped, sink.stats().failed) == (4, 1, 0)


def policies():
    """By what rule the system lets this process's threads run, by their names."""
    found = {}
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended
            found.setdefault((task / "comm").read_text().strip(), set()).add(os.sched_getscheduler(int(task.name)))
    return found


def test_rerun_packs_and_sends_when_no_other_thread_wants_to_run(ranked):
    feed(ranked, range(3))
    assert os.SCHED_IDLE in policies()["tokio-rt-worker"]
    holders = threading.main_thread(), ranked._thread, ranked._page._thread  # of Python's lock: they must not wait
    for thread in holders:
        assert os.sched_getscheduler(thread.native_id) == os.SCHED_OTHER, thread.name


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a thread back what rank it had")
def test_at_the_end_no_thread_is_left_to_wait_for_all_others(ranked):
    feed(ranked, range(3))
    ranked.close(PATIENCE_S)
    assert os.SCHED_IDLE not in set().union(*policies().values())


def test_a_connection_that_never_speaks_or_reads_delays_nobody(sink):
    with (
        socket.create_connection((HERE, port_of(sink.grpc_url))) as silent,
        socket.create_connection((HERE, port_of(sink.grpc_url))) as babbling,
    ):
        babbling.sendall(b"GET / HTTP/1.1\r\n\r\n" * 100)
        feed(sink, range(30))
        assert sink.stats().dropped == sink.stats().failed == 0
        silent.setblocking(False)
        sink.close(PATIENCE_S)


def test_taken_ports_give_way_to_the_next_and_that_is_said(caplog, monkeypatch):
    with socket.socket() as grpc, socket.socket() as web:
        for s in (grpc, web):
            s.bind((HERE, 0))
            s.listen()
        monkeypatch.setattr("service.sinks.viewer.GRPC_PORT", grpc.getsockname()[1])
        monkeypatch.setattr("service.sinks.viewer.WEB_PORT", web.getsockname()[1])
        sink = ViewerSink(Watch(LATTICE))
        sink.start()
        try:
            assert port_of(sink.grpc_url) > grpc.getsockname()[1]
            assert port_of(sink.url) > web.getsockname()[1]
            assert "in use; listening on" in caplog.text
        finally:
            sink.close(PATIENCE_S)


@pytest.mark.parametrize("which", ["port", "web_port"])
def test_a_port_asked_for_and_taken_is_one_line_and_leaves_nothing_behind(which):
    with socket.socket() as s:
        s.bind((HERE, 0))
        s.listen()
        taken = s.getsockname()[1]
        ports = {"port": some_port(29876), "web_port": some_port(29090)} | {which: taken}
        sink = ViewerSink(Watch(LATTICE), **ports)
        with pytest.raises(ConfigError, match=f"{taken} at {HERE}: Address already in use"):
            sink.start()
        sink.close(PATIENCE_S)
        wait_until_listening({("0100007F", taken)})


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.0.7", "::1", "localhost", ""])
def test_an_address_beyond_loopback_is_refused(address):
    sink = ViewerSink(Watch(LATTICE), address=address)
    with pytest.raises(ConfigError, match=f"viewer address = '{address}'.*127.0.0.1.*ssh -L"):
        sink.start()
    sink.close(PATIENCE_S)
    wait_until_listening(set())


STOPPED_VIEWER = """
import signal, sys, time
from pathlib import Path
from service.sinks import viewer, viewer_pace
from service.sinks.viewer import ViewerSink
from service.sinks.viewer_drawing import Watch
from tests.fakes.drawn import LATTICE, made_up, noise
from tests.fakes.rrd import Client
viewer.go_between = lambda: None  # it is the viewer that stands still, not the machine that is busy
viewer_pace.BACKLOG_BYTES = 10**12  # as if nobody paid attention: rerun's own queues fill up
sink = ViewerSink(Watch(LATTICE), port=int(sys.argv[1]), web_port=int(sys.argv[2]))
sink.start()
client = Client(sink.grpc_url, Path(sys.argv[4]), int(sys.argv[3]))
print(client.process.pid, flush=True)
sent, size = 0, (1280, 720)
pixels = noise(size)
while sent < 420:
    frame, result = made_up(sent, size=size, pixels=pixels)
    sink.accept(frame, (result,))
    sent += 1
    time.sleep(0.01)
    if sent == 40:
        client.wait_for_bytes(100_000)
        client.process.send_signal(signal.SIGSTOP)
sink.close(1.0)
print("closed", flush=True)
"""


def test_the_program_ends_although_a_viewer_stands_still(tmp_path):
    ports = [str(some_port(base)) for base in (29876, 29090, 29955)]
    command = [sys.executable, "-c", STOPPED_VIEWER, *ports, tmp_path / "client.rrd"]
    service = subprocess.Popen(
        command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True
    )
    viewer = int(service.stdout.readline())
    try:
        assert service.stdout.readline() == "closed\n"
        assert service.wait(10.0) == 0  # with the viewer still stopped: rerun's own way out would take half a minute
    finally:
        os.kill(viewer, signal.SIGKILL)
        service.kill()
        service.stdout.close()
        service.wait(PATIENCE_S)
