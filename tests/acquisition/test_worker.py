import pytest

from service.acquisition.ledger import Ledger
from service.acquisition.measuring import FrameMeasurer
from service.acquisition.slot import FrameQueue, NewestSlot
from service.acquisition.worker import Worker
from tests.fakes.clock import ManualClock
from tests.fakes.scripted import PATIENCE_S, FakeMeasurer, GatedMeasurer, RememberingSink, make_frame, nothing_found


class Rig:
    def __init__(self, measurer=None, *, hand_over=None, sinks=None, oldest_s=None):
        self.clock, self.ledger = ManualClock(), Ledger()
        self.hand_over = hand_over or FrameQueue(1000)
        self.sink = RememberingSink()
        frames = FrameMeasurer(measurer or FakeMeasurer(), None, self.clock)
        self.worker = Worker(self.hand_over, frames, sinks or [self.sink], self.ledger, self.clock, oldest_s)

    def put(self, frame):
        self.ledger.arrived(frame)
        return self.hand_over.put(frame)

    def finish(self):
        self.hand_over.close()
        assert self.worker.join(PATIENCE_S)
        return self.ledger.account()


def test_every_frame_of_an_ordered_source_is_answered_in_order():
    rig = Rig()
    for i in range(20):
        rig.put(make_frame(i))
    rig.worker.start()
    account = rig.finish()
    assert rig.sink.sequences == list(range(20))
    assert (account.processed, account.in_flight) == (20, 0)
    assert rig.worker.locks == {"none": 20}
    assert rig.worker.latest.frame.sequence == 19


def test_a_slow_measurer_takes_the_newest_and_delays_nobody():
    measurer, slot = GatedMeasurer(), NewestSlot()
    rig = Rig(measurer, hand_over=slot)
    rig.worker.start()
    rig.put(make_frame(0))
    assert measurer.entered.acquire(timeout=PATIENCE_S)
    displaced = [rig.put(make_frame(i)) for i in range(1, 6)]  # returns although the worker is stuck at frame 0
    assert [f and f.sequence for f in displaced] == [None, 1, 2, 3, 4]
    measurer.let(2)
    rig.finish()
    assert rig.sink.sequences == [0, 5]


def test_a_frame_that_cannot_be_measured_is_counted_told_and_survived(caplog):
    answers = iter([ZeroDivisionError("no tubes\nat all"), None, ZeroDivisionError("again")])

    def answer():
        if error := next(answers):
            raise error
        return [nothing_found()]

    rig = Rig(FakeMeasurer(answer))
    for i in range(3):
        rig.put(make_frame(i))
    rig.worker.start()
    account = rig.finish()
    assert (account.processed, account.failed) == (1, 2)
    assert [r[0].measurement.reason for _, r in rig.sink.got] == [
        "measuring failed: ZeroDivisionError: no tubes at all",
        "nothing there",
        "measuring failed: ZeroDivisionError: again",
    ]
    assert len([m for m in caplog.messages if "could not be measured" in m]) == 1


def test_a_bad_frame_is_answered_without_being_measured():
    measurer = FakeMeasurer()
    rig = Rig(measurer)
    rig.put(make_frame(0, defect="torn"))
    rig.worker.start()
    account = rig.finish()
    ((_, (result,)),) = rig.sink.got
    assert (result.measurement.lock, result.measurement.reason) == ("none", "bad frame: torn")
    assert measurer.calls == []
    assert (account.corrupt, account.processed) == (1, 0)
    assert account.balanced()


@pytest.mark.parametrize(("age_s", "measured"), [(0.4, 1), (0.6, 0)])
def test_a_frame_that_waited_too_long_is_not_measured(age_s, measured):
    rig = Rig(oldest_s=0.5)
    rig.put(make_frame(0, received_ns=rig.clock.now_ns))
    rig.clock.advance(age_s)
    rig.worker.start()
    account = rig.finish()
    assert (account.processed, account.too_old) == (measured, 1 - measured)
    assert len(rig.sink.got) == measured


def test_a_sink_that_raises_harms_neither_the_others_nor_the_frames(caplog):
    broken, sound = RememberingSink(on_accept=OSError("full")), RememberingSink()
    broken.name = "broken"
    rig = Rig(sinks=[broken, sound])
    for i in range(5):
        rig.put(make_frame(i))
    rig.worker.start()
    assert rig.finish().processed == 5
    assert broken.sequences == sound.sequences == [0, 1, 2, 3, 4]
    assert rig.worker.refused["broken"] == 5
    assert len([m for m in caplog.messages if "broken: refused" in m]) == 1


def test_age_and_latency_count_from_when_the_driver_had_the_frame():
    rig = Rig()
    rig.put(make_frame(0, received_ns=rig.clock.now_ns))
    rig.clock.advance(0.004)
    rig.worker.start()
    rig.finish()
    assert rig.worker.age_ms.percentiles().p50 == pytest.approx(4)
    assert rig.worker.latency_ms.percentiles().p99 == pytest.approx(4)
    assert rig.worker.latest.latency_ms == pytest.approx(4)


def test_a_stop_ends_it_after_the_frame_in_hand_and_leaves_the_rest_in_flight():
    measurer = GatedMeasurer()
    rig = Rig(measurer)
    for i in range(3):
        rig.put(make_frame(i))
    rig.worker.start()
    assert measurer.entered.acquire(timeout=PATIENCE_S)
    rig.worker.request_stop()
    assert not rig.worker.join(0)
    measurer.let()
    assert rig.worker.join(PATIENCE_S)
    account = rig.ledger.account()
    assert (account.processed, account.in_flight) == (1, 2)
    assert account.balanced()


def test_a_mistake_of_the_worker_itself_is_kept_and_ends_capture_too(caplog):
    class Broken(FrameQueue):
        def take(self, timeout_s):
            raise MemoryError("no room")

    rig = Rig(hand_over=Broken(4))
    rig.worker.start()
    assert rig.worker.join(PATIENCE_S)
    assert isinstance(rig.worker.failure, MemoryError)
    assert rig.hand_over.exhausted
    assert "measuring thread ends" in caplog.text
