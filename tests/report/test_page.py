"""The report of sessions that are small, empty, interrupted, damaged: what it says is what the reader says."""

import re
import shutil
from html.parser import HTMLParser

import pytest

from service.report.evidence import with_pictures
from service.report.page import make_report
from service.sinks.evidence import EvidenceRecord
from service.sinks.session.reader import open_session
from tests.sinks.session.recorded import Recording, frame, record, record_with_evidence, wait_for

NOW_NS = 1_800_000_000_000_000_000


class Outline(HTMLParser):
    """Texts, attributes, and whether every element is closed."""

    def __init__(self, html):
        super().__init__()
        self.open, self.names, self.attributes, self.texts = [], [], [], []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.names.append(tag)
        self.attributes += attrs
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.names.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def said(self):
        return " ".join(" ".join(self.texts).split())


def report(folder):
    """The page, and what it says."""
    page = make_report(open_session(folder), NOW_NS)
    outline = Outline(page)
    assert outline.open == []
    return page, outline.said


def value(said, name):
    found = re.search(rf"{name} ([0-9,]+)", said)
    return int(found[1].replace(",", ""))


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return record_with_evidence(tmp_path_factory.mktemp("sessions"))


def test_figures_are_those_of_the_reader(tmp_path):
    folder = record(tmp_path, [frame(k) for k in range(20)], measured=lambda k: k % 4 != 3)
    counts = open_session(folder).counts()
    _, said = report(folder)
    assert value(said, "frames recorded") == counts.frames == 20
    assert value(said, "frames measured") == counts.measured == 15
    assert value(said, "locked in full") == sum(r["lock"] == "full" for r in open_session(folder).results()) == 15


def test_evidence_is_shown_with_its_pictures(session):
    page, said = report(session)
    records = list(open_session(session).evidence())
    assert len(records) == 5
    assert page.problems == 0
    assert f"✔ holds: {len(records)} records" in said
    assert page.count('href="data:image/jpeg;base64,') == len(records)
    for record_ in records:
        assert record_.sha256 in said
        assert record_.values["picture_sha256"] in said
    assert "the guide is bent" in said
    assert "before: acquisition begins" in said


def test_nothing_is_fetched_and_nothing_is_run(session):
    page, _ = report(session)
    outline = Outline(page)
    assert not {"script", "link", "iframe", "object", "embed", "form", "base"} & set(outline.names)
    for name, said in outline.attributes:
        assert not name.startswith("on"), name
        if name in ("href", "src", "xlink:href", "srcset", "action"):
            assert said.startswith(("#", "data:image/")), said
        elif not name.startswith("xmlns"):
            assert "http:" not in (said or ""), (name, said)
            assert "https:" not in (said or ""), (name, said)
    assert "default-src 'none'" in page
    assert not re.search(r"@import|url\((?!['\"]?#)", page)


def test_texts_cannot_break_out(tmp_path):
    nasty = "</td></svg><script>alert(1)</script><img src=x onerror=alert(2)> $a_b^{c$ & \"'"
    with Recording(tmp_path) as recording:
        recording.feed(frame(0, source=nasty))
        wait_for(lambda: recording.recorder.state.measured == 1)
        recording.recorder.verify(nasty, nasty, reason=nasty)
        recording.recorder.mark(nasty, nasty)
        recording.recorder.event(f"alarm: {nasty}", "WARN", kind="alarm", key=nasty, change="raised", unit=nasty)
        recording.recorder.event(nasty, "WARN", kind=nasty)
    (folder,) = tmp_path.iterdir()
    page, said = report(folder)
    assert "<script" not in page
    assert "<img" not in page
    assert "alert(1)" in said


def test_a_session_without_frames_says_so(tmp_path):
    folder = record(tmp_path, [])
    page, said = report(folder)
    assert page.problems == 0
    assert value(said, "frames recorded") == 0
    assert "There is no frame in this session." in said
    assert "there is no evidence record" in said


def test_one_frame_is_enough(tmp_path):
    _, said = report(record(tmp_path, [frame(0)]))
    assert value(said, "frames recorded") == 1


def test_an_interrupted_session_is_reported_as_far_as_it_goes(session, tmp_path):
    folder = shutil.copytree(session, tmp_path / "s")
    index = (folder / "index.jsonl").read_bytes()
    (folder / "index.jsonl").write_bytes(index[: len(index) * 2 // 3])
    counts = open_session(folder).counts()
    assert 0 < counts.frames < 30
    _, said = report(folder)
    assert "INTERRUPTED" in said
    assert value(said, "frames recorded") == counts.frames


@pytest.mark.parametrize("name", ["results.jsonl", "events.jsonl", "evidence/records.jsonl", "evidence/000001.png"])
def test_a_changed_byte_is_told(session, tmp_path, name):
    folder = shutil.copytree(session, tmp_path / "s")
    data = bytearray((folder / name).read_bytes())
    data[len(data) // 2] ^= 1
    (folder / name).write_bytes(data)
    page, said = report(folder)
    assert page.problems > 0
    assert f"{name}: " in said
    assert ("DOES NOT HOLD" in said) == name.startswith("evidence")


def test_a_changed_picture_is_not_shown(session, tmp_path):
    folder = shutil.copytree(session, tmp_path / "s")
    shutil.copy(folder / "evidence/000000.png", folder / "evidence/000001.png")
    page, said = report(folder)
    assert page.count('href="data:image/jpeg;base64,') == 4
    assert "the picture was changed since" in said


@pytest.mark.parametrize("name", ["results.jsonl", "events.jsonl", "evidence/records.jsonl", "config/station.toml"])
def test_a_missing_file_is_told(session, tmp_path, name):
    folder = shutil.copytree(session, tmp_path / "s")
    (folder / name).unlink()
    page, said = report(folder)
    assert page.problems > 0
    assert f"{name}: cannot be read" in said


def test_what_was_lost_is_told_with_its_time(tmp_path):
    frames = [frame(0), frame(1), frame(5, defect="truncated"), frame(6)]
    _, said = report(record(tmp_path, frames))
    assert value(said, "frames that the source counted and that never came") == 3
    assert value(said, "bad frames: truncated") == 1
    assert value(said, "frames lost") == 3


def test_of_many_verifications_those_that_contradict_are_shown():
    def made(number, kind="verify", agrees=None, reason=None):
        return EvidenceRecord(number, {"kind": kind, "agrees": agrees, "reason": reason}, "")

    records = [made(k, "periodic") for k in range(200)]
    records += [made(200 + k, agrees=True) for k in range(50)]
    records += [made(250, agrees=False), made(251, agrees=True, reason="bent"), made(252, "periodic", agrees=False)]
    chosen = [record.number for record in with_pictures(records)]
    assert len(chosen) == 60
    assert chosen == sorted(chosen)
    assert {*range(200, 253)} <= {*chosen}
