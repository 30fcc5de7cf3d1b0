import os
import socket

import pytest

from service.acquisition.notify import ServiceManager
from tests.fakes.clock import ManualClock


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A service manager's socket, and the environment that names it."""
    path = str(tmp_path / "notify")
    named, address = (path, path) if request.param == "path" else (f"@{path}", f"\0{path}")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(address)
        listening.settimeout(5.0)
        yield listening, {"NOTIFY_SOCKET": named, "WATCHDOG_USEC": "20000000", "WATCHDOG_PID": "7"}


def test_systemd_is_told_what_the_service_does(manager):
    listening, environ = manager
    told = ServiceManager(ManualClock(), environ, 7)
    assert told.ready("LIVE at\n25 fps")
    assert listening.recv(200) == b"READY=1\nSTATUS=LIVE at 25 fps"
    assert told.status("RECONNECTING")
    assert listening.recv(200) == b"STATUS=RECONNECTING"
    assert told.stopping()
    assert listening.recv(200) == b"STOPPING=1"


def test_the_watchdog_hears_of_us_at_half_its_time_however_often_we_could_say_it(manager):
    listening, environ = manager
    clock = ManualClock()
    told = ServiceManager(clock, environ, 7)
    assert told.watchdog_s == 20
    said = 0
    for _ in range(100):
        said += told.alive()
        clock.advance(1.0)
    assert said == 10
    assert {listening.recv(200) for _ in range(said)} == {b"WATCHDOG=1"}


@pytest.mark.parametrize(
    "watchdog", [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "5", "WATCHDOG_PID": "8"}]
)
def test_without_a_watchdog_meant_for_us_nothing_is_said(watchdog):
    told = ServiceManager(ManualClock(), watchdog, 7)
    assert told.watchdog_s is None
    assert not told.alive()


def test_a_watchdog_without_a_process_is_meant_for_every_one():
    assert ServiceManager(ManualClock(), {"WATCHDOG_USEC": "5000000"}).watchdog_s == 5


@pytest.mark.parametrize("named", ["", "relative", "vsock:2:1234"])
def test_started_by_nobody_it_tells_nobody(named):
    assert not ServiceManager(ManualClock(), {"NOTIFY_SOCKET": named}).ready("LIVE")


def test_a_manager_that_does_not_listen_stops_nothing(tmp_path, caplog):
    told = ServiceManager(ManualClock(), {"NOTIFY_SOCKET": str(tmp_path / "absent")})
    assert not told.ready("LIVE")
    assert "systemd cannot be told READY: No such file" in caplog.text


def test_a_manager_whose_queue_is_full_holds_nothing_up(manager):
    _, environ = manager
    told = ServiceManager(ManualClock(), environ, 7)
    assert not all(told.status("LIVE") for _ in range(10_000))


def test_it_is_this_process_that_is_asked_about_by_default(monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "1000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert ServiceManager(ManualClock()).watchdog_s == 1
