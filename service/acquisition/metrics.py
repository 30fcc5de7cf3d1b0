"""The service's health as Prometheus asks for it, on loopback."""

from __future__ import annotations

import socketserver
import threading
from typing import TYPE_CHECKING, Final, Self
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from prometheus_client import CollectorRegistry, make_wsgi_app
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    InfoMetricFamily,
    StateSetMetricFamily,
)
from prometheus_client.registry import Collector

from drivers.errors import ConfigError
from service.acquisition.health import AcquisitionState
from service.acquisition.liveness import Liveness

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from types import TracebackType

    from prometheus_client import Metric

    from service.acquisition.health import Health, Percentiles

__all__ = ["HealthCollector", "MetricsServer"]

LOOPBACK: Final = "127.0.0.1"
POLL_S: Final = 0.05
REQUEST_TIMEOUT_S: Final = 10.0
P: Final = "bowlsight_"
FATES: Final = ("processed", "superseded", "too_old", "corrupt", "failed")


class HealthCollector(Collector):
    """Turns a health snapshot, taken at each question, into metrics.

    Parameters
    ----------
    health
        Takes it.
    source
        Name of the source.
    """

    def __init__(self, health: Callable[[], Health], source: str) -> None:
        self._health, self._source = health, source

    def collect(self) -> Iterator[Metric]:
        """Give every metric, of one moment."""
        h = self._health()
        yield InfoMetricFamily(P + "source", "What is watched.", {"name": self._source})
        yield _states(P + "picture", "What the picture is worth.", [str(s) for s in Liveness], str(h.shown.liveness))
        yield _states(P + "acquisition", "Where it stands.", [str(s) for s in AcquisitionState], str(h.state))
        yield from _frames(h)
        yield from _times(h)
        yield from _sinks(h)
        yield from _process(h)


def _states(name: str, text: str, known: Iterable[str], now: str) -> Metric:
    return StateSetMetricFamily(name, text, {state: state == now for state in known})


def _frames(h: Health) -> Iterator[Metric]:
    a = h.account
    yield _counter("frames_numbered", "Numbers the source counted through.", a.span)
    yield _counter("frames_delivered", "Frames the driver handed over.", a.delivered)
    yield _counter("frames_lost", "Numbers that never reached the service.", a.lost)
    yield _counter("frames_overflowed", "Frames that lossless queues had no room for.", h.overflowed)
    yield _labelled("frames", "What became of frames.", "fate", {fate: getattr(a, fate) for fate in FATES})
    yield _gauge("frames_in_flight", "Frames waiting or being measured.", a.in_flight)
    yield _gauge("frames_waiting", "Frames waiting to be measured.", h.waiting)
    yield _gauge("frames_unaccounted", "Frames that the ledger misses: 0, or there is a mistake.", a.unaccounted)
    yield _labelled("pictures", "Pictures answered, by lock.", "lock", h.locks)
    yield _gauge("generation", "Grows whenever the source begins anew.", h.generation)
    yield _counter("recoveries", "How often the source was got back.", h.recoveries)


def _times(h: Health) -> Iterator[Metric]:
    yield _gauge("capture_rate_hertz", "Frames arriving a second.", h.capture_fps)
    yield _gauge("result_rate_hertz", "Frames answered a second.", h.result_fps)
    if h.silent_s is not None:
        yield _gauge("silent_seconds", "Since the last frame.", h.silent_s)
    yield from _percentiles("interval", "Between frames arriving.", h.interval_ms)
    yield from _percentiles("age", "Of frames when their measuring begins.", h.age_ms)
    yield from _percentiles("latency", "From a frame's arrival until its results are handed on.", h.latency_ms)


def _percentiles(name: str, text: str, p: Percentiles) -> Iterator[Metric]:
    if p.p50 is None or p.p99 is None:
        return
    family = GaugeMetricFamily(f"{P}{name}_seconds", f"{text} Of the last 512.", labels=["quantile"])
    for quantile, value_ms in (("0.5", p.p50), ("0.99", p.p99)):
        family.add_metric([quantile], value_ms / 1e3)
    yield family


def _sinks(h: Health) -> Iterator[Metric]:
    for what in ("accepted", "dropped", "failed"):
        counts = {name: getattr(stats, what) for name, stats in h.sinks.items()}
        yield _labelled(f"sink_frames_{what}", f"Frames {what} by a sink.", "sink", counts)
    depth = GaugeMetricFamily(P + "sink_depth", "Frames waiting in a sink's queue.", labels=["sink"])
    for name, stats in h.sinks.items():
        depth.add_metric([name], stats.depth)
    yield depth


def _process(h: Health) -> Iterator[Metric]:
    r = h.resources
    for name, text, value in (
        ("resident_memory_bytes", "Memory resident.", r.rss_bytes),
        ("open_fds", "Files open.", r.fds),
        ("threads", "Threads of any library.", r.threads),
    ):
        if value is not None:
            yield _gauge(name, text, value)


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(P + name, text, value=value)


def _counter(name: str, text: str, value: float) -> Metric:
    return CounterMetricFamily(P + name, text, value=value)


def _labelled(name: str, text: str, label: str, values: Mapping[str, float]) -> Metric:
    family = CounterMetricFamily(P + name, text, labels=[label])
    for key, value in values.items():
        family.add_metric([key], value)
    return family


class _Server(socketserver.ThreadingMixIn, WSGIServer):
    daemon_threads = True


class _Handler(WSGIRequestHandler):
    timeout = REQUEST_TIMEOUT_S

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base class's name
        """Log nothing of requests: they come every few seconds."""


class MetricsServer:
    """Answers http://127.0.0.1:PORT/metrics from threads of its own; on loopback, for nobody is asked for a password.

    Parameters
    ----------
    port
        0: a free one.
    collector
        What is answered.
    """

    def __init__(self, port: int, collector: HealthCollector) -> None:
        registry = CollectorRegistry(auto_describe=False)
        registry.register(collector)
        try:
            self._server = make_server(LOOPBACK, port, make_wsgi_app(registry), _Server, _Handler)
        except OSError as error:
            raise ConfigError(
                f"metrics port = {port}: cannot be listened on: {error.strerror}; name another port"
            ) from None
        self.url = f"http://{LOOPBACK}:{self._server.server_port}/metrics"
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(POLL_S,), name="bowlsight-metrics", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop answering. May be repeated."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
