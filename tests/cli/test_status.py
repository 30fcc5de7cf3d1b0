from dataclasses import replace

import pytest

from service.acquisition.health import AcquisitionState, Health, Percentiles
from service.acquisition.ledger import Account
from service.acquisition.liveness import Liveness, Shown
from service.acquisition.resources import Resources
from service.acquisition.worker import Answer
from service.alignment.alarms import Alarm, Condition
from service.cli.status import status_parts, summary_lines
from service.sinks.base import SinkStats
from service.vision.measurement import Lock
from tests.fakes.results import make_result
from tests.fakes.scripted import make_frame

HEALTH = Health(
    shown=Shown(Liveness.LIVE), state=AcquisitionState.RUNNING, generation=1, recoveries=0,
    capture_fps=25.0, result_fps=24.9, silent_s=0.02, interval_ms=Percentiles(40.0, 41.0),
    age_ms=Percentiles(0.2, 1.1), latency_ms=Percentiles(8.0, 12.5), measuring_s=None, waiting=0, overflowed=0,
    account=Account(span=103, delivered=100, lost=3, processed=98, superseded=2),
    locks={"full": 90, "none": 8}, sinks={"viewer": SinkStats(98, 4, 1, 2)}, resources=Resources(200 * 2**20, 40, 12),
)  # fmt: skip


def line(health=HEALTH, **result):
    return " | ".join(status_parts(health, Answer(make_frame(), (make_result(**result),), 8.4)))


def test_it_tells_every_figure_with_unit_and_sigma():
    assert line() == (
        "LIVE 25.0 fps | lock full | distance 1000.00 ±0.20 mm | tilt 5.00 ±0.05 deg | 3 tubes measured + 2 inferred"
        " | latency 8 ms | 5 dropped"
    )


def test_alarms_that_nobody_acknowledged_stand_before_the_figures():
    alarms = [Alarm(Condition(key, reason, "do it"), 0) for key, reason in (("a", "it is dark"), ("b", "so"))]
    answer = Answer(make_frame(), (make_result(),), 8.4)
    assert status_parts(HEALTH, answer, alarms)[:2] == ["LIVE 25.0 fps", "2 ALARMS: it is dark"]
    assert status_parts(HEALTH, answer, alarms[:1], brief=True)[:2] == ["LIVE 25.0 fps", "1 ALARM"]


def test_the_brief_form_fits_an_old_terminal_up_to_the_tubes():
    answer = Answer(make_frame(), (make_result(measured=312, inferred=26),), 8.4)
    brief = " · ".join(status_parts(HEALTH, answer, brief=True))
    assert brief == "LIVE 25.0 fps · full · 1000.00 ±0.20 mm · 5.00 ±0.05 deg · 312+26 tubes · 8 ms · 5 dropped"
    assert brief.index(" tubes") + len(" tubes") < 80


def test_a_doubt_and_a_reason_are_said():
    assert "lock partial (index in doubt)" in line(lock=Lock.PARTIAL)
    assert line(lock=Lock.NONE, reason="too dark") == "LIVE 25.0 fps | lock none: too dark | latency 8 ms | 5 dropped"


@pytest.mark.parametrize(
    ("shown", "state", "start"),
    [
        (Shown(Liveness.REPLAY), "running", "REPLAY 25.0 fps | lock full"),
        (Shown(Liveness.LIVE), "degraded", "LIVE 25.0 fps, BAD FRAME | lock full"),
        (
            Shown(Liveness.STALE, "no frame comes"),
            "stalled",
            "STALE: no frame comes (last frame 2.3 s ago) | last: lock",
        ),
        (Shown(Liveness.FROZEN, "the same"), "degraded", "FROZEN: the same | last: lock full"),
        (Shown(Liveness.RECONNECTING, "unplugged"), "lost", "RECONNECTING: unplugged (last frame 2.3 s ago) | last"),
        (Shown(Liveness.STARTING), "opening", "STARTING | last"),
    ],
)
def test_what_is_not_live_is_not_called_so(shown, state, start):
    assert line(replace(HEALTH, shown=shown, state=AcquisitionState(state), silent_s=2.34)).startswith(start)


def test_before_the_first_answer_there_is_only_the_state():
    assert status_parts(replace(HEALTH, account=Account()), None) == ["LIVE 25.0 fps", "0 dropped"]


def test_bad_and_missing_frames_are_not_kept_quiet():
    account = replace(HEALTH.account, corrupt=3, failed=1, processed=93)
    assert line(replace(HEALTH, account=account)).endswith("5 dropped | 4 bad | 1 UNACCOUNTED")


def test_the_summary_accounts_for_frames_locks_times_and_sinks():
    text = "\n".join(summary_lines(HEALTH, 4.02, "stopped"))
    assert text.startswith("stopped after 4.0 s")
    for words in (
        "103 numbered by the source = 100 delivered + 3 lost",
        "every frame accounted for",
        "90 full, 0 partial, 8 none of 98 pictures",
        "latency p50 8.0 ms, p99 12.5 ms",
        "viewer       98 frames, 4 dropped, 1 failed, 2 waiting",
    ):
        assert words in text
    assert "recorder" not in text
    assert "7 frames found no room" in "\n".join(summary_lines(replace(HEALTH, overflowed=7), 1, "ended"))
    assert "latency unknown" in "\n".join(summary_lines(replace(HEALTH, latency_ms=Percentiles()), 1, "ended"))
