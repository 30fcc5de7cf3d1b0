"""`bowlsight report`: writes one file, changes nothing else, and says in one line why it cannot."""

import pytest

from service.cli import main
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


def test_a_damaged_description_is_refused_in_one_line(tmp_path, capsys):
    folder = record_with_evidence(tmp_path, count=1)
    (folder / "session.toml").write_text("schema = ")
    assert main(["report", str(folder), "--out", str(tmp_path / "r.html")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "session.toml" in error
