"""What the recorder writes is what came, and whatever befalls it stays with it."""

import errno
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.errors import ConfigError, EndOfRecordingError
from drivers.session_index import INDEX, Closed, Overflow, Row, read_index
from drivers.session_replay import SessionGrabber
from service.sinks.session.control import RecordingError
from service.sinks.session.memory import Memory
from service.sinks.session.places import CSV, EVENTS, RESULTS
from service.sinks.session.reader import SessionEnd, open_session
from service.sinks.session.verification import verify_session
from service.sinks.session.video import HashedFile
from tests.sinks.session.recorded import Recording, frame, record, results, wait_for


def played(folder):
    grabber = SessionGrabber(folder, speed=math.inf)
    frames = []
    with grabber:
        grabber.start()
        try:
            while True:
                frames.append(grabber.read(1.0))
        except EndOfRecordingError:
            return frames


@pytest.mark.parametrize(
    ("size", "dtype"), [((64, 48), np.uint8), ((64, 48), np.uint16), ((720, 576), np.uint8), ((33, 17), np.uint8)]
)
def test_the_frames_that_were_measured_come_back_as_they_were(tmp_path, size, dtype):
    came = [frame(k, size=size, dtype=dtype) for k in range(12)]
    folder = record(tmp_path, came, measured=lambda k: k % 3 != 1)
    back = played(folder)
    assert [f.sequence for f in back] == [0, 2, 3, 5, 6, 8, 9, 11]
    for f in back:
        was = came[f.sequence]
        assert np.array_equal(f.pixels, was.pixels)
        assert (f.timestamp_ns, f.field, f.source, f.generation, f.pixel_format) == (
            was.timestamp_ns, was.field, was.source, was.generation, was.pixel_format
        )  # fmt: skip


def test_results_are_in_the_log_with_their_frames(tmp_path):
    came = [frame(k) for k in range(6)]
    session = open_session(record(tmp_path, came, measured=lambda k: k != 2, csv=True))
    answers = list(session.answers())
    assert [a.row.sequence for a in answers] == [0, 1, 3, 4, 5]
    assert all(a.problem is None for a in answers)
    assert answers[2].lines == [json.loads(r.to_json()) for r in results(came[3])]
    assert len((session.folder / RESULTS).read_text().splitlines()) == 5
    assert len((session.folder / CSV).read_text().splitlines()) == 6
    counts = session.counts()
    assert (counts.frames, counts.measured, counts.overflowed, counts.end) == (6, 5, 0, SessionEnd.CLOSED)
    assert session.about.operator == "A. Tester"
    assert session.station.is_file()


def test_frames_of_another_size_source_or_generation_go_on_in_the_same_session(tmp_path):
    came = [frame(0), frame(1), frame(0, generation=2), frame(1, size=(32, 24), generation=2), frame(0, generation=3)]
    folder = record(tmp_path, came)
    back = played(folder)
    assert [f.generation for f in back] == [1, 1, 2, 2, 3]
    assert [f.size_px for f in back] == [f.size_px for f in came]
    assert len(list((folder / "video").iterdir())) == 3


def test_bad_frames_are_recorded_with_what_is_wrong_with_them(tmp_path):
    back = played(record(tmp_path, [frame(0), frame(1, defect="flat picture"), frame(2)]))
    assert [f.defect for f in back] == [None, "flat picture", None]


def test_what_finds_no_room_is_counted_and_told(tmp_path):
    recording = Recording(tmp_path, capacity=3)
    taken = [recording.frames.offer(frame(k)) for k in range(5)]
    assert taken == [True] * 3 + [False] * 2
    recording.recorder.start()
    for k in range(5):
        recording.recorder.accept(frame(k), results(frame(k)))
    recording.frames.close()
    recording.recorder.close(20.0)
    assert recording.recorder.state.overflowed == 0  # they were lost before the session began
    (folder,) = tmp_path.iterdir()
    answers = list(open_session(folder).answers())
    assert [None if a.row is None else a.row.sequence for a in answers] == [0, 1, 2, None, None]
    assert len(played(folder)) == 3


def test_an_overflow_is_in_the_index(tmp_path):
    with Recording(tmp_path, capacity=1) as recording:
        recording.feed(frame(0))
        wait_for(lambda: recording.recorder.state.measured == 1)
        recording.frames.overflowed += 7
        recording.feed(frame(8))
    (folder,) = tmp_path.iterdir()
    assert [i.frames for i in read_index(folder / INDEX) if isinstance(i, Overflow)] == [7]
    assert recording.recorder.state.overflowed == 7


def full_after(room):
    """Write to a video file as to a disk with that much room."""
    write = HashedFile.write

    def limited(self, data):
        if self.size_bytes + len(data) > room:
            raise OSError(errno.ENOSPC, "No space left on device", "000000.mkv")
        return write(self, data)

    return limited


def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(HashedFile, "write", full_after(30_000))
    with Recording(tmp_path) as recording:
        recording.feed(*(frame(k) for k in range(20)))
        wait_for(lambda: recording.recorder.state.failure is not None)
        assert recording.recorder.state.folder is None
        assert "No space left on device; make room" in recording.recorder.state.failure
        recording.feed(*(frame(k) for k in range(20, 40)))  # goes on being served
        wait_for(lambda: recording.frames.depth == 0)
        monkeypatch.undo()
        folder = recording.recorder.start_recording()  # once there is room again
        recording.feed(frame(40))
        wait_for(lambda: recording.recorder.state.measured == 1)
        assert recording.recorder.state.failure is None
    assert "recording stopped" in caplog.text
    first, second = sorted(tmp_path.iterdir())
    assert second == folder
    assert [e["kind"] for e in open_session(first).events()][-1] == "failed"
    assert open_session(first).counts().end is SessionEnd.INTERRUPTED
    assert [f.sequence for f in played(second)] == [40]


def test_recording_stops_before_the_disk_is_full(tmp_path):
    room = [10**12]
    with Recording(tmp_path, free=lambda _: room[0]) as recording:
        object.__setattr__(recording.plan.settings, "keep_free_mib", 500.0)
        recording.feed(frame(0))
        wait_for(lambda: recording.recorder.state.measured == 1)
        room[0] = 499 * 2**20
        wait_for(lambda: recording.recorder.state.failure is not None)
        assert "499 MiB are left on the disk, and 500 MiB are to stay free" in recording.recorder.state.failure


def test_recording_starts_and_stops_when_asked(tmp_path):
    with Recording(tmp_path, enabled=False) as recording:
        recording.feed(frame(0))
        assert recording.recorder.stop_recording() is None
        with pytest.raises(RecordingError, match="nothing is being recorded"):
            recording.recorder.verify(None)
        folder = recording.recorder.start_recording()
        with pytest.raises(RecordingError, match="already"):
            recording.recorder.start_recording()
        assert open_session(folder).counts().end is SessionEnd.RECORDING
        recording.feed(frame(1))
        wait_for(lambda: recording.recorder.state.measured == 1)
        assert recording.recorder.stop_recording() == folder
        recording.feed(frame(2))
    session = open_session(folder)
    assert not session.about.from_start
    assert [a.row.sequence for a in session.answers()] == [1]
    assert [i.reason for i in session.index() if isinstance(i, Closed)] == ["stopped by the operator"]


def test_what_is_recorded_in_the_midst_counts_as_measured_once_what_was_remembered_has_come(tmp_path):
    with Recording(tmp_path, enabled=False, remembers=True) as recording:
        recorder = recording.recorder
        recording.feed(frame(0))
        assert not recorder.memory_wanted
        recorder.start_recording()
        assert recorder.memory_wanted
        before = frame(1)
        recorder.accept(before, remembering(results(before), 1))  # of a frame that is not in the session
        recording.feed(frame(2))  # measured before it was asked for
        third, fourth = frame(3), frame(4)
        for f in (third, fourth):
            recording.frames.offer(f)
            recorder.accept(f, remembering(results(f), f.sequence))
        wait_for(lambda: recorder.state.measured == 2)
        assert not recorder.memory_wanted
        recording.feed(frame(5))
    (folder,) = tmp_path.iterdir()
    session = open_session(folder)
    assert [a.row.sequence for a in session.answers()] == [3, 4, 5]
    assert session.counts().frames == 4
    assert session.memory() == {"before": 3}
    assert list(verify_session(folder)) == []


def test_a_session_from_the_start_waits_for_no_memory_and_one_that_cannot_be_kept_is_done_without(tmp_path):
    with Recording(tmp_path, remembers=True) as recording:
        assert not recording.recorder.memory_wanted
        recording.feed(frame(0))
        wait_for(lambda: recording.recorder.state.measured == 1)
        recording.recorder.stop_recording()
        folder = recording.recorder.start_recording()
        f = frame(1)
        recording.frames.offer(f)
        recording.recorder.accept(f, (replace(results(f)[0], memory=Memory.none()),))
        wait_for(lambda: recording.recorder.state.measured == 1)
    assert open_session(folder).memory() is None
    assert list(verify_session(folder)) == []


def remembering(given, number):
    return (replace(given[0], memory=Memory.of({"before": number})), *given[1:])


def test_nothing_is_asked_of_a_recorder_that_does_not_run(tmp_path):
    with Recording(tmp_path) as recording, pytest.raises(RecordingError, match="no frame has been measured"):
        recording.recorder.mark("weld 3")
    with pytest.raises(RecordingError, match="does not run"):
        recording.recorder.start_recording()


def test_events_are_kept_in_words(tmp_path):
    with Recording(tmp_path) as recording:
        recording.feed(frame(0))
        recording.recorder.event("LIVE stalled", "WARN", kind="source", silent_s=1.5)
    (folder,) = tmp_path.iterdir()
    said = list(open_session(folder).events())
    assert [e["kind"] for e in said] == ["began", "source", "closed"]
    assert (said[1]["text"], said[1]["level"], said[1]["silent_s"]) == ("LIVE stalled", "WARN", 1.5)
    assert (folder / EVENTS).is_file()


def test_a_folder_that_cannot_be_made_is_refused_in_a_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="no session can be recorded there"):
        Recording(tmp_path / "file").recorder.start()


def test_an_index_has_each_frame_once_and_in_order(tmp_path):
    folder = record(tmp_path, [frame(k) for k in range(30)], measured=lambda k: k % 7 == 0)
    rows = [i for i in read_index(folder / INDEX) if isinstance(i, Row)]
    assert [r.number for r in rows] == list(range(30))
    assert [r.received_ns for r in rows] == [10**10 + k * 40_000_000 for k in range(30)]


class Viewer:
    """Appends to a file as the viewer's does; its thread is left behind where told."""

    def __init__(self, path, running=False):
        self.path, self.running, self.events = path, running, []

    def start(self):
        self.path.write_bytes(b"head")

    def accept(self, frame, results):
        with self.path.open("ab") as file:
            file.write(bytes(1000))

    def event(self, text, level):
        self.events.append(text)

    def close(self, timeout_s):
        with self.path.open("ab") as file:
            file.write(b"tail")


@pytest.mark.parametrize("left_behind", [False, True])
def test_the_viewers_file_is_vouched_for_once_nobody_writes_to_it_any_more(tmp_path, left_behind):
    with Recording(tmp_path, viewer_for=lambda path: Viewer(path, left_behind)) as recording:
        recording.feed(*(frame(k) for k in range(5)))
        wait_for(lambda: recording.recorder.state.measured == 5)
    (folder,) = tmp_path.iterdir()
    (closed,) = [i for i in read_index(folder / INDEX) if isinstance(i, Closed)]
    assert ("viewer.rrd" in closed.sha256) is not left_behind
    assert [f for f in verify_session(folder) if f.grave] == []
    with (folder / "viewer.rrd").open("ab") as file:
        file.write(b"more")
    assert bool([f for f in verify_session(folder) if f.grave]) is not left_behind
