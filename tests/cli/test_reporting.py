"""Health reaches sinks, log, Prometheus and the service manager, each when it matters."""

import logging
import urllib.request
from dataclasses import replace

import pytest

from service.acquisition.liveness import Liveness, Shown
from service.cli.reporting import Reporting
from service.config.supervision import HealthSettings
from tests.cli.test_status import HEALTH
from tests.fakes.clock import ManualClock

STALE = replace(HEALTH, shown=Shown(Liveness.STALE, "no frame comes"))


class Manager:
    def __init__(self):
        self.told = []

    def ready(self, status):
        self.told.append("ready")

    def status(self, status):
        self.told.append(status)

    def alive(self):
        self.told.append("alive")

    def stopping(self):
        self.told.append("stopping")


@pytest.fixture
def rig():
    class Rig:
        clock, manager, shown = ManualClock(), Manager(), []
        reporting = Reporting("fake", shown.append, HealthSettings(log_every_s=5), clock, manager)

    return Rig()


def test_sinks_are_shown_a_change_at_once_and_figures_every_second(rig):
    for health, later_s in [(HEALTH, 0), (HEALTH, 0.2), (STALE, 0.2), (STALE, 0.2), (STALE, 1.0)]:
        rig.clock.advance(later_s)
        rig.reporting.report(health)
    assert [s.word for s in rig.shown] == ["LIVE", "STALE", "STALE"]
    assert [s.good for s in rig.shown] == [True, False, False]
    assert rig.shown[1].reason == "no frame comes"
    assert "200 MiB, 40 files open, 12 threads" in rig.shown[0].figures
    assert "0 unaccounted" in rig.shown[0].figures


def test_a_line_of_the_log_says_how_it_does_now_and_then(rig, caplog):
    caplog.set_level(logging.INFO)
    for _ in range(11):
        rig.reporting.report(HEALTH)
        rig.clock.advance(1)
    assert len([m for m in caplog.messages if m.startswith("health: source LIVE, running, generation 1")]) == 2


def test_the_service_manager_hears_that_it_lives_while_frames_are_seen_to(rig):
    with rig.reporting.running(lambda: HEALTH):
        rig.reporting.report(HEALTH)
        rig.reporting.report(replace(STALE, measuring_s=1.0))
        rig.reporting.report(replace(STALE, measuring_s=3.0))
    assert rig.manager.told == [
        "ready", "fake: LIVE", "alive", "fake: STALE: no frame comes", "alive", "stopping",
    ]  # fmt: skip


def test_prometheus_may_ask_while_it_runs(capsys):
    settings = HealthSettings(metrics_port=0)
    reporting = Reporting("fake", lambda _: None, settings, ManualClock(), Manager())
    with reporting.running(lambda: HEALTH):
        url = capsys.readouterr().out.removeprefix("metrics: ").strip()
        with urllib.request.urlopen(url, timeout=10) as answer:
            assert b"bowlsight_frames_delivered_total 100.0" in answer.read()
