"""The list of sessions is made from their folders, whatever became of it or of them."""

import shutil

import pytest

from drivers.errors import ConfigError
from drivers.session_index import INDEX
from service.sinks.session.library import LIBRARY, Query, find_sessions
from service.sinks.session.places import EVENTS
from tests.sinks.session.recorded import Recording, frame, record_with_evidence


@pytest.fixture
def root(tmp_path):
    folder = tmp_path / "sessions"
    folder.mkdir()
    first = record_with_evidence(folder)
    first.rename(folder / "2026-01-05T100000Z-system80")
    with Recording(folder) as recording:
        recording.feed(frame(0))
        recording.recorder.event("tubes named", kind="tubes", names=["L83R87", "L84R88"])
    return folder


def names(root, **query):
    return [entry.name for entry in find_sessions(root, Query(**query))]


def test_it_tells_what_each_session_is(root):
    first, second = find_sessions(root)
    assert (first.frames, first.measured, first.evidence, first.end) == (30, 30, 5, "closed")
    assert (second.frames, second.operator, second.what, second.generator) == (1, "A. Tester", "SIMULATED", "system80")
    assert first.size_bytes > 10_000
    assert first.seconds == pytest.approx(0, abs=60)


def test_words_tubes_and_days_are_looked_for(root):
    first, second = names(root)
    assert names(root, words=["ACQUISITION"]) == [first]
    assert names(root, words=["acquisition", "nobody"]) == []
    assert names(root, words=["a. tester", "system80"]) == [first, second]
    assert names(root, tube="l83r87") == [second]
    assert names(root, tube="R99") == []
    started = find_sessions(root)[1].started_utc[:10]
    assert names(root, since=started, until=started) == [first, second]
    assert names(root, until="1999-12-31") == names(root, since="2999-01-01") == []


def test_what_is_gone_or_new_or_changed_is_noticed(root):
    first, second = names(root)
    shutil.copytree(root / second, root / "another")
    assert names(root) == [first, second, "another"]
    shutil.rmtree(root / first)
    (root / second / EVENTS).write_text("")
    assert names(root) == [second, "another"]
    assert names(root, tube="L83R87") == ["another"]


@pytest.mark.parametrize("content", [b"", b"rubbish" * 1000, None])
def test_a_damaged_index_is_made_anew(root, content):
    before = find_sessions(root)
    if content is None:
        content = bytearray((root / LIBRARY).read_bytes())
        content[len(content) // 3 : len(content) // 2] = bytes(len(content) // 2 - len(content) // 3)
    (root / LIBRARY).write_bytes(content)
    assert find_sessions(root) == before
    assert find_sessions(root, rebuild=True) == before


def test_an_index_that_cannot_be_written_is_done_without(root):
    (root / LIBRARY).mkdir()
    assert len(find_sessions(root)) == 2


def test_a_session_that_cannot_be_opened_is_listed_as_damaged(root):
    first, second = names(root)
    (root / first / INDEX).write_bytes(b"")
    (root / second / "session.toml").write_text("what = 3")
    assert [entry.end for entry in find_sessions(root)] == ["damaged", "damaged"]
    assert names(root, words=["damaged"]) == [first, second]


def test_a_session_that_is_being_recorded_is_told_as_such(root):
    with Recording(root) as recording:
        recording.feed(frame(0))
        assert find_sessions(root)[-1].end == "recording"
    assert find_sessions(root)[-1].end == "closed"


def test_no_folder_is_an_error_in_a_line(tmp_path):
    with pytest.raises(ConfigError, match="name the folder of sessions by --in"):
        find_sessions(tmp_path / "none")
