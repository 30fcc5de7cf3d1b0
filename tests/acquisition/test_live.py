import itertools
import sys
import threading
import time

import cv2
import pytest

from drivers.errors import ConfigError, DeviceDisconnectedError, DeviceNotFoundError
from drivers.grabber import FieldMode
from service.acquisition.live import LiveService
from service.acquisition.recovery import Supervision
from service.config.supervision import SupervisionSettings
from tests.bench.faults import CountingGrabber, tiny_scene
from tests.fakes.clock import ManualClock
from tests.fakes.scripted import (
    PATIENCE_S,
    FakeMeasurer,
    GatedMeasurer,
    Hang,
    RememberingSink,
    ScriptedGrabber,
    idle,
    make_frame,
)


def make(script, measurer=None, sinks=(), *, grabber=None, **kwargs):
    return LiveService(
        grabber or ScriptedGrabber(script), lambda _: measurer or FakeMeasurer(), sinks, every_frame=True, **kwargs
    )


def test_a_recording_runs_from_grabber_to_sink_and_is_accounted_for():
    sink = RememberingSink()
    with make([0, 1, make_frame(2, defect="torn"), 5], sinks=[sink]) as service:
        picture_format = service.start()
        assert (picture_format.width_px, picture_format.height_px) == (64, 48)
        assert service.wait(PATIENCE_S)
        health = service.health()
    assert sink.sequences == [0, 1, 2, 5]
    assert (sink.started, sink.closed) == (1, 1)
    assert health.state == "ended"
    account = health.account
    assert (account.delivered, account.lost, account.processed, account.corrupt) == (4, 2, 3, 1)
    assert account.balanced()
    assert health.locks == {"none": 4}
    assert health.sinks["memory"].accepted == 4
    assert service.failure is None
    assert service.latest.frame.sequence == 5


def test_a_lost_device_ends_it_with_the_reason_after_the_frames_before_it_are_answered():
    sink = RememberingSink()
    with make([0, 1, DeviceDisconnectedError("fake", "unplugged")], sinks=[sink]) as service:
        service.start()
        assert service.wait(PATIENCE_S)
    assert sink.sequences == [0, 1]
    assert str(service.failure) == "fake: unplugged"
    assert service.health().state == "lost"


def test_it_ends_where_measuring_itself_breaks_down(monkeypatch):
    service = make(idle())
    monkeypatch.setattr(service._hand_over, "take", lambda _: 1 / 0)
    with service:
        service.start()
        assert service.wait(PATIENCE_S)
    assert isinstance(service.failure, ZeroDivisionError)


def test_a_newest_wins_service_accounts_for_every_frame_of_a_faster_source():
    measurer = GatedMeasurer()
    service = LiveService(ScriptedGrabber(range(50)), lambda _: measurer)
    with service:
        service.start()
        measurer.let(50)
        assert service.wait(PATIENCE_S)
        account = service.health().account
    assert account.balanced()
    assert account.delivered == 50
    assert account.processed + account.superseded == 50
    assert account.in_flight == 0
    assert service.latest.frame.sequence == 49


@pytest.mark.parametrize(
    ("grabber", "measurer_for", "sink", "words"),
    [
        (ScriptedGrabber(on_open=DeviceNotFoundError("fake", "is not there")), FakeMeasurer, None, "is not there"),
        (None, ConfigError("camera.toml: 640x480"), None, "640x480"),
        (None, FakeMeasurer, ConfigError("port 9876: taken"), "port 9876"),
    ],
    ids=["device", "camera", "sink"],
)
def test_what_cannot_start_is_raised_and_nothing_is_left_running(grabber, measurer_for, sink, words):
    def make_measurer(_):
        if isinstance(measurer_for, Exception):
            raise measurer_for
        return measurer_for()

    started = []
    grabber = grabber or ScriptedGrabber([0], on_start=lambda: started.append(1))
    first, second = RememberingSink(), RememberingSink(on_start=sink)
    service = LiveService(grabber, make_measurer, [first, second])
    with pytest.raises((DeviceNotFoundError, ConfigError), match=words):
        service.start()
    assert not started
    assert first.closed == first.started
    assert second.closed == second.started
    assert service.wait(0)


def test_lossless_subscribers_are_served_beside_the_worker():
    service = make(range(10))
    queue, small = service.subscribe(100), service.subscribe(3)
    with service:
        service.start()
        assert service.wait(PATIENCE_S)
        assert service.health().overflowed == small.overflowed == 7
    assert [queue.take(0).sequence for _ in range(10)] == list(range(10))


class TestStopping:
    """Within the deadline from every state; what hangs is named and left."""

    @staticmethod
    def stop(service):
        before = time.monotonic()
        service.stop(1.0)
        assert time.monotonic() - before < 2.0

    def test_before_it_started(self):
        self.stop(make([]))

    def test_between_opening_and_beginning(self):
        service = make([0])
        service.open()
        self.stop(service)
        assert service.stuck == []
        assert service.health().account.delivered == 0

    def test_while_idle(self):
        service = make(idle())
        service.start()
        self.stop(service)
        assert service.stuck == []
        assert service.health().state == "closed"

    @pytest.mark.parametrize("every_frame", [False, True])
    def test_what_waits_is_still_measured(self, every_frame):
        measurer, release = GatedMeasurer(), threading.Event()
        grabber = ScriptedGrabber(itertools.chain(range(3), idle()))
        service = LiveService(grabber, lambda _: measurer, every_frame=every_frame)
        service.start()
        assert measurer.entered.acquire(timeout=PATIENCE_S)
        while grabber.counters.completed < 3:
            release.wait(0.001)
        measurer.let(3)
        self.stop(service)
        account = service.health().account
        assert account.in_flight == 0
        assert account.processed + account.superseded == 3
        assert service.stuck == []

    def test_while_the_queue_is_full_and_the_worker_busy(self):
        measurer = GatedMeasurer()
        service = make(range(1000), measurer)
        service.start()
        assert measurer.entered.acquire(timeout=PATIENCE_S)
        self.stop(service)
        assert service.stuck == ["the measuring thread"]
        assert service.health().account.balanced()
        measurer.let(100)
        assert service.wait(PATIENCE_S)

    def test_while_the_device_hangs(self):
        hang, sink = Hang(), RememberingSink()
        service = make([hang], sinks=[sink])
        service.start()
        assert hang.entered.wait(PATIENCE_S)
        self.stop(service)
        assert service.stuck == ["the acquisition thread"]
        assert sink.closed == 1
        assert sink.timeout_s > 0.3
        hang.release.set()
        assert service.wait(PATIENCE_S)

    def test_after_the_end_and_twice(self):
        sink = RememberingSink()
        service = make([0], sinks=[sink])
        service.start()
        assert service.wait(PATIENCE_S)
        self.stop(service)
        self.stop(service)
        assert sink.closed == 1

    def test_after_a_loss(self):
        service = make([DeviceDisconnectedError("fake", "gone")])
        service.start()
        assert service.wait(PATIENCE_S)
        self.stop(service)
        assert service.health().state == "lost"

    def test_a_sink_that_cannot_close_does_not_keep_the_others_open(self, caplog):
        first, last = RememberingSink(), RememberingSink()
        last.close = lambda _: 1 / 0
        service = make([0], sinks=[first, last])
        service.start()
        assert service.wait(PATIENCE_S)
        service.stop()
        assert first.closed == 1
        assert "closing failed" in caplog.text


def test_the_interpreter_is_tuned_while_it_runs_and_left_as_it_was():
    before = sys.getswitchinterval()
    with make(idle()) as service:
        service.start()
        assert sys.getswitchinterval() == pytest.approx(0.0005)
        assert cv2.getNumThreads() == 1
    assert sys.getswitchinterval() == before


def test_single_fields_reach_vision_with_their_own_times():
    frames = CountingGrabber(tiny_scene(interlaced=True), 30, clock=ManualClock(), field_mode=FieldMode.ALTERNATE)
    measurer = FakeMeasurer()
    service = LiveService(frames, lambda _: measurer, every_frame=True, supervision=Supervision(SupervisionSettings()))
    with service:
        service.start()
        assert frames.reached.wait(PATIENCE_S)
    fields = [(field, time_ns) for _, time_ns, field in measurer.calls]
    assert [field for field, _ in fields[:4]] == ["top", "bottom", "top", "bottom"]
    assert {b - a for (_, a), (_, b) in itertools.pairwise(fields[:20])} == {20_000_000}
