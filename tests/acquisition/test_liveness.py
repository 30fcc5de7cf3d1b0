"""What operators are told follows from the frames alone."""

from dataclasses import replace

import pytest

from drivers.grabber import SignalStatus
from service.acquisition.content import Content
from service.acquisition.health import AcquisitionState
from service.acquisition.liveness import Evidence, Liveness, Shown, shown
from service.config.supervision import SupervisionSettings

S = 1_000_000_000
NOW = 100 * S
GOOD = Evidence(Liveness.LIVE, AcquisitionState.RUNNING, since_ns=NOW, started=True, rate_hz=30.0, content=Content())


def told(**changes):
    return shown(NOW, replace(GOOD, **changes), SupervisionSettings())


@pytest.mark.parametrize("kind", [Liveness.LIVE, Liveness.REPLAY, Liveness.SIMULATED])
def test_good_frames_are_what_their_source_is(kind):
    assert told(kind=kind) == Shown(kind)
    assert told(kind=kind).good
    assert str(told(kind=kind)) == str(kind)


@pytest.mark.parametrize(
    ("changes", "liveness", "words"),
    [
        ({"content": Content(same=3, same_since_ns=90 * S)}, Liveness.FROZEN, "frozen"),
        ({"content": Content(flat=3, same=3)}, Liveness.NO_SIGNAL, "even grey"),
        ({"content": Content(signal=SignalStatus.NO_SIGNAL)}, Liveness.NO_SIGNAL, "no signal"),
        ({"content": Content(signal=SignalStatus.NO_LOCK)}, Liveness.NO_SIGNAL, "cannot be locked"),
        ({"since_ns": NOW - S}, Liveness.STALE, "no frame comes"),
        ({"since_ns": NOW - S, "content": Content(signal=SignalStatus.NO_SIGNAL)}, Liveness.NO_SIGNAL, "no signal"),
        ({"since_ns": NOW - S, "content": Content(same=9, flat=9)}, Liveness.STALE, "no frame comes"),
        ({"late_ns": S}, Liveness.STALE, "too late"),
        ({"measuring_ns": NOW - 3 * S}, Liveness.STALE, "measuring stands still"),
        ({"trouble": "was unplugged", "since_ns": NOW - 9 * S}, Liveness.RECONNECTING, "was unplugged"),
        ({"trouble": "was unplugged", "state": AcquisitionState.LOST}, Liveness.RECONNECTING, "was unplugged"),
        ({"since_ns": None, "started": False}, Liveness.STARTING, ""),
        ({"started": False}, Liveness.STARTING, "no frame yet"),
        ({"started": False, "since_ns": NOW - 4 * S}, Liveness.STALE, "since it was started"),
        ({"state": AcquisitionState.LOST}, Liveness.ENDED, "gone"),
        ({"state": AcquisitionState.FAULTED}, Liveness.ENDED, "failed"),
        ({"state": AcquisitionState.ENDED}, Liveness.ENDED, "over"),
        ({"state": AcquisitionState.CLOSED}, Liveness.ENDED, "stopped"),
    ],
)
def test_anything_wrong_is_told_and_never_called_live(changes, liveness, words):
    now = told(**changes)
    assert now.liveness is liveness
    assert words in now.reason
    assert not now.good


def test_frames_decide_and_not_the_state_of_the_program():
    assert told(state=AcquisitionState.STALLED).good
    assert not told(state=AcquisitionState.RUNNING, since_ns=NOW - S).good


def test_a_frozen_picture_says_since_when():
    assert told(content=Content(same=3, same_since_ns=90 * S)).since_ns == 90 * S


def test_a_recording_that_nobody_looks_into_is_never_frozen():
    assert told(kind=Liveness.REPLAY, content=None).good


def test_a_single_frame_does_not_make_a_picture_stale_that_is_being_measured():
    assert told(measuring_ns=NOW - S).good
