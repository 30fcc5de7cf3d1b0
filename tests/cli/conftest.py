"""Pictures and videos without a tubesheet, and vision that answers without looking."""

from fractions import Fraction

import av
import cv2
import numpy as np
import pytest

from tests.fakes.results import make_measurement
from tests.fakes.scripted import FakeMeasurer

SIZE = (64, 48)


def noise(seed, size=SIZE):
    return np.random.default_rng(seed).integers(0, 255, (size[1], size[0]), dtype=np.uint8)


@pytest.fixture
def picture(tmp_path):
    def write(name="bowl.png", seed=0, size=SIZE):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        assert cv2.imwrite(str(path), noise(seed, size))
        return path

    return write


@pytest.fixture
def video(tmp_path):
    def write(name="bowl.mkv", frames=10, rate_hz=25):
        path = tmp_path / name
        with av.open(str(path), "w") as container:
            stream = container.add_stream("ffv1", rate=Fraction(rate_hz))
            stream.width, stream.height, stream.pix_fmt = *SIZE, "gray"
            for i in range(frames):
                frame = av.VideoFrame.from_ndarray(noise(i), "gray")
                frame.pts, frame.time_base = i, Fraction(1, rate_hz)
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
        return path

    return write


class FakeVision:
    """Stands in for vision; `made` holds the measurers with the cameras they were made for."""

    def __init__(self):
        self.made = []
        self.answer = lambda: [make_measurement()]

    def __call__(self, camera, lattice, tick):
        measurer = FakeMeasurer(self.answer)
        measurer.camera, measurer.lattice = camera, lattice
        self.made.append(measurer)
        return measurer


@pytest.fixture
def vision(monkeypatch):
    fake = FakeVision()
    for module in ("analyze", "live"):
        monkeypatch.setattr(f"service.cli.{module}.Measurer", fake)
    monkeypatch.setattr("service.cli.live.warm_up", lambda tick: None)
    return fake
