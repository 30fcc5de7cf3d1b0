"""What Prometheus is told is the health snapshot, in its own units."""

import socket
import urllib.request
from dataclasses import replace

import pytest
from prometheus_client.parser import text_string_to_metric_families

from drivers.errors import ConfigError
from service.acquisition.health import AcquisitionState, Health, Percentiles
from service.acquisition.ledger import Account
from service.acquisition.liveness import Liveness, Shown
from service.acquisition.metrics import HealthCollector, MetricsServer
from service.acquisition.resources import Resources
from service.sinks.base import SinkStats

HEALTH = Health(
    shown=Shown(Liveness.NO_SIGNAL, "the input has no signal"), state=AcquisitionState.DEGRADED, generation=3,
    recoveries=2, capture_fps=25.0, result_fps=24.5, silent_s=0.02, interval_ms=Percentiles(40.0, 44.0),
    age_ms=Percentiles(0.2, 1.1), latency_ms=Percentiles(8.0, 12.5), measuring_s=None, waiting=1, overflowed=4,
    account=Account(span=110, delivered=100, lost=10, processed=88, superseded=2, corrupt=9, in_flight=1),
    locks={"full": 80, "none": 8}, sinks={"viewer": SinkStats(98, 4, 1, 2)},
    resources=Resources(200 * 2**20, 40, 12),
)  # fmt: skip


def asked(health=HEALTH):
    server = MetricsServer(0, HealthCollector(lambda: health, "v4l2:usb-1-2"))
    with server, urllib.request.urlopen(server.url, timeout=10) as answer:
        text = answer.read().decode()
    samples = [s for family in text_string_to_metric_families(text) for s in family.samples]
    return {(s.name.removeprefix("bowlsight_"), *s.labels.values()): s.value for s in samples}


def test_every_figure_is_there_in_seconds_bytes_and_counts():
    values = asked()
    assert values["source_info", "v4l2:usb-1-2"] == 1
    assert values["picture", "NO SIGNAL"] == 1
    assert values["picture", "LIVE"] == 0
    assert values["acquisition", "degraded"] == 1
    assert values["frames_delivered_total",] == 100
    assert values["frames_lost_total",] == 10
    assert values["frames_total", "superseded"] == 2
    assert values["frames_total", "corrupt"] == 9
    assert values["frames_unaccounted",] == HEALTH.account.unaccounted == 0
    assert values["frames_in_flight",] == values["frames_waiting",] == 1
    assert values["recoveries_total",] == 2
    assert values["interval_seconds", "0.99"] == 0.044
    assert values["age_seconds", "0.5"] == 0.0002
    assert values["sink_frames_dropped_total", "viewer"] == 4
    assert values["sink_depth", "viewer"] == 2
    assert (values["resident_memory_bytes",], values["open_fds",], values["threads",]) == (200 * 2**20, 40, 12)


def test_what_is_not_known_is_left_out():
    values = asked(replace(HEALTH, silent_s=None, interval_ms=Percentiles(), resources=Resources()))
    names = {key[0] for key in values}
    assert not names & {"silent_seconds", "interval_seconds", "open_fds"}


def test_it_listens_on_loopback_only():
    with MetricsServer(0, HealthCollector(lambda: HEALTH, "fake")) as server:
        assert server.url.startswith("http://127.0.0.1:")
    with pytest.raises(OSError):
        urllib.request.urlopen(server.url, timeout=1)


def test_a_port_that_is_taken_is_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"metrics port = {port}: cannot be listened on: .*; name another port"):
            MetricsServer(port, HealthCollector(lambda: HEALTH, "fake"))
