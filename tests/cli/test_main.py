import errno
import logging
import os
import signal
import sys
import threading
import types
from unittest.mock import Mock

import pytest

from drivers.errors import CalibrationError, ConfigError, DeviceDisconnectedError
from service.cli import main
from service.cli.live import prepare_kernels


@pytest.fixture
def command(monkeypatch):
    """Make `bowlsight demo` do something else."""

    def replace(run):
        module = types.ModuleType("service.cli.demo")
        module.run = run
        monkeypatch.setitem(sys.modules, "service.cli.demo", module)

    return replace


def raising(error):
    def run(args):
        raise error

    return run


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (ConfigError("a.toml: key = 3: must be\nless"), 2, "bowlsight: a.toml: key = 3: must be less\n"),
        (DeviceDisconnectedError("cam", "is gone"), 2, "bowlsight: cam: is gone\n"),
        (CalibrationError("9 points in a line"), 1, "bowlsight: 9 points in a line\n"),
        (OSError(28, "No space left on device", "out.csv"), 1, "bowlsight: out.csv: No space left on device;"),
        (
            RuntimeError("cannot cache function 'f': no locator available for file 'x.py'"),
            2,
            "bowlsight: compiled kernels: ",
        ),
        (ZeroDivisionError("by zero"), 1, "bowlsight: a mistake in Bowlsight: ZeroDivisionError: by zero;"),
    ],
)
def test_an_error_is_one_line_and_a_status(command, capsys, error, status, words):
    command(raising(error))
    assert main(["demo"]) == status
    err = capsys.readouterr().err
    assert err.startswith(words)
    assert err.count("\n") == 1


def test_a_disk_without_room_for_compiled_kernels_is_told(monkeypatch):
    monkeypatch.setattr("service.cli.live.warm_up", Mock(side_effect=OSError(errno.ENOSPC, "No space left on device")))
    with pytest.raises(
        ConfigError, match=r"compiled kernels: cannot be kept: No space left on device; .*NUMBA_CACHE_DIR"
    ):
        prepare_kernels()


def test_verbose_shows_where_a_mistake_was_made(command, capsys):
    command(raising(ZeroDivisionError("by zero")))
    assert main(["demo", "-v"]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_ends_a_command_in_order_and_once(command, capsys, number, status):
    done = []

    def run(args):
        try:
            os.kill(os.getpid(), number)
            threading.Event().wait(10)
        finally:
            os.kill(os.getpid(), number)  # a second one, while cleaning up
            done.append(True)

    command(run)
    before = signal.default_int_handler
    outside = signal.signal(number, before)  # not ignored, as it would be under nohup
    try:
        assert main(["demo"]) == status
        assert signal.getsignal(number) is before
    finally:
        signal.signal(number, outside)
    assert done == [True]
    assert capsys.readouterr().err == "bowlsight: interrupted\n"


def test_a_hangup_that_is_ignored_stays_so(command):
    seen = []
    command(lambda _: seen.append(signal.getsignal(signal.SIGHUP)) or 0)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert main(["demo"]) == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert seen == [signal.SIG_IGN]


def test_it_can_be_called_from_another_thread(command):
    command(lambda _: 0)
    statuses = []
    thread = threading.Thread(target=lambda: statuses.append(main(["demo"])))
    thread.start()
    thread.join(10)
    assert statuses == [0]


@pytest.mark.parametrize("verbose", [False, True])
def test_warnings_are_one_line_and_all_that_is_said_with_verbose(command, capsys, verbose):
    def run(args):
        log = logging.getLogger("service.somewhere")
        log.debug("detail")
        try:
            int("gone")
        except ValueError:
            log.exception("closing\nfailed")
        return 0

    command(run)
    assert main(["demo"] + ["-v"] * verbose) == 0
    err = capsys.readouterr().err
    assert ("detail" in err) is verbose
    assert ("Traceback" in err) is verbose
    assert verbose or err == "bowlsight: closing failed: invalid literal for int() with base 10: 'gone'\n"
    assert logging.getLogger("service").handlers == []
