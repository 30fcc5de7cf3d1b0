"""What is too old or too much goes, the oldest first; what is being recorded stays."""

import os
from pathlib import Path

import pytest

from service.sinks.session.places import SessionLock
from service.sinks.session.retention import DELETING, Kept, delete_old, superfluous
from tests.sinks.session.recorded import Recording, frame, wait_for

DAY_S, GIB = 86400.0, 2**30
NOW_S = 100 * DAY_S


def kept(name, days_old, gib=1.0, *, running=False):
    return Kept(Path(name), NOW_S - days_old * DAY_S, int(gib * GIB), running)


def going(sessions, **limits):
    limits = {"max_age_days": None, "max_size_gib": None} | limits
    return [s.folder.name for s in superfluous(sessions, NOW_S, **limits)]


@pytest.mark.parametrize(
    ("limits", "gone"),
    [
        ({}, []),
        ({"max_age_days": 10}, ["c", "a"]),
        ({"max_size_gib": 6}, []),
        ({"max_size_gib": 5.5}, ["c"]),
        ({"max_size_gib": 1.5}, ["c", "a", "b"]),
        ({"max_age_days": 10, "max_size_gib": 2.5}, ["c", "a", "b"]),
        ({"max_size_gib": 0.1}, ["c", "a", "b"]),
    ],
)
def test_the_oldest_go_first_and_what_is_recorded_stays(limits, gone):
    sessions = [kept("a", 20, 2), kept("b", 5), kept("c", 30), kept("d", 40, 2, running=True)]
    assert going(sessions, **limits) == gone


def made(root, name, age_s):
    folder = root / name
    folder.mkdir(parents=True)
    for file in ("index.jsonl", "session.toml"):
        (folder / file).write_bytes(b"x" * 500)
        os.utime(folder / file, (NOW_S - age_s, NOW_S - age_s))
    os.utime(folder, (NOW_S - age_s, NOW_S - age_s))
    return folder


def test_old_sessions_are_deleted_and_that_is_said(tmp_path):
    old, new, held = (made(tmp_path, n, a * DAY_S) for n, a in (("old", 9), ("new", 1), ("held", 9)))
    (tmp_path / "no session").mkdir()
    (tmp_path / f"{DELETING}unfinished").mkdir()
    lock = SessionLock(held)
    os.utime(held, (NOW_S - 9 * DAY_S,) * 2)
    assert delete_old(tmp_path, NOW_S, 5, None) == ["deleted session old: 0.00 GiB, 9.0 days old"]
    lock.release()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["held", "new", "no session"]
    assert not old.exists()
    assert new.is_dir()


def test_nothing_is_deleted_unless_the_station_asks_for_it(tmp_path):
    made(tmp_path, "old", 1000 * DAY_S)
    assert delete_old(tmp_path, NOW_S, None, None) == []
    assert (tmp_path / "old").is_dir()


def test_the_recorder_deletes_what_is_too_much_and_notes_it(tmp_path):
    made(tmp_path, "2001", 0)
    os.utime(tmp_path / "2001" / "index.jsonl", (1e9, 1e9))
    with Recording(tmp_path, max_age_days=1000.0) as recording:
        recording.feed(frame(0))
        wait_for(lambda: not (tmp_path / "2001").exists())
        wait_for(lambda: recording.recorder.state.measured == 1)
        folder = recording.recorder.state.folder
        wait_for(lambda: "deleted session 2001" in (folder / "events.jsonl").read_text())  # told once it is gone
