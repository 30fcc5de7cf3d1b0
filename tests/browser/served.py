"""A fake station behind the real server, with frames that come in real time until they are stopped."""

import threading
import time
from dataclasses import replace

import numpy as np

from drivers.grabber import SystemClock
from service.alignment.aligner import Aligner, AlignmentSettings
from service.alignment.geometry import GuideAxis, StationGeometry
from service.console.server import WebServer, bind
from tests.fakes.drawn import LATTICE, made_up
from tests.fakes.station import FakeStation

SIZE = (640, 480)
PERIOD_S = 0.04


def aligner_at(x_mm: float, y_mm: float) -> Aligner:
    """A guide that points at this place of the sheet of `made_up`, straight."""
    guide = GuideAxis(np.array([x_mm, y_mm, 375.0]), np.array([0.0, 0.0, 1.0]), 1e-6 * np.eye(6), at_mouth=True)
    geometry = StationGeometry(guide, 14.3, 15.4, None, 0.5, np.array([0.0, 0.0, 1.0]))
    return Aligner(AlignmentSettings(geometry, stale_after_s=2.0), LATTICE)


class Served:
    """Serves a station until the end of the block; frames come from a thread while `streams` is set."""

    def __init__(self, **station):
        self._listening = bind("127.0.0.1", None)
        self.port = self._listening.getsockname()[1]
        self.station = FakeStation(clock=SystemClock(), port=self.port, **station)
        self.server = WebServer(self.station.app, self._listening)
        self.url = f"http://127.0.0.1:{self.port}/"
        self.streams = threading.Event()
        self.streams.set()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._feed, name="frames", daemon=True)
        self.sequence = 0
        y, x = np.mgrid[: SIZE[1], : SIZE[0]]
        self._pixels = (90 + 60 * np.exp(-((x - 320) ** 2 + (y - 240) ** 2) / 4e4)).astype(np.uint8)

    def _feed(self) -> None:
        while not self._over.wait(PERIOD_S):
            if not self.streams.is_set():
                continue
            now_ns, self.sequence = time.monotonic_ns(), self.sequence + 1
            frame, result = made_up(self.sequence % 40, size=SIZE, pixels=self._pixels)
            frame = replace(frame, sequence=self.sequence, timestamp_ns=now_ns, received_ns=now_ns)
            measurement = replace(result.measurement, time_ns=now_ns)
            self.station.show(frame, replace(result, sequence=self.sequence, measurement=measurement))

    def __enter__(self):
        self.server.start()
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        self.server.close(10.0)
