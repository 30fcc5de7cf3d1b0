"""The live service for minutes or hours: its memory must not grow, nor its files and threads.

    python -m tests.bench.soak [MINUTES] [--viewer]

A simulated 640x480 device at 30 frames a second that is unplugged every ten seconds, measured by the service's own
vision, with a sink behind its queue, asked for its metrics; with --viewer also shown in rerun's viewer, whose own store
(bounded, but emptied in leaps of tens of MB) then dominates what is sampled.

After a warm-up (a third of the time, 5 minutes at most) memory is sampled every second: that which is the process's
own, for what is mapped from files comes and goes with the machine's other work. Fails where the slope is above 1 MB/h
by more than it is uncertain, files or threads are more at the end than after the warm-up, or a frame is unaccounted
for. A quarter of a MB in all may still be warming up: three minutes show leaks of 8 MB/h and more, an hour those of 1.
"""

import gc
import logging
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np

from drivers.faults import Fault, FaultKind
from drivers.scene import GENERATORS, NOMINAL
from drivers.simulated import SimulatedGrabber
from drivers.simulation import default_scene
from service.acquisition.live import LiveService
from service.acquisition.liveness import Liveness
from service.acquisition.metrics import HealthCollector, MetricsServer
from service.acquisition.recovery import Supervision
from service.acquisition.resources import resources
from service.cli.simulate import camera_of
from service.config.generators import load_generator
from service.config.supervision import SupervisionSettings
from service.sinks.base import SourceState
from service.sinks.queued import QueuedSink
from service.sinks.viewer import ViewerSink
from service.sinks.viewer_drawing import Watch
from service.vision.process import Measurer, warm_up

RATE_HZ = 30.0
UNPLUGGED_EVERY_S, UNPLUGGED_S = 10, 0.6
WARM_UP_SHARE, WARM_UP_MOST_S = 1 / 3, 300.0
LIMIT_MB_PER_H, SETTLING_MB = 1.0, 0.25
MOST_PAIRED = 600


def slope_mb_per_h(times_s: np.ndarray, rss_bytes: np.ndarray) -> tuple[float, float]:
    """Theil's slope of memory, and one sigma of it; neighbouring samples count as one by their correlation.

    The median of the slopes between any two samples: a heap grows by one leap now and then, a leak all the time.
    """
    t, y = times_s - times_s.mean(), rss_bytes / 1e6
    some = slice(None, None, max(1, len(t) // MOST_PAIRED))
    one, other = np.triu_indices(len(t[some]), 1)
    slope = float(np.median((y[some][other] - y[some][one]) / (t[some][other] - t[some][one])))
    left = y - slope * t
    left -= np.median(left)
    rho = float(np.corrcoef(left[:-1], left[1:])[0, 1]) if np.ptp(left) > 0 else 0.0
    each = 1.4826 * np.median(np.abs(left)) * np.sqrt((1 + max(0.0, rho)) / (1 - min(0.99, max(0.0, rho))))
    return 3600 * slope, 3600 * float(each / np.sqrt(t @ t))


def device(minutes: float) -> SimulatedGrabber:
    rng = np.random.default_rng(1)
    scene = default_scene(GENERATORS["model-f"], rng, rate_hz=RATE_HZ, frames=47, look=NOMINAL)
    apart = int(UNPLUGGED_EVERY_S * RATE_HZ)
    count = int(minutes * 60 * RATE_HZ / apart) + 1
    faults = [Fault(FaultKind.DISCONNECT, apart * (i + 1), seconds=UNPLUGGED_S) for i in range(count)]
    return SimulatedGrabber(scene, loop_frames=48, faults=faults, rng=rng)


class Drawn(QueuedSink):
    """A sink like any other, that puts every result into words and forgets them."""

    def __init__(self):
        super().__init__("words", 8)

    def _do_start(self):
        pass

    def _do_consume(self, frame, results):
        return all(result.to_json() for result in results)

    def _do_finish(self, timeout_s):
        pass


def own_bytes() -> int:
    """Memory resident that is mapped from no file."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("RssAnon:"))


def sampled(service: LiveService, sinks: list[QueuedSink], url: str, seconds: float) -> np.ndarray:
    """What the process holds, every second: rows of seconds, bytes, files, threads.

    Room for all rows is there from the start: it would be what grows.
    """
    samples, count, began_s = np.ones((int(seconds) + 1, 4)), 0, time.monotonic()
    while (now_s := time.monotonic() - began_s) < seconds:
        assert not service.wait(1.0), service.failure
        shown = service.health().shown
        for sink in sinks:
            sink.state(SourceState(str(shown.liveness), shown.reason, shown.good, f"{now_s:.0f} s"))
        with urllib.request.urlopen(url, timeout=10) as answer:
            answer.read()
        if count % 10 == 0:
            gc.collect()
        held = resources()
        samples[count] = now_s, own_bytes(), held.fds, held.threads
        count += 1
    return samples[:count]


def main(minutes: float, *, shown: bool) -> int:
    logging.getLogger("service").setLevel(logging.ERROR)
    generator, grabber = load_generator("model-f"), device(minutes)
    warm_up(time.perf_counter_ns)
    sinks = [Drawn()]
    if shown:
        sinks.append(ViewerSink(Watch(generator.lattice, "soak"), memory_limit="16MiB"))
    service = LiveService(
        grabber,
        lambda _: Measurer(camera_of(grabber.scene.optics), generator.lattice, time.perf_counter_ns),
        sinks,
        kind=Liveness.SIMULATED,
        supervision=Supervision(SupervisionSettings()),
        tell=sinks[-1].event,
        oldest_s=1.0,
    )
    with service:
        service.start()
        with MetricsServer(0, HealthCollector(service.health, "soak")) as metrics:
            samples = sampled(service, sinks, metrics.url, 60 * minutes)
        service.stop()
        health = service.health()
    warm_s = min(WARM_UP_SHARE * 60 * minutes, WARM_UP_MOST_S)
    return told(samples, warm_s, health)


def told(samples, warm_s, health) -> int:
    """Print what came of it; 1 where it is not as it must be."""
    kept = samples[samples[:, 0] >= warm_s]
    slope, sigma = slope_mb_per_h(kept[:, 0], kept[:, 1])
    third = len(kept) // 3
    ends = [part[:, 2:].max(axis=0).astype(int) for part in (kept[:third], kept[-third:])]
    account = health.account
    print(f"{samples[-1, 0] / 60:.1f} minutes, the first {warm_s / 60:.1f} of them to warm up")
    first_mb, last_mb = kept[[0, -1], 1] / 1e6
    print(f"  memory {first_mb:.1f} MB, then {last_mb:.1f} MB: {slope:+.2f} ± {sigma:.2f} MB/h")
    print(f"  files and threads, at most: {ends[0].tolist()} in the first third after, {ends[1].tolist()} in the last")
    print(f"  {health.recoveries} recoveries; {account.lines()[1]}")
    least_mb_per_h = slope - 2 * sigma
    grown = least_mb_per_h > LIMIT_MB_PER_H and least_mb_per_h * (kept[-1, 0] - kept[0, 0]) / 3600 > SETTLING_MB
    return int(grown or bool(np.any(ends[1] > ends[0])) or not account.balanced())


if __name__ == "__main__":
    given = [argument for argument in sys.argv[1:] if argument != "--viewer"]
    sys.exit(main(float(given[0]) if given else 3.0, shown="--viewer" in sys.argv))
