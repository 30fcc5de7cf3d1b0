"""Sessions for tests: a recorder fed by hand, without a service around it."""

import dataclasses
import time
from pathlib import Path

import numpy as np

from drivers.frame import Field, Frame, PixelFormat
from drivers.grabber import SystemClock
from service.acquisition.slot import FrameQueue
from service.config.generators import load_generator
from service.config.recording import RecordingSettings
from service.config.shipped import shipped_config
from service.config.station import read_station
from service.results import FrameResult
from service.sinks.session.configuration import configuration
from service.sinks.session.plan import RecordingPlan
from service.sinks.session.recorder import SessionRecorder
from tests.fakes.results import make_measurement

SIZE = (64, 48)


def picture(seed, size=SIZE, dtype=np.uint8):
    pixels = np.random.default_rng(seed).integers(0, 250, (size[1], size[0])).astype(dtype)
    pixels.flags.writeable = False
    return pixels


def frame(number, *, size=SIZE, dtype=np.uint8, generation=1, defect=None, source="cam", field=Field.PROGRESSIVE):
    return Frame(
        picture(number, size, dtype),
        number,
        number * 40_000_000,
        10**10 * generation + number * 40_000_000,
        field,
        PixelFormat.MONO8 if dtype == np.uint8 else PixelFormat.MONO16,
        source,
        generation,
        defect,
    )


def results(of, **measurement):
    return (FrameResult(of.source, of.sequence, of.timestamp_ns, of.generation, make_measurement(**measurement)),)


def plan(root: Path, *, csv=False, **settings):
    kept = RecordingSettings(enabled=True, folder=root, csv=csv, keep_free_mib=0.0, operator="A. Tester", **settings)
    generator = load_generator("system80")
    station = read_station(shipped_config("station.toml"))
    return RecordingPlan(
        kept,
        "SIMULATED",
        generator.key,
        configuration(shipped_config("station.toml")),
        station.identity.rule(generator),
    )


class Recording:
    """A recorder that runs; `feed` gives it frames and, of those that are measured, results."""

    def __init__(self, root: Path, *, capacity=400, enabled=True, **more):
        self.frames = FrameQueue(capacity)
        settings = {k: more.pop(k) for k in ("csv", "max_age_days", "max_size_gib") if k in more}
        self.plan = plan(root, **settings)
        self.plan = dataclasses.replace(self.plan, settings=dataclasses.replace(self.plan.settings, enabled=enabled))
        self.recorder = SessionRecorder(self.plan, SystemClock(), **more)
        self.recorder.listen(self.frames)

    def feed(self, *frames, measured=lambda _: True):
        for f in frames:
            assert self.frames.offer(f)
            if measured(f.sequence):
                self.recorder.accept(f, results(f))

    def __enter__(self):
        self.recorder.start()
        return self

    def __exit__(self, *_):
        self.frames.close()
        self.recorder.close(20.0)


def record(root: Path, frames, measured=lambda _: True, **more) -> Path:
    """Record these frames; gives the session's folder."""
    with Recording(root, **more) as recording:
        recording.feed(*frames, measured=measured)
    (folder,) = [p for p in root.iterdir() if p.is_dir()]
    return folder


def record_with_evidence(root: Path, count: int = 3, **more) -> Path:
    """Record thirty frames, verify some of them, set a mark; gives the session's folder."""
    with Recording(root, csv=True, **more) as recording:
        for k in range(30):
            recording.feed(frame(k))
            if k % 10 == 5 and k // 10 < count:
                wait_for(lambda k=k: recording.recorder.state.measured == k + 1)
                recording.recorder.verify("L83R87", "B. Tester", reason="the guide is bent" if k > 20 else None)
            if k == 20:
                recording.recorder.mark("acquisition begins")
    (folder,) = root.iterdir()
    return folder


def wait_for(condition, seconds: float = 60.0) -> None:
    """Wait for what must happen."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)
