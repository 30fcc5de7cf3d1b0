"""Whether recording keeps up: 1280x720 at 30 fps beside the full pipeline, frames lost and what it costs.

    python -m tests.bench.recording [--seconds 60] [--size 1280x720] [--no-viewer-file]

A tubesheet is drawn in another process's time before; frames come at 30 fps from memory, are measured by the live
service, newest first, and all of them are recorded: video, index, results, viewer's file.
"""

import argparse
import resource
import shutil
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from drivers.errors import DeviceTimeoutError
from drivers.frame import Field, Frame, PixelFormat
from drivers.grabber import FrameFormat, Grabber, SystemClock
from drivers.opening import open_grabber
from service.acquisition.live import LiveService
from service.cli.simulate import camera_of
from service.cli.viewing import viewer_watch
from service.config.generators import load_generator
from service.config.recording import RecordingSettings
from service.config.shipped import shipped_config
from service.config.station import read_station
from service.sinks.session.configuration import configuration
from service.sinks.session.plan import RecordingPlan
from service.sinks.session.reader import open_session
from service.sinks.session.recorder import FRAMES_CAPACITY, SessionRecorder
from service.sinks.viewer_file import ViewerFileSink
from service.vision.process import Measurer, warm_up

RATE_HZ = 30
PICTURES = 40


class FromMemory(Grabber):
    """Delivers pictures at a camera's pace, and loses them, as a camera does, where nobody reads."""

    def __init__(self, pictures):
        super().__init__("memory", clock=SystemClock())
        self.pictures = pictures
        self.format_ = FrameFormat(
            pictures[0].shape[1], pictures[0].shape[0], PixelFormat.MONO8, "memory", RATE_HZ, Field.PROGRESSIVE
        )

    format = property(lambda self: self.format_)

    def _do_open(self):
        pass

    def _do_close(self):
        pass

    def _do_start(self, mode):
        self.began_ns, self.number = time.monotonic_ns(), -1

    def _do_stop(self):
        pass

    def _do_read(self, timeout_s):
        period_ns = 10**9 // RATE_HZ
        number = max(self.number + 1, (time.monotonic_ns() - self.began_ns) // period_ns - 3)  # a ring of four
        due_ns = self.began_ns + number * period_ns
        wait_s = (due_ns - time.monotonic_ns()) / 1e9
        if wait_s > timeout_s:
            time.sleep(timeout_s)
            raise DeviceTimeoutError(self.name, "not due yet")
        time.sleep(max(0.0, wait_s))
        self.number = number
        there_and_back = number % (2 * len(self.pictures) - 2)
        at = min(there_and_back, 2 * len(self.pictures) - 2 - there_and_back)
        return Frame(
            self.pictures[at], number, due_ns, time.monotonic_ns(), Field.PROGRESSIVE, PixelFormat.MONO8, "memory",
            self.generation,
        )  # fmt: skip


def drawn(size):
    """Pictures of a moving camera, and the camera."""
    source = f"simulated:model-f?size={size}&loop_frames={PICTURES}&pitch_px=60"
    with open_grabber(source, speed=float("inf")) as grabber:
        grabber.start()
        return [grabber.read(60.0).pixels for _ in range(PICTURES)], camera_of(grabber.scene.optics)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--no-viewer-file", action="store_true")
    args = parser.parse_args()
    pictures, camera = drawn(args.size)
    generator = load_generator("model-f")
    warm_up(time.perf_counter_ns)
    root = Path(tempfile.mkdtemp(prefix="bowlsight-bench-"))
    settings = RecordingSettings(enabled=True, folder=root, csv=True)
    station = shipped_config("station.toml")
    rule = read_station(station).identity.rule(generator)
    plan = RecordingPlan(settings, "SIMULATED", generator.key, configuration(station, camera=camera), rule)
    viewer_for = None
    if not args.no_viewer_file:
        shown = viewer_watch(generator, "SIMULATED", "memory")
        viewer_for = lambda path: ViewerFileSink(path, shown())  # noqa: E731
    recorder = SessionRecorder(plan, SystemClock(), viewer_for=viewer_for)
    service = LiveService(
        FromMemory(pictures),
        lambda _: Measurer(camera, generator.lattice, time.perf_counter_ns),
        [recorder],
        prepare=recorder.note_device,
    )
    frames = service.subscribe(FRAMES_CAPACITY)
    recorder.listen(frames)
    deepest = 0
    with service:
        service.open()
        before = resource.getrusage(resource.RUSAGE_SELF)
        service.begin()
        end_s = time.monotonic() + args.seconds
        while time.monotonic() < end_s:
            time.sleep(0.02)
            deepest = max(deepest, frames.depth)
        used = resource.getrusage(resource.RUSAGE_SELF)
        health = service.health()
        service.stop(10.0)
    (folder,) = (p for p in root.iterdir() if p.is_dir())
    session = open_session(folder)
    counts = session.counts()
    account = replace(service.health().account)
    cpu = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    print(f"{args.size} at {RATE_HZ} fps for {args.seconds:g} s, viewer's file {'no' if viewer_for is None else 'yes'}")
    print(f"  delivered {account.delivered:,}, lost at the source {account.lost:,}, measured {account.processed:,}")
    print(f"  recorded {counts.frames:,}, lost by the recorder {counts.overflowed:,}, results {counts.measured:,}")
    print(f"  most frames waiting {deepest} of {FRAMES_CAPACITY}, results dropped {recorder.stats().dropped}")
    print(f"  latency p50 {health.latency_ms.p50:.1f} ms, p99 {health.latency_ms.p99:.1f} ms")
    print(f"  processor {cpu / args.seconds:.2f} of 2 cores, {session.size_bytes / args.seconds / 1e6:.1f} MB/s")
    shutil.rmtree(root)
    return int(account.lost > 0 or counts.overflowed > 0 or counts.frames != account.delivered)


if __name__ == "__main__":
    sys.exit(main())
