import logging

import pytest

from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DeviceProtocolError,
    DeviceStateError,
    DeviceTimeoutError,
)
from service.acquisition.device import Device
from service.acquisition.health import AcquisitionState
from service.acquisition.intake import Intake
from service.acquisition.ledger import Ledger
from service.acquisition.slot import FrameQueue, NewestSlot
from service.acquisition.thread import AcquisitionThread
from tests.fakes.clock import ManualClock
from tests.fakes.scripted import PATIENCE_S, Hang, ScriptedGrabber, idle, make_frame


class Rig:
    """An acquisition thread over a script, with a queue that takes everything."""

    def __init__(self, script=(), *, hand_over=None, subscribers=(), prepare=None, **kwargs):
        self.grabber = ScriptedGrabber(script, **kwargs)
        self.hand_over = FrameQueue(1000) if hand_over is None else hand_over
        self.ledger = Ledger()
        self.intake = Intake(self.hand_over, self.ledger, subscribers, self.grabber.clock, None)
        self.thread = AcquisitionThread(Device(self.grabber, prepare), self.intake)

    def run_to_the_end(self):
        self.thread.open(PATIENCE_S)
        self.thread.begin()
        assert self.thread.join(PATIENCE_S)
        return self

    @property
    def frames(self):
        return [self.hand_over.take(0).sequence for _ in range(self.hand_over.depth)]


@pytest.fixture
def rig():
    rigs = []

    def make(*args, **kwargs):
        rigs.append(Rig(*args, **kwargs))
        return rigs[-1]

    yield make
    for r in rigs:
        r.thread.request_stop()
        assert r.thread.join(PATIENCE_S)


def test_a_recording_is_handed_on_whole_and_its_end_is_no_failure(rig):
    r = rig([0, 1, TimeoutError, 2]).run_to_the_end()
    assert r.frames == [0, 1, 2]
    assert r.thread.state is AcquisitionState.ENDED
    assert r.thread.failure is None
    assert r.hand_over.exhausted
    assert r.grabber.state == "closed"
    assert r.ledger.account().delivered == 3


def test_only_its_own_thread_touches_the_device(rig):
    r = rig([0]).run_to_the_end()
    assert r.grabber.thread_names == {"bowlsight-acquisition"}


def test_nothing_streams_before_begin(rig):
    started = []
    r = rig([0], on_start=lambda: started.append(1))
    picture_format = r.thread.open(PATIENCE_S)
    assert (picture_format.width_px, picture_format.height_px) == (64, 48)
    assert r.thread.state is AcquisitionState.OPENING
    assert not started
    r.thread.begin()
    assert r.thread.join(PATIENCE_S)
    assert started


def test_the_device_is_set_up_between_opening_and_streaming(rig):
    states = []
    rig([0], prepare=lambda grabber: states.append(grabber.state)).run_to_the_end()
    assert states == ["open"]


def test_a_setting_that_the_device_refuses_is_raised_by_open_and_the_device_given_back(rig):
    r = rig([0], prepare=lambda grabber: grabber.select_input("S-Video 9"))
    with pytest.raises(DeviceStateError, match="fake: has no input S-Video 9; it offers fake"):
        r.thread.open(PATIENCE_S)
    assert r.thread.join(PATIENCE_S)
    assert r.grabber.state == "closed"


@pytest.mark.parametrize("error", [DeviceNotFoundError("fake", "is not there"), DeviceBusyError("fake", "is taken")])
def test_what_open_raises_reaches_the_caller(rig, error):
    r = rig(on_open=error)
    with pytest.raises(type(error), match="fake: is"):
        r.thread.open(PATIENCE_S)
    assert r.thread.join(PATIENCE_S)
    assert r.thread.state is AcquisitionState.FAULTED


def test_a_device_that_hangs_while_opening_is_given_up(rig):
    hang = Hang()
    r = rig(on_open=hang)
    with pytest.raises(DeviceTimeoutError, match="did not open within"):
        r.thread.open(0.01)
    assert not r.thread.join(0)
    hang.release.set()
    assert r.thread.join(PATIENCE_S)
    assert r.grabber.state == "closed"


@pytest.mark.parametrize(
    ("error", "state"),
    [
        (DeviceDisconnectedError("fake", "is gone"), AcquisitionState.LOST),
        (DeviceProtocolError("fake", "answers nonsense"), AcquisitionState.FAULTED),
        (RuntimeError("a driver's own mistake"), AcquisitionState.FAULTED),
    ],
)
def test_a_device_that_fails_ends_it_with_the_reason_and_the_frames_before_it(rig, error, state):
    r = rig([0, 1, error, 2]).run_to_the_end()
    assert r.thread.failure is error
    assert r.thread.state is state
    assert r.frames == [0, 1]
    assert r.hand_over.exhausted
    assert r.grabber.state == "closed"


def test_a_start_that_fails_is_a_failure_too(rig):
    r = rig(on_start=DeviceProtocolError("fake", "will not stream")).run_to_the_end()
    assert "will not stream" in str(r.thread.failure)
    assert r.thread.state is AcquisitionState.FAULTED


def test_a_close_that_fails_does_not_keep_consumers_waiting(rig, caplog):
    r = rig([0], on_close=OSError("stuck")).run_to_the_end()
    assert r.hand_over.take(0).sequence == 0
    assert r.hand_over.exhausted
    assert "closing failed" in caplog.text


def test_bad_frames_are_counted_handed_on_and_said_once(rig, caplog):
    bad = [make_frame(i, defect="torn in line 12") for i in range(1, 30)]
    r = rig([0, *bad, 30], clock=ManualClock()).run_to_the_end()
    assert r.ledger.account().corrupt == 29
    assert r.frames == list(range(31))
    assert [m for m in caplog.messages if "torn" in m] == ["fake: frame 1 is bad: torn in line 12"]


def test_the_state_follows_the_frames(rig):
    seen = []
    clock = ManualClock()

    def note():
        seen.append(r.thread.state)
        return TimeoutError

    def silence():
        clock.advance(0.6)
        return TimeoutError

    script = [note, 0, note, make_frame(1, defect="torn"), note, 2, note, silence, note, 3, note]
    r = rig(script, clock=clock)
    r.run_to_the_end()
    assert seen == ["opening", "running", "degraded", "running", "stalled", "running"]


def test_a_source_that_never_gives_a_frame_stalls(rig):
    clock = ManualClock()
    seen = []
    r = rig(
        [lambda: clock.advance(3.0) or TimeoutError, lambda: seen.append(r.thread.state) or TimeoutError], clock=clock
    )
    assert r.intake.silent_s(clock.now_ns) is None
    r.run_to_the_end()
    assert seen == ["stalled"]


def test_the_newest_frame_supersedes_and_the_ledger_says_so(rig):
    r = rig([0, 1, make_frame(2, defect="torn"), 3], hand_over=NewestSlot()).run_to_the_end()
    account = r.ledger.account()
    assert (account.superseded, account.corrupt, account.in_flight) == (2, 1, 1)
    assert account.balanced()
    assert r.frames == [3]


def test_lossless_subscribers_get_every_frame_and_never_hold_it_up(rig, caplog):
    caplog.set_level(logging.WARNING)
    roomy, small = FrameQueue(10), FrameQueue(2)
    r = rig([0, 1, 2, 3], hand_over=NewestSlot(), subscribers=[roomy, small]).run_to_the_end()
    assert [roomy.take(0).sequence for _ in range(4)] == [0, 1, 2, 3]
    assert roomy.exhausted
    assert (small.depth, small.overflowed) == (2, 2)
    assert "lossless queue is full" in caplog.text
    assert r.ledger.account().delivered == 4


def test_a_full_queue_holds_back_a_source_that_can_wait_until_stopped(rig):
    r = rig(range(100), hand_over=FrameQueue(2))
    r.thread.open(PATIENCE_S)
    r.thread.begin()
    assert [r.hand_over.take(PATIENCE_S).sequence for _ in range(5)] == [0, 1, 2, 3, 4]
    r.thread.request_stop()
    r.hand_over.close()
    assert r.thread.join(PATIENCE_S)
    assert r.ledger.account().balanced()
    assert r.ledger.account().superseded == 0


@pytest.mark.parametrize("begun", [False, True])
def test_it_stops_from_before_and_while_streaming(rig, begun):
    r = rig(idle())
    r.thread.open(PATIENCE_S)
    if begun:
        r.thread.begin()
    r.thread.request_stop()
    assert r.thread.join(PATIENCE_S)
    assert r.thread.state is AcquisitionState.CLOSED
    assert r.thread.failure is None


def test_one_that_was_never_opened_can_be_stopped():
    r = Rig()
    r.thread.request_stop()
    assert r.thread.join(0)
