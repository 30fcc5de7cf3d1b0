"""`bowlsight report`: writes one file, changes nothing else, and says in one line why it cannot."""

import contextlib
import os
import pty
import re
import sys
import termios
from pathlib import Path

import pytest

from service.cli import main
from service.report.page import make_report
from service.sinks.session.reader import open_session
from tests.sinks.session.recorded import record_with_evidence


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return record_with_evidence(tmp_path_factory.mktemp("sessions"))


def files(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_it_lands_in_this_folder_under_the_sessions_name(session, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before = files(session)
    assert main(["report", str(session)]) == 0
    page = tmp_path / f"{session.name}.html"
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert capsys.readouterr().out == f"{page.name}: report of {session.name}, {page.stat().st_size / 1e6:.1f} MB\n"
    assert files(session) == before


def test_what_is_wrong_with_the_session_is_the_exit_status(session, tmp_path, capsys):
    record = session / "evidence/000000.png"
    data = record.read_bytes()
    try:
        record.write_bytes(data[:-9])
        assert main(["report", str(session), "--out", str(tmp_path / "r.html")]) == 1
    finally:
        record.write_bytes(data)
    assert "1 problem, named in it" in capsys.readouterr().out
    assert (tmp_path / "r.html").is_file()


@pytest.mark.parametrize(
    ("out", "words"),
    [
        ("{tmp}", "cannot be written"),
        ("{tmp}/no/r.html", "cannot be written"),
        ("{session}/index.jsonl", "is in the session's own folder"),
        ("{session}/report.html", "is in the session's own folder"),
        ("", "must be the name of a file"),
    ],
)
def test_an_output_that_cannot_be_is_refused_in_one_line(session, tmp_path, capsys, out, words):
    before = files(session)
    assert main(["report", str(session), "--out", out.format(tmp=tmp_path, session=session)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert words in error
    assert files(session) == before


@pytest.mark.parametrize("name", ["gone", "bowl.mkv", "empty"])
def test_what_is_no_session_is_refused_in_one_line(tmp_path, capsys, name):
    (tmp_path / "bowl.mkv").touch()
    (tmp_path / "empty").mkdir()
    assert main(["report", str(tmp_path / name)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "is no recorded session" in error


@pytest.mark.parametrize("damage", ["schema = ", None])
def test_without_its_description_a_session_is_reported_as_far_as_it_goes(tmp_path, capsys, damage):
    folder = record_with_evidence(tmp_path, count=1)
    if damage is None:
        (folder / "session.toml").unlink()
    else:
        (folder / "session.toml").write_text(damage)
    assert main(["report", str(folder), "--out", str(tmp_path / "r.html")]) == 1
    assert "named in it" in capsys.readouterr().out
    page = (tmp_path / "r.html").read_text()
    assert "description cannot be read: " in page
    assert "UNKNOWN" in page
    assert re.search("session.toml: (was changed|cannot be read)", page)
    assert "holds: 3 records" in page  # they are chained to a hash that the index has too
    assert "claimed" in page
    assert "open_browser = false" in page  # the configuration, as it lies there
    assert "frames measured" in page


def test_each_part_of_the_work_tells_how_far_it_is(session):
    told = {}

    def progress(what, done, total):
        told.setdefault(what, []).append((done, total))

    make_report(open_session(session), 0, progress)
    assert list(told) == ["checking", "results", "pictures"]
    for steps in told.values():
        assert [done for done, _ in steps] == sorted(done for done, _ in steps)
        assert steps[-1][0] == steps[-1][1]
        assert len({total for _, total in steps}) == 1
    assert len(told["checking"]) == 30


def test_in_a_terminal_all_of_it_is_shown(session, tmp_path):
    command = [sys.executable, "-c", "import sys; from service.cli import main; sys.exit(main())", "report"]
    child, master = pty.fork()
    if child == 0:
        os.chdir(Path(__file__).parents[2])
        termios.tcsetwinsize(0, (24, 100))
        os.execv(command[0], [*command, str(session), "--out", str(tmp_path / "r.html")])
    said = b""
    with contextlib.suppress(OSError):  # it ended
        while more := os.read(master, 1000):
            said += more
    assert os.waitpid(child, 0)[1] == 0
    os.close(master)
    assert b"checking: " in said
    assert b"report of" in said
