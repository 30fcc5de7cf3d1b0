"""A live source that fails is got back, in steps, with words, and without a frame unaccounted for."""

import itertools
import threading

import numpy as np
import pytest

from drivers.errors import (
    ConfigError,
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceNotFoundError,
    DeviceProtocolError,
)
from drivers.frame import PixelFormat
from drivers.grabber import FrameFormat, Input, SignalStatus
from service.acquisition.content import PictureWatch
from service.acquisition.health import AcquisitionState
from service.acquisition.intake import Intake
from service.acquisition.ledger import Ledger
from service.acquisition.liveness import Liveness
from service.acquisition.recovery import Supervision
from service.acquisition.slot import FrameQueue
from service.acquisition.supervisor import MOST_LEFT_BEHIND, Supervisor
from service.acquisition.thread import PAUSE_S
from service.config.supervision import SupervisionSettings
from tests.fakes.clock import HurriedClock, ManualClock
from tests.fakes.scripted import PATIENCE_S, Hang, ScriptedGrabber, idle

UNPLUGGED = DeviceDisconnectedError("fake", "was unplugged")
ABSENT = DeviceNotFoundError("fake", "is not there")


class LiveGrabber(ScriptedGrabber):
    """A scripted device with two inputs and a signal, whose pictures change from frame to frame."""

    def __init__(self, *args, opening=(), **kwargs):
        super().__init__(*args, **kwargs)
        self.opening = iter(opening)
        self.selected, self.signal, self.size = "A", SignalStatus.OK, (64, 48)
        self.calls = []

    @property
    def format(self):
        return FrameFormat(*self.size, PixelFormat.MONO8, "fake", self.rate_hz)

    @property
    def inputs(self):
        return (Input("A"), Input("B"))

    @property
    def input(self):
        return self.selected

    def select_input(self, name):
        self.calls.append(f"select {name}")
        self.selected = name

    def signal_status(self):
        return self.signal

    def _do_open(self):
        self.calls.append("open")
        if (error := next(self.opening, None)) is not None:
            raise error
        super()._do_open()

    def _do_start(self, mode):
        self.calls.append("start")
        super()._do_start(mode)


class Rig:
    def __init__(self, script=(), *, grabber=None, clock=None, settings=None, reset=None, remake=None, prepare=None,
                 opening=(), watch=False):  # fmt: skip
        clock = clock or ManualClock()
        self.grabber = grabber or LiveGrabber(script, clock=clock, opening=opening)
        self.hand_over, self.ledger, self.events = FrameQueue(10_000), Ledger(), []
        settings = settings or SupervisionSettings()
        supervision = Supervision(settings, remake, reset)
        looks = PictureWatch(settings.frozen_frames, settings.flat_levels) if watch else None
        self.intake = Intake(self.hand_over, self.ledger, [], clock, looks)
        self.supervisor = Supervisor(
            self.grabber, self.intake, Liveness.LIVE, prepare, supervision, lambda *e: self.events.append(e)
        )

    def begin(self):
        self.supervisor.open(PATIENCE_S)
        self.supervisor.begin()
        return self

    def run_to_the_end(self):
        self.begin()
        assert self.supervisor.join(PATIENCE_S)
        assert self.ledger.account().balanced()
        return self

    def frames(self):
        taken = [self.hand_over.take(0) for _ in range(self.hand_over.depth)]
        return [(f.generation, f.sequence) for f in taken]

    def said(self, words):
        return [text for text, _ in self.events if words in text]


@pytest.fixture
def rig():
    rigs = []

    def make(*args, **kwargs):
        rigs.append(Rig(*args, **kwargs))
        return rigs[-1]

    yield make
    for r in rigs:
        r.supervisor.request_stop()
        assert r.supervisor.join(PATIENCE_S)


def test_an_unplugged_device_is_looked_for_until_it_is_back(rig):
    r = rig([0, 1, UNPLUGGED, 0, 1], opening=[None, ABSENT, ABSENT]).run_to_the_end()
    assert r.frames() == [(1, 0), (1, 1), (2, 0), (2, 1)]
    assert r.said("fake: was unplugged; looking for it")
    assert len(r.said("is not there")) == 1
    assert r.said("streams again")
    assert "generation 2" in r.said("streams again")[0]
    assert r.supervisor.recoveries == 1
    assert r.supervisor.failure is None


def test_a_device_that_stalls_is_restarted_then_opened_again(rig):
    clock = ManualClock()

    def silence():
        clock.advance(4)
        return TimeoutError

    r = rig([0, silence, silence, 0, 1], clock=clock).run_to_the_end()
    assert r.grabber.calls == ["open", "start", "start", "open", "start"]
    assert r.frames() == [(1, 0), (3, 0), (3, 1)]
    assert r.said("restarting the stream")
    assert r.said("opening it again")
    assert r.supervisor.recoveries == 1


def test_a_stream_without_a_first_frame_is_restarted_too(rig):
    clock = ManualClock()
    r = rig([lambda: clock.advance(4) or TimeoutError, 0], clock=clock).run_to_the_end()
    assert r.frames() == [(2, 0)]


@pytest.mark.parametrize("error", [DeviceProtocolError("fake", "answers nonsense"), RuntimeError("a mistake")])
def test_a_device_that_fails_is_opened_again_at_once(rig, error):
    r = rig([0, error, 0]).run_to_the_end()
    assert r.frames() == [(1, 0), (2, 0)]
    assert r.said(str(error))
    assert r.grabber.calls == ["open", "start", "open", "start"]


def test_a_device_that_somebody_else_holds_is_asked_again_after_longer_and_longer(rig):
    clock = ManualClock()
    busy = [DeviceBusyError("fake", "is taken")] * 8
    r = rig([0, UNPLUGGED, 0], clock=clock, opening=[None, *busy]).run_to_the_end()
    assert r.frames() == [(1, 0), (2, 0)]
    assert 15 < clock.now_ns / 1e9 - 1 < 30
    assert len(r.said("is taken")) == 1


def test_settings_that_the_device_does_not_take_any_more_are_final(rig):
    asked = itertools.count()

    def prepare(grabber):
        if next(asked):
            raise ConfigError("fake: has no contrast")

    r = rig([0, UNPLUGGED, 0], prepare=prepare).run_to_the_end()
    assert str(r.supervisor.failure) == "fake: has no contrast"
    assert r.supervisor.state is AcquisitionState.FAULTED
    assert r.supervisor.shown().liveness is Liveness.ENDED
    assert r.grabber.state == "closed"


def test_a_device_that_nothing_helps_is_reset_once_a_minute(rig):
    clock, resets = ManualClock(), []
    faults = [DeviceProtocolError("fake", "answers nonsense")] * 60
    r = rig([0, *faults, 0], clock=clock, reset=lambda: resets.append(clock.now_ns / 1e9)).run_to_the_end()
    assert r.frames() == [(1, 0), (61, 0)]
    assert 2 <= len(resets) <= 6
    assert min(np.diff(resets)) >= 60
    assert r.said("resetting it on its bus")


def test_a_reset_that_fails_is_one_more_failure(rig):
    def reset():
        raise DeviceBusyError("fake", "is taken")

    faults = [DeviceProtocolError("fake", "answers nonsense")] * 3
    r = rig([0, *faults, 0], reset=reset).run_to_the_end()
    assert r.frames()[-1][1] == 0
    assert r.said("is taken")


def test_a_device_that_fails_after_each_frame_is_left_in_peace_for_longer(rig):
    clock = ManualClock()
    fault = DeviceProtocolError("fake", "answers nonsense")
    rig([0, fault] * 20, clock=clock).run_to_the_end()
    assert clock.now_ns / 1e9 > 40


def test_a_stream_that_was_steady_is_got_back_at_once(rig):
    clock = ManualClock()

    def steady():
        clock.advance(3)
        return 1

    fault = DeviceProtocolError("fake", "answers nonsense")
    rig([0, steady, fault] * 20, clock=clock).run_to_the_end()
    assert clock.now_ns / 1e9 - 1 < 65


def test_what_is_shown_follows_the_source(rig):
    shown = []

    def look_at(step):
        return lambda: shown.append(r.supervisor.shown().liveness) or step

    r = rig([look_at(0), look_at(1), UNPLUGGED, look_at(0)])
    r.run_to_the_end()
    assert shown == [Liveness.STARTING, Liveness.LIVE, Liveness.RECONNECTING]


# -- signal, content, inputs, format -----------------------------------------------------------------------------------


class PictureGrabber(LiveGrabber):
    """Gives each frame a picture of its own, or the same again and again."""

    still, period_s = False, 0.04

    def _do_read(self, timeout_s):
        frame = super()._do_read(timeout_s)
        pixels = np.random.default_rng(0 if self.still else frame.sequence).integers(0, 255, (48, 64), np.uint8)
        self.clock.advance(self.period_s)
        return make_picture(frame, pixels, self.clock)


def make_picture(frame, pixels, clock):
    return type(frame)(
        pixels, frame.sequence, clock.monotonic_ns(), clock.monotonic_ns(), frame.field, frame.pixel_format,
        frame.source, frame.generation, frame.defect,
    )  # fmt: skip


def frames_from(first, count):
    return range(first, first + count)


def test_a_frozen_picture_is_marked_told_and_its_source_restarted(rig):
    clock = ManualClock()
    seen = []

    def freeze():
        r.grabber.still = True
        return 5

    def look():
        seen.append(r.supervisor.shown().liveness)
        r.grabber.still = False
        return 0

    grabber = PictureGrabber([*range(5), freeze, *frames_from(6, 252), look, 1, 2], clock=clock)
    r = rig(grabber=grabber, clock=clock, watch=True)
    r.run_to_the_end()
    account = r.ledger.account()
    assert account.corrupt > 200
    assert r.said("its picture has been frozen for 10 s; restarting the stream")
    assert grabber.calls == ["open", "start", "start"]
    assert r.said("streams again")


def test_without_a_signal_the_source_is_waited_for_and_not_restarted(rig):
    clock = ManualClock()
    shown = []

    def lose():
        r.grabber.signal = SignalStatus.NO_SIGNAL
        clock.advance(2)
        return TimeoutError

    def note():
        shown.append(r.supervisor.shown())
        return TimeoutError

    def back():
        r.grabber.signal = SignalStatus.OK
        return 1

    r = rig([0, lose, note, back, 2], clock=clock, watch=True)
    r.run_to_the_end()
    assert shown[0].liveness is Liveness.NO_SIGNAL
    assert r.grabber.calls == ["open", "start"]
    assert [s for _, s in r.frames()] == [0, 1, 2]


def test_an_input_that_somebody_else_switched_is_switched_back_as_a_new_view(rig):
    clock = ManualClock()

    def meddle():
        r.grabber.selected = "B"
        clock.advance(1.5)
        return 1

    r = rig([0, meddle, 2, 3], clock=clock)
    r.run_to_the_end()
    assert r.grabber.calls == ["open", "start", "select A"]
    assert r.said("somebody switched it to input B; switching back to A")
    assert r.frames() == [(1, 0), (1, 1), (2, 2), (2, 3)]
    assert r.ledger.account().lost == 0


def test_the_operator_s_input_is_kept_over_a_replug(rig):
    def replug():
        r.grabber.selected = "A"
        return UNPLUGGED

    def ask():
        r.supervisor.select_input("B")
        return 0

    r = rig([ask, 1, replug, 0])
    r.run_to_the_end()
    assert r.said("switched to input B")
    assert r.grabber.calls == ["open", "start", "select B", "open", "select B", "start"]
    assert r.frames() == [(1, 0), (2, 1), (3, 0)]


def test_an_input_that_is_not_there_is_refused_to_who_asks(rig):
    r = rig(idle()).begin()
    with pytest.raises(ValueError, match="fake has no input 'C'; it offers A, B"):
        r.supervisor.select_input("C")


def test_another_resolution_after_opening_again_is_told(rig):
    def change():
        r.grabber.size = (720, 576)
        return DeviceProtocolError("fake", "its source changed from 640x480 to 720x576")

    r = rig([0, change, 0])
    r.run_to_the_end()
    assert r.said("its pictures are 720x576 px now; they were 64x48 px")


# -- calls that never return -------------------------------------------------------------------------------------------


def waited_for(condition):
    patience = threading.Event()
    for _ in range(int(PATIENCE_S / 0.01)):
        if condition():
            return True
        patience.wait(0.01)
    return False


def test_a_hung_device_is_left_to_its_thread_and_another_grabber_goes_on(rig):
    clock, hang = HurriedClock(), Hang()
    second = LiveGrabber([0, 1], clock=clock)
    first = LiveGrabber([0, hang], clock=clock)
    r = rig(grabber=first, clock=clock, remake=lambda: second).begin()
    assert hang.entered.wait(PATIENCE_S)
    clock.advance(10)
    assert waited_for(lambda: r.ledger.account().delivered == 3)
    assert first.state == "streaming"
    hang.release.set()
    assert waited_for(lambda: first.state == "closed")
    assert r.supervisor.join(PATIENCE_S)
    assert r.frames() == [(1, 0), (2, 0), (2, 1)]
    assert r.said("reading does not return; it is left behind")
    assert r.said("streams again")
    assert r.ledger.account().balanced()


def test_a_frame_that_comes_out_of_a_hung_call_is_nobody_s(rig):
    clock, hang = HurriedClock(), Hang()

    def late():
        hang()
        return 7

    first, second = LiveGrabber([0, late], clock=clock), LiveGrabber(idle(), clock=clock)
    r = rig(grabber=first, clock=clock, remake=lambda: second).begin()
    assert hang.entered.wait(PATIENCE_S)
    clock.advance(10)
    assert waited_for(lambda: second.state == "streaming")
    hang.release.set()
    assert waited_for(lambda: first.state == "closed")
    assert r.ledger.account().delivered == 1


def test_a_device_that_hangs_again_and_again_does_not_use_up_the_machine(rig):
    clock, hangs = HurriedClock(), []

    def another():
        hangs.append(Hang())
        return LiveGrabber([hangs[-1]], clock=clock)

    r = rig(grabber=another(), clock=clock, remake=another).begin()
    for i in range(MOST_LEFT_BEHIND + 1):
        assert waited_for(lambda i=i: len(hangs) > i)
        assert hangs[i].entered.wait(PATIENCE_S)
        clock.advance(10)
    threading.Event().wait(0.3)
    assert len(hangs) == MOST_LEFT_BEHIND + 1
    for hang in hangs:
        hang.release.set()
    assert waited_for(lambda: r.supervisor.recoveries >= 0)


# -- stopping ----------------------------------------------------------------------------------------------------------


class PatientClock(ManualClock):
    """Sleeps one test step at a time, and remembers for how long it was asked to."""

    def __init__(self):
        super().__init__()
        self.asked, self.sleeping, self.let = [], threading.Event(), threading.Event()

    def sleep(self, seconds):
        self.asked.append(seconds)
        self.sleeping.set()
        assert self.let.wait(PATIENCE_S)
        super().sleep(seconds)


@pytest.mark.parametrize("error", [UNPLUGGED, DeviceBusyError("fake", "is taken")])
def test_a_stop_ends_a_pause_within_one_short_sleep(rig, error):
    clock = PatientClock()
    r = rig([0, error, 0], clock=clock).begin()
    assert clock.sleeping.wait(PATIENCE_S)
    assert r.supervisor.shown().liveness is Liveness.RECONNECTING
    r.supervisor.request_stop()
    clock.let.set()
    assert r.supervisor.join(PATIENCE_S)
    assert len(clock.asked) == 1
    assert clock.asked[0] <= PAUSE_S
    assert r.grabber.state == "closed"
    assert r.supervisor.failure is None


def test_a_stop_while_the_device_is_away_ends_the_search(rig):
    r = rig([0, UNPLUGGED], opening=[None, *[ABSENT] * 10**6]).begin()
    assert waited_for(lambda: len(r.grabber.calls) > 50)
    r.supervisor.request_stop()
    assert r.supervisor.join(PATIENCE_S)
    assert r.supervisor.state is AcquisitionState.CLOSED


def test_a_stop_while_the_device_hangs_leaves_it(rig):
    hang = Hang()
    r = rig([0, hang]).begin()
    assert hang.entered.wait(PATIENCE_S)
    r.supervisor.request_stop()
    assert not r.supervisor.join(0)
    hang.release.set()


def test_the_operator_s_input_is_kept_by_the_thread_that_takes_over(rig):
    clock, hang = HurriedClock(), Hang()

    def ask():
        r.supervisor.select_input("B")
        return 0

    first, second = LiveGrabber([ask, 1, hang], clock=clock), LiveGrabber([0], clock=clock)
    r = rig(grabber=first, clock=clock, remake=lambda: second)
    r.begin()
    assert hang.entered.wait(PATIENCE_S)
    clock.advance(10)
    assert waited_for(lambda: second.state == "streaming" or second.calls)
    assert r.supervisor.join(PATIENCE_S)
    assert second.calls == ["open", "select B", "start"]
    assert r.supervisor.input == "B"
    hang.release.set()
    assert waited_for(lambda: first.state == "closed")


def test_a_picture_that_stays_frozen_has_its_source_restarted_more_and_more_seldom(rig):
    clock = ManualClock()
    grabber = PictureGrabber(itertools.repeat(0, 8_000), clock=clock)
    grabber.still, grabber.period_s = True, 0.1
    rig(grabber=grabber, clock=clock, watch=True).run_to_the_end()
    assert 5 <= grabber.calls.count("start") <= 8  # after 10, 30, 70, 150, 310, 630 s of 800
