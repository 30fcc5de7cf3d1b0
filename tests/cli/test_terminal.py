import os

import pytest

from service.cli import terminal
from service.cli.terminal import StatusLine, say


@pytest.fixture
def tty(monkeypatch):
    def be(columns):
        monkeypatch.setattr("sys.stdout.isatty", lambda: True)
        monkeypatch.setattr(terminal.shutil, "get_terminal_size", lambda: os.terminal_size((columns, 24)))

    return be


def test_a_status_line_rewrites_itself_as_the_width_allows(tty, capsys):
    parts, brief = ["LIVE 25.0 fps", "lock full", "tilt 5.00 deg"], ["LIVE", "full", "5.00 deg"]
    for columns, text in ((42, " · ".join(parts)), (41, " · ".join(brief)), (22, "LIVE · full"), (4, "LIV")):
        tty(columns)
        status = StatusLine()
        status.show(parts, brief)
        status.clear()
        assert capsys.readouterr().out == f"\r\x1b[K{text}\r\x1b[K"


def test_elsewhere_there_is_a_whole_line_every_five_seconds(capsys):
    now = [0.0]
    status = StatusLine(lambda: now[0])
    for now[0] in (0.0, 1.0, 4.9, 5.0, 9.9, 10.0):
        status.show([f"at {now[0]}", "and more"], ["brief"])
    status.clear()
    assert capsys.readouterr().out == "at 0.0 · and more\nat 5.0 · and more\nat 10.0 · and more\n"


def test_a_message_is_one_line_whatever_it_holds(capsys):
    say("a\n  b\tc")
    assert capsys.readouterr().err == "bowlsight: a b c\n"
