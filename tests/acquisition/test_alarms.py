"""Alarms are raised, told and kept whether or not a page is served."""

import logging
import time
from dataclasses import replace

import pytest

from drivers.grabber import SystemClock
from service.acquisition.alarms import AlarmWatch, source_conditions
from service.acquisition.liveness import Liveness, Shown
from service.alignment.desk import AlarmDesk
from service.console.watched import SourceStatus
from tests.browser.served import aligner_at
from tests.fakes.drawn import made_up
from tests.fakes.station import FakeStation


@pytest.mark.parametrize(
    ("kind", "word", "keys"),
    [
        ("LIVE", "LIVE", []),
        ("LIVE", "STARTING", []),
        ("LIVE", "FROZEN", ["source frozen"]),
        ("LIVE", "NO SIGNAL", ["source no signal"]),
        ("LIVE", "ENDED", ["source ended"]),
        ("REPLAY", "ENDED", []),
        ("REPLAY", "STALE", ["source stale"]),
    ],
)
def test_what_is_wrong_with_the_source_is_an_alarm(kind, word, keys):
    assert [c.key for c in source_conditions(Liveness(kind), Shown(Liveness(word)))] == keys


def test_the_desk_tells_what_comes_goes_and_is_seen():
    said = []
    desk = AlarmDesk(lambda text, level, *, kind, **more: said.append((text, level, more["change"])))
    wrong = source_conditions(Liveness.LIVE, Shown(Liveness.FROZEN, "same"))
    desk.look(0, wrong)
    desk.look(1, wrong)
    assert desk.acknowledge(2, None, "A")
    assert not desk.acknowledge(3, None, "A")
    assert not desk.acknowledge(3, "other", "A")
    desk.look(4, [])
    assert said == [
        ("alarm: FROZEN: same", "WARN", "raised"),
        ("alarm acknowledged by A: FROZEN: same", "INFO", "acknowledged"),
        ("alarm over: FROZEN: same", "INFO", "cleared"),
    ]
    assert not desk.list


def test_a_source_without_a_picture_says_nothing_of_alignment():
    station = FakeStation(aligner=aligner_at(0.6, 0.0))
    station.show(*made_up())
    station.operations.choose("0,0", 1, "")
    for _ in range(30):
        station.show(*made_up())
        state = station.teller.look()
    assert "cannot-judge" in {a["key"] for a in state["alarms"]}
    station.watched.shown = SourceStatus("FROZEN", "same")
    active = {a["key"] for a in station.teller.look()["alarms"] if a["active"]}
    assert active == {"source frozen"}


def test_a_recording_that_broke_off_is_an_alarm():
    station = FakeStation()
    station.recorder.state = replace(station.recorder.state, failure="recording stopped: no room")
    [alarm] = station.teller.look()["alarms"]
    assert alarm["reason"] == "recording stopped: no room"


def watch(shown, *, failed=False, said=None):
    desk = AlarmDesk(lambda text, *_, **__: None if said is None else said.append(text))
    return AlarmWatch(
        desk, Liveness.LIVE, lambda: shown[-1], lambda: None, None, lambda: None, SystemClock(), lambda: failed
    )


def until(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_alarms_are_looked_for_while_the_block_lasts_and_logged(caplog):
    caplog.set_level(logging.INFO, "service")
    shown, said = [Shown(Liveness.LIVE)], []
    with watch(shown, said=said) as alarms:
        shown.append(Shown(Liveness.FROZEN, "same"))
        until(lambda: alarms.desk.unseen)
        shown.append(Shown(Liveness.LIVE))
        until(lambda: len(said) == 2)
        assert [alarm.condition.key for alarm in alarms.desk.unseen] == ["source frozen"]  # nobody has seen it yet
    shown.append(Shown(Liveness.ENDED))
    assert said == ["alarm: FROZEN: same", "alarm over: FROZEN: same"]
    raised = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert raised == ["alarm: FROZEN: same; stop moving: the picture is not live; check the grabber"]


def test_a_stop_is_no_alarm_and_a_failure_is():
    for failed, keys in ((False, []), (True, ["source ended"])):
        with watch([Shown(Liveness.ENDED, "the source failed")], failed=failed) as alarms:
            alarms._over.set()
        assert [a.condition.key for a in alarms.desk.unseen] == keys


def test_a_look_that_fails_is_logged_and_the_next_one_comes(caplog):
    shown = []
    with watch(shown) as alarms:
        until(lambda: "the look for alarms failed" in caplog.text)
        shown.append(Shown(Liveness.STALE))
        until(lambda: alarms.desk.unseen)
