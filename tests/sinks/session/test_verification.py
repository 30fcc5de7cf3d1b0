"""A session that was changed after it was written does not pass, and what was changed is named."""

import json
import shutil

import numpy as np
import pytest

from drivers.session_index import INDEX, VIDEO
from service.sinks.evidence import HEADS, RECORDS
from service.sinks.session.places import ABOUT, EVENTS, EVIDENCE, RESULTS
from service.sinks.session.reader import open_session
from service.sinks.session.verification import verify_session
from tests.sinks.session.recorded import frame, record_with_evidence, results
from tests.sinks.session.tamper import files_of, tampered


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return record_with_evidence(tmp_path_factory.mktemp("sound"))


@pytest.fixture
def session(sound, tmp_path):
    return shutil.copytree(sound, tmp_path / "session")


def found(session):
    return [str(f) for f in verify_session(session) if f.grave]


def test_a_sound_session_passes(sound):
    assert list(verify_session(sound)) == []


@pytest.mark.parametrize("videos", [False, True])
def test_it_tells_how_far_it_is(sound, videos):
    told = []
    assert list(verify_session(sound, videos=videos, progress=lambda *now: told.append(now))) == []
    done, totals = [d for d, _ in told], {total for _, total in told}
    size = (sound / RESULTS).stat().st_size + videos * sum(p.stat().st_size for p in (sound / VIDEO).iterdir())
    assert (done, totals) == (sorted(done), {size})
    assert done[-1] == size


def test_a_record_holds_what_was_claimed_seen_and_shown(sound):
    records = list(open_session(sound).evidence())
    assert [r.values["kind"] for r in records] == ["verify", "verify", "before", "after", "verify"]
    assert [r.values["mark"] for r in records][2:4] == ["acquisition begins"] * 2
    first, last = records[0].values, records[-1].values
    assert (first["operator"], first["tube_claimed"], first["reason"]) == ("B. Tester", "L83R87", None)
    assert last["reason"] == "the guide is bent"
    assert first["frame"]["sequence"] == 5
    assert first["result"]["tubes"] == json.loads(results(frame(5))[0].to_json())["tubes"]
    assert first["utc"].endswith("Z")
    assert "system clock" in first["utc_source"]
    assert first["what"] == "SIMULATED"
    assert len(first["configuration_sha256"]) == 64
    assert records[3].values["frame"]["sequence"] > records[2].values["frame"]["sequence"]


def test_every_single_byte_that_is_changed_is_found_and_its_file_named(session):
    """The thousand changes of the full run take a minute: python -m tests.sinks.session.tamper."""
    for file, at, by, findings in tampered(session, 8 * len(files_of(session)), np.random.default_rng(1)):
        assert str(file) in {f.file for f in findings}, (file, at, by, findings)


@pytest.mark.parametrize("name", [f"{EVIDENCE}/{RECORDS}", f"{EVIDENCE}/{HEADS}", INDEX, EVENTS])
def test_lines_taken_off_the_end_are_missed(session, name):
    lines = (session / name).read_bytes().splitlines(keepends=True)
    (session / name).write_bytes(b"".join(lines[:-1]))
    if name == INDEX:  # as after a power failure: that is said, and the events' end is not vouched for
        assert any("interrupted" in f.problem for f in verify_session(session))
    else:
        assert any(text.startswith((name, f"{EVIDENCE}/{RECORDS}")) for text in found(session))


@pytest.mark.parametrize("name", [f"{EVIDENCE}/{RECORDS}", INDEX, EVENTS, RESULTS])
def test_lines_that_change_places_or_are_taken_out_are_found(session, name):
    lines = (session / name).read_bytes().splitlines(keepends=True)
    (session / name).write_bytes(b"".join([lines[1], lines[0], *lines[2:]]))
    assert found(session)
    (session / name).write_bytes(b"".join([lines[0], *lines[2:]]))
    assert found(session)


def test_evidence_made_anew_from_a_changed_record_is_found_by_the_index(session):
    folder = session / EVIDENCE
    shutil.rmtree(folder)
    assert found(session) == ["evidence: is gone, with 5 records"]


def test_a_picture_that_is_not_of_that_frame_is_found(session):
    pictures = sorted((session / EVIDENCE).glob("*.png"))
    pictures[0].write_bytes(pictures[1].read_bytes())
    assert found(session) == ["evidence/000000.png: was changed: its hash is not the one in record 0"]


@pytest.mark.parametrize("name", ["video/000000.mkv", f"{EVIDENCE}/000001.png", RESULTS, EVENTS, "results.csv", ABOUT])
def test_a_file_that_is_gone_is_named(session, name):
    (session / name).unlink()
    assert any(text.startswith(f"{name}: cannot be read") for text in found(session))


def test_the_picture_that_was_damaged_is_named(session):
    path = session / "video" / "000000.mkv"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    texts = found(session)
    assert texts[0] == "video/000000.mkv: was changed: its hash is not the one in the index"
    assert any("frame 1" in text for text in texts[1:])


def test_strange_files_are_told_and_are_no_fault(session):
    (session / "notes.txt").write_text("hello")
    (session / "video" / "x").write_text("hello")
    assert [(f.file, f.grave) for f in verify_session(session)] == [("video/x", False), ("notes.txt", False)]


def test_a_folder_full_of_rubbish_is_found_to_be_so(session):
    for path in files_of(session):
        path.write_bytes(b"\x00\xff rubbish")
    texts = found(session)
    assert any(INDEX in text for text in texts)
    assert any(ABOUT in text for text in texts)
