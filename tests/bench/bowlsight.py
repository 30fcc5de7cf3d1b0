"""Bowlsight as the bench calls it: the service's own measurer, tracked or from nothing."""

import time

import numpy as np

from service.vision.measurement import Measurement, Origin
from service.vision.process import Measurer
from tests.bench.pictures import Take


class Tracked:
    """Measures one picture after the other."""

    def __init__(self, take: Take, field: str = "progressive") -> None:
        self._take, self._field, self._count = take, field, 0
        self._measurer = Measurer(take.camera, take.lattice, time.perf_counter_ns)

    def __call__(self, number: int) -> Measurement:
        return self.measure(self._take.pictures[number])

    def measure(self, pixels: np.ndarray) -> Measurement:
        """The next picture's answer."""
        self._count += 1
        return self._measurer.measure(pixels, self._count * self._take.period_ns, self._field)[0]


class Acquired(Tracked):
    """Measures each picture as if there had been none before."""

    def measure(self, pixels: np.ndarray) -> Measurement:
        self._measurer.reset()
        return super().measure(pixels)


def measured_px(m: Measurement) -> np.ndarray:
    """Centres of the tubes measured, (n, 2)."""
    return m.tubes.center_px[m.tubes.origin == Origin.MEASURED]
