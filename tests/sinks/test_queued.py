import logging
import threading
import time

import numpy as np
import pytest

from drivers.frame import Field, Frame, PixelFormat
from service.sinks.base import SinkStats, SourceState
from service.sinks.queued import QueuedSink, SinkFailedError

PIXELS = np.zeros((4, 4), np.uint8)
LONG_S = 60.0


def frame(sequence):
    return Frame(PIXELS, sequence, sequence, sequence, Field.PROGRESSIVE, PixelFormat.MONO8, "test", 1)


class Recorder(QueuedSink):
    """Delivers to a list; waits at `gate` first, and raises where `raising` says so."""

    def __init__(self, capacity=4, raising=None, skipping=(), finish=None):
        super().__init__("recorder", capacity)
        self.gate, self.reached = threading.Event(), threading.Event()
        self.gate.set()
        self.raising, self.skipping, self.finish = raising or {}, skipping, finish
        self.delivered, self.started, self.finished, self.abandoned = [], 0, 0, 0

    def _do_start(self):
        self.started += 1

    def _do_consume(self, frame, results):
        self.reached.set()
        self.gate.wait(LONG_S)
        if frame.sequence in self.raising:
            raise self.raising[frame.sequence]
        if frame.sequence in self.skipping:
            return False
        self.delivered.append(frame.sequence)
        return True

    def _do_event(self, text, level):
        if text == "raise":
            raise OSError("no room")
        self.delivered.append((text, level))

    def _do_finish(self, timeout_s):
        self.finished += 1
        if self.finish:
            raise self.finish

    def _do_abandon(self):
        self.abandoned += 1


@pytest.fixture
def sink(request):
    sink = Recorder(**getattr(request, "param", {}))
    sink.start()
    yield sink
    sink.gate.set()
    sink.close(LONG_S)
    sink._thread.join(LONG_S)


def hold(sink):
    """Let the sink's thread take frame 0 and stop with it in hand."""
    sink.gate.clear()
    sink.accept(frame(0), ())
    assert sink.reached.wait(LONG_S)


def test_frames_are_delivered_in_order_and_the_rest_before_closing(sink):
    for i in range(4):
        sink.accept(frame(i), ())
    sink.close(LONG_S)
    assert sink.delivered == [0, 1, 2, 3]
    assert sink.finished == 1
    assert sink.stats() == SinkStats(accepted=4)


def test_a_full_queue_forgets_the_oldest_and_counts_it(sink):
    hold(sink)
    for i in range(1, 10):
        sink.accept(frame(i), ())
    assert sink.stats() == SinkStats(accepted=10, dropped=5, failed=0, depth=5)  # four waiting, one in hand
    sink.gate.set()
    sink.close(LONG_S)
    assert sink.delivered == [0, 6, 7, 8, 9]
    assert sink.stats() == SinkStats(accepted=10, dropped=5)


@pytest.mark.parametrize("sink", [{"raising": {1: ValueError("bad luck"), 2: OSError("worse")}}], indirect=True)
def test_an_error_costs_its_frame_only_and_is_told(sink, caplog):
    for i in range(4):
        sink.accept(frame(i), ())
    sink.close(LONG_S)
    assert sink.delivered == [0, 3]
    assert sink.stats() == SinkStats(accepted=4, failed=2)
    assert sink.failure is None
    assert "recorder: frame 1 not delivered: ValueError: bad luck" in caplog.text


@pytest.mark.parametrize(
    "sink", [{"capacity": 200, "raising": {i: ValueError("always") for i in range(200)}}], indirect=True
)
def test_a_fault_on_every_frame_does_not_flood_the_log(sink, caplog):
    for i in range(200):
        sink.accept(frame(i), ())
    sink.close(LONG_S)
    assert sink.stats() == SinkStats(accepted=200, failed=200)
    assert 1 <= len(caplog.records) <= 10


@pytest.mark.parametrize("sink", [{"raising": {0: SinkFailedError("the disk is full")}}], indirect=True)
def test_a_sink_that_failed_says_so_once_and_counts_on(sink, caplog):
    hold(sink)
    sink.accept(frame(1), ())
    sink.gate.set()
    deadline = time.monotonic() + LONG_S
    while sink.failure is None and time.monotonic() < deadline:
        time.sleep(0.001)
    sink.accept(frame(2), ())
    assert sink.failure == "the disk is full"
    assert sink.stats() == SinkStats(accepted=3, failed=3)
    sink.close(LONG_S)
    assert sink.delivered == []
    assert [r.levelno for r in caplog.records] == [logging.ERROR]


def test_a_stuck_sink_is_left_behind_at_the_deadline(sink, caplog):
    hold(sink)
    sink.accept(frame(1), ())
    sink.close(0.05)
    assert sink.abandoned == 1
    assert sink.stats() == SinkStats(accepted=2, dropped=2)
    assert "left behind" in caplog.text
    sink.gate.set()
    sink._thread.join(LONG_S)
    assert sink.delivered == [0]  # too late: it stays counted as dropped
    assert sink.stats() == SinkStats(accepted=2, dropped=2)
    assert sink.finished == 1


def test_what_does_not_fit_before_the_deadline_is_dropped_and_counted(sink):
    hold(sink)
    for i in range(1, 4):
        sink.accept(frame(i), ())
    closing = threading.Thread(target=sink.close, args=(LONG_S,))
    with sink._changed:
        sink._closing = (
            time.monotonic() - 1.0,
            time.monotonic() + LONG_S,
        )  # as if closing had begun and the time to deliver had run out
    sink.gate.set()
    closing.start()
    closing.join(LONG_S)
    assert sink.delivered == [0]
    assert sink.stats() == SinkStats(accepted=4, dropped=3)


def test_closing_twice_or_unstarted_does_no_harm(sink):
    sink.close(LONG_S)
    sink.close(LONG_S)
    assert sink.finished == 1
    never = Recorder()
    never.close(LONG_S)
    assert never.finished == 0


def test_frames_after_closing_are_dropped_and_counted(sink):
    sink.close(LONG_S)
    sink.accept(frame(0), ())
    assert sink.stats() == SinkStats(accepted=1, dropped=1)


@pytest.mark.parametrize("sink", [{"finish": OSError("gone")}], indirect=True)
def test_a_failing_end_is_told_and_harms_nothing(sink, caplog):
    sink.close(LONG_S)
    assert "recorder: did not close cleanly: gone" in caplog.text


def test_a_sink_that_cannot_start_leaves_no_thread(monkeypatch):
    sink = Recorder()
    monkeypatch.setattr(sink, "_do_start", lambda: (_ for _ in ()).throw(OSError("no")))
    with pytest.raises(OSError, match="no"):
        sink.start()
    sink.close(LONG_S)
    assert not sink._thread.is_alive()


def test_events_go_before_the_frames_that_wait_and_need_no_frame(sink):
    hold(sink)
    sink.accept(frame(1), ())
    sink.event("lamp off", "WARN")
    sink.gate.set()
    sink.close(LONG_S)
    assert sink.delivered == [0, ("lamp off", "WARN"), 1]
    alone = Recorder()
    alone.start()
    alone.event("only this")
    alone.close(LONG_S)
    assert alone.delivered == [("only this", "INFO")]


def test_an_event_that_fails_is_told_and_costs_no_frame(sink, caplog):
    sink.event("raise")
    sink.accept(frame(0), ())
    sink.close(LONG_S)
    assert sink.delivered == [0]
    assert sink.stats() == SinkStats(accepted=1)
    assert "event 'raise' not delivered: no room" in caplog.text


def test_too_many_events_forget_the_oldest_and_count_it(sink):
    hold(sink)
    for i in range(103):
        sink.event(str(i))
    sink.gate.set()
    sink.close(LONG_S)
    assert sink.events_dropped == 3
    assert sink.delivered[:2] == [0, ("3", "INFO")]


@pytest.mark.parametrize("sink", [{"skipping": (1, 2)}], indirect=True)
def test_a_frame_that_is_let_go_counts_as_dropped(sink):
    for i in range(4):
        sink.accept(frame(i), ())
    sink.close(LONG_S)
    assert sink.delivered == [0, 3]
    assert sink.stats() == SinkStats(accepted=4, dropped=2)


def test_of_what_the_picture_is_worth_only_the_newest_is_shown_and_an_error_costs_nothing_else(sink, caplog):
    shown = []

    def show(state):
        shown.append(state.word)
        raise OSError("no room")

    sink._do_state = show
    hold(sink)
    for word in ("LIVE", "STALE", "LIVE"):
        sink.state(SourceState(word))
    sink.gate.set()
    sink.accept(frame(1), ())
    sink.close(LONG_S)
    assert shown == ["LIVE"]
    assert sink.delivered == [0, 1]
    assert "state LIVE not delivered: no room" in caplog.text
