"""The live service on two cores: simulated grabber at 1920x1080 and 60 frames/s, a viewer attached."""

import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.frame import Frame
from drivers.simulated import SimulatedGrabber
from service.acquisition.live import LiveService
from service.results import FrameResult
from service.sinks.base import SinkStats
from service.sinks.ports import free_port
from service.sinks.viewer import ViewerSink
from service.sinks.viewer_drawing import Watch
from service.vision.process import Measurer
from tests.bench.pictures import scene_of
from tests.bench.tables import table
from tests.fakes.rrd import Client
from tests.scenes.rendered import camera_of, lattice_of

HERE = "127.0.0.1"
RATE_HZ = 60.0
OLDEST_S = 0.5
SETTLE_S = 2.0


class Latencies:
    """A sink that notes when each frame's result was there, s and ms after its exposure."""

    name = "latencies"

    def __init__(self) -> None:
        self.at_s: list[float] = []
        self.ms: list[float] = []
        self.first_ms: float | None = None

    def start(self) -> None:
        pass

    def accept(self, frame: Frame, results: Sequence[FrameResult]) -> None:
        now_ns = time.monotonic_ns()
        self.at_s.append(now_ns / 1e9)
        self.ms.append((now_ns - frame.timestamp_ns) / 1e6)

    def close(self, timeout_s: float) -> None:
        pass

    def stats(self) -> SinkStats:
        return SinkStats(accepted=len(self.ms))


def service(*, quick: bool) -> str:
    """Run it and give the table."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[:2])  # the viewer's process inherits it
    try:
        rows = [_run(viewer, quick=quick) for viewer in ((True,) if quick else (False, True))]
    finally:
        os.sched_setaffinity(0, before)
    heads = ("", "frames", "lost", "not measured", "median ms", "p99 ms", "max ms", "locked %", "shown a second")
    return table(heads, rows)


def _run(with_viewer: bool, *, quick: bool) -> list[object]:
    size, tubes, seconds = ((640, 480), 100, 1.5) if quick else ((1920, 1080), 350, 30.0)
    loop_frames = 8 if quick else 48
    scene = scene_of(size, tubes, count=loop_frames, rate_hz=RATE_HZ)
    lattice = lattice_of(scene.sheet.lattice, scene.look)
    grabber = SimulatedGrabber(scene, loop_frames=loop_frames)
    grabber.open()  # renders its pictures once and for all: a slow machine takes longer than a device may
    grabber.close()
    latencies, viewer = Latencies(), ViewerSink(Watch(lattice), port=_port(29871), web_port=_port(29081))
    sinks = (latencies, viewer) if with_viewer else (latencies,)
    vision = Measurer(camera_of(scene.optics), lattice, time.perf_counter_ns)
    with (
        tempfile.TemporaryDirectory() as folder,
        LiveService(grabber, lambda _: vision, sinks, oldest_s=OLDEST_S) as live,
    ):
        live.open()
        client = Client(viewer.grpc_url, Path(folder) / "viewer.rrd", _port(29951)) if with_viewer else None
        try:
            if client is not None:
                time.sleep(SETTLE_S)  # for the viewer to be there
            live.begin()
            live.wait(seconds)
            health = live.health()
            shown = viewer.stats()
        finally:
            if client is not None:
                client.end()
    a, settled = health.account, np.array(latencies.at_s) > latencies.at_s[0] + 0.5
    ms = np.array(latencies.ms)[settled]
    locked = sum(n for lock, n in health.locks.items() if lock != "none") / max(1, sum(health.locks.values()))
    title = f"{size[0]}x{size[1]}, {RATE_HZ:.0f} frames/s" + (", viewer attached" if with_viewer else "")
    told = (shown.accepted - shown.dropped - shown.failed) / seconds if with_viewer else None
    return [
        title, a.delivered, a.lost, a.superseded + a.too_old + a.failed, *np.percentile(ms, [50, 99]).tolist(),
        float(ms.max()), 100 * locked, told,
    ]  # fmt: skip


def _port(base: int) -> int:
    return free_port(HERE, None, base, "port")
