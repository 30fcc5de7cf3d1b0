"""Collect pictures for a calibration while the service runs: as a sink, so behind its own queue and thread."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from service.config.calibration import write_calibration
from service.precedence import go_last
from service.sinks.queued import QueuedSink
from service.vision.advice import missing
from service.vision.calibration_report import brief
from service.vision.collecting import Collector
from service.vision.errors import DegenerateError
from service.vision.paper import assumed_camera

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from drivers.frame import Frame
    from service.results import FrameResult
    from service.vision.bundle import Range
    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.selfcalibration import Calibration

__all__ = ["CalibrationSink"]

CAPACITY = 4
FEWEST, MORE, PAUSE_S = 4, 1.2, 5.0
"""It is solved with so many pictures; again with so many times more, and not sooner."""
BETTER = 0.8
"""It is told again once the focal length is known to this part of the sigma last told, or another move is wanted."""


class CalibrationSink(QueuedSink):
    """Keeps the pictures that tell most of the camera, solves now and then, says how far it is.

    Parameters
    ----------
    camera
        What is known of it; None: as is assumed of one that nobody described.
    out
        Camera file to write whenever it is solved; None: it only says what it finds.
    tell
        Gets what is found, in words, with INFO or WARN, from the sink's thread. Must return at once.
    now_s, utc
        Monotonic time and the day's.
    known_range
        Distance from the sheet when it was seen first.
    focal_length_mm
        Told beforehand, with its sigma.
    """

    def __init__(
        self,
        camera: Camera | None,
        lattice: Lattice,
        out: Path | None,
        tell: Callable[[str, str], None],
        now_s: Callable[[], float] = time.monotonic,
        utc: Callable[[], datetime] = lambda: datetime.now(UTC),
        *,
        known_range: Range | None = None,
        focal_length_mm: tuple[float, float] | None = None,
    ) -> None:
        super().__init__("calibration", CAPACITY)
        self._camera, self._lattice, self._out, self._say = camera, lattice, out, tell
        self._now_s, self._utc = now_s, utc
        self._range, self._focal_length_mm = known_range, focal_length_mm
        self._collector: Collector | None = None
        self._generation: int | None = None
        self._solved_with = 0
        self._solved_s = self._took_s = 0.0
        self._told: tuple[float, str] | None = None
        self.calibration: Calibration | None = None
        """The last one; whole at any time, from any thread."""
        self.progress = "no picture yet"
        """How far it is, in one line."""

    def _do_start(self) -> None:
        if self._out is not None and (self._out.is_dir() or not self._out.resolve().parent.is_dir()):
            raise ConfigError(f"{self._out}: cannot be written there; give a file in a folder that exists")

    def _do_consume(self, frame: Frame, results: Sequence[FrameResult]) -> bool:
        del frame  # its pixels are not needed
        for result in results:
            collector = self._collector_for(result)
            if collector is not None:
                collector.take(result.measurement)
        if self._collector is not None and self._worth_solving(len(self._collector.kept)):
            self._solve(self._collector)
        return True

    def _do_finish(self, timeout_s: float) -> None:
        collector = self._collector
        if collector is not None and len(collector.kept) > self._solved_with and 2 * self._took_s < timeout_s:
            self._solve(collector)

    def _collector_for(self, result: FrameResult) -> Collector | None:
        """The collector, made with the first picture that tells the size of all."""
        pose = result.measurement.pose
        if self._collector is None:
            if pose is None:
                return None
            go_last()  # calibrating waits for everything else
            camera = self._camera or replace(assumed_camera(pose.camera.image_size_px), sx=None)
            if self._focal_length_mm is not None:
                camera = camera.with_focal_length(*self._focal_length_mm)
            self._collector = Collector(camera, self._lattice)
        if result.generation != self._generation:
            self._generation = result.generation
            self._collector.begin()
        return self._collector

    def _worth_solving(self, kept: int) -> bool:
        self.progress = self.progress if self.calibration else f"{kept} pictures kept"
        due = self._solved_with == 0 or self._now_s() - self._solved_s > PAUSE_S
        return due and kept >= max(FEWEST, MORE * self._solved_with)

    def _solve(self, collector: Collector) -> None:
        began_s = self._now_s()
        self._solved_with = len(collector.kept)
        try:
            calibration = collector.solve(self._range).first_answer()
        except DegenerateError:
            return
        self._solved_s = self._now_s()
        self._took_s = self._solved_s - began_s
        self.calibration, self.progress = calibration, brief(calibration, self._lattice)
        if self._out is not None:
            write_calibration(self._out, calibration, self._utc().isoformat(timespec="seconds"))
        self._report(calibration)

    def _report(self, calibration: Calibration) -> None:
        sigma, lacking = calibration.camera.sigma("focal_length_mm"), missing(calibration, self._lattice)
        if self._told is not None and self._told[1] == lacking.remedy and sigma > BETTER * self._told[0]:
            return
        self._told = sigma, lacking.remedy
        written = "" if self._out is None else f"; {self._out.name} is written"
        self._say(f"calibration: {self.progress}{written}", "INFO")
