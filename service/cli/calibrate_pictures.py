"""`bowlsight calibrate PATH...`: measure pictures of the sheet, keep those that tell most, solve, write."""

from __future__ import annotations

import contextlib
import json
import math
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Never

import numpy as np
from tqdm import tqdm

from drivers.errors import CalibrationError, ConfigError
from drivers.replay import ReplayGrabber
from drivers.session_replay import SessionGrabber, is_session
from service.acquisition.measuring import FrameMeasurer
from service.cli.calibrating import focal_length_of, range_of
from service.cli.inputs import field_order, fitting_camera
from service.cli.live import prepare_kernels
from service.cli.terminal import say
from service.config.calibration import write_calibration
from service.config.cameras import read_camera, write_atomically
from service.config.generators import load_generator
from service.vision.calibration_report import calibration_dict, calibration_lines
from service.vision.collecting import Collector
from service.vision.errors import DegenerateError
from service.vision.process import Measurer
from service.vision.selfcalibration import LEAST_TUBES

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.selfcalibration import Calibration

__all__ = ["run_pictures"]

MOST_TURNS = 4
"""How often the pictures are measured at the most, and to what part of its sigma f must then stand still."""
STILL = 0.5
AT_REST = 0.05
"""Edge widths that a pose may lie from where rims were looked for: a shift told short passes for another focal length,
and time does not matter."""


def run_pictures(args: argparse.Namespace) -> int:
    """Measure, solve, write; returns the exit status."""
    _check(args)
    lattice = load_generator(args.generator).lattice
    grabbers = [_grabber(path) for path in args.paths]
    camera, total = _camera(args, grabbers)
    prepare_kernels()
    collector, calibration = _calibrated(args, grabbers, camera, lattice, total)
    for reason, count in collector.left_out.items():
        say(f"{count} picture{'s' * (count != 1)} left out: {reason}")
    if calibration is None:
        raise CalibrationError(f"{args.paths[0]}: no picture shows {LEAST_TUBES} tubes; nothing is written")
    utc = datetime.now(UTC).isoformat(timespec="seconds")
    write_calibration(args.out, calibration, utc)
    if args.json is not None:
        text = json.dumps(calibration_dict(calibration, lattice), indent=2, allow_nan=False)
        print(text) if args.json == "-" else write_atomically(Path(args.json), text + "\n")
    if args.json != "-":
        print(f"{len(collector.kept)} of {collector.seen} pictures kept")
        print(*calibration_lines(calibration, lattice), f"{args.out}: written", sep="\n")
    return 0


def _calibrated(
    args: argparse.Namespace, grabbers: Sequence[ReplayGrabber], camera: Camera, lattice: Lattice, total: int | None
) -> tuple[Collector, Calibration | None]:
    """Measure and solve; and again with the camera that was found, until the focal length stands still.

    Rims are measured along their projection, and a camera that is off shifts them a little: a first answer is wrong by
    several of its sigmas, a second one by a third of that.
    """
    known_range, measured_with = range_of(args), camera
    tqdm.monitor_interval = 0  # no thread of its own
    for turn in range(MOST_TURNS):
        collector, calibration = Collector(camera, lattice), None
        with tqdm(total=total, desc=f"pass {turn + 1}", unit="frame", disable=None, leave=False) as bar:
            _collect(grabbers, collector, measured_with, args.field_order, bar)
        with contextlib.suppress(DegenerateError):
            calibration = collector.solve(known_range)
        if calibration is None or _stands_still(measured_with, calibration.camera):
            break
        measured_with = calibration.camera
    return collector, calibration


def _stands_still(before: Camera, after: Camera) -> bool:
    """Whether pictures measured with one camera tell of the same."""
    if before.focal_length_mm is None or after.focal_length_mm is None:
        return False
    return abs(after.focal_length_mm - before.focal_length_mm) <= STILL * after.sigma("focal_length_mm")


def _check(args: argparse.Namespace) -> None:
    if not args.paths:
        raise ConfigError("calibrate: give PATH..., pictures of the tubesheet from several tilts, or --points FILE")
    for option, value in (("--generator NAME", args.generator), ("--out FILE", args.out)):
        if value is None:
            raise ConfigError(f"calibrate: give {option} with {args.paths[0]}")
    written = [args.out, *([] if args.json in (None, "-") else [Path(args.json)])]
    read = {p.resolve() for p in args.paths}
    for path in written:
        if path.resolve() in read or (path is not args.out and path.resolve() == args.out.resolve()):
            raise ConfigError(f"{path}: is a source, or another output, already; choose another name")
        if path.is_dir() or not path.resolve().parent.is_dir():
            raise ConfigError(f"{path}: cannot be written there; give a file in a folder that exists")


def _grabber(path: Path) -> ReplayGrabber:
    return SessionGrabber(path, speed=math.inf) if is_session(path) else ReplayGrabber(path, speed=math.inf)


def _camera(args: argparse.Namespace, grabbers: Sequence[ReplayGrabber]) -> tuple[Camera, int | None]:
    """What is known of the camera, and how many pictures there are, as far as the sources tell."""
    given = read_camera(args.camera) if args.camera else None
    camera, counts = given, []
    for grabber in grabbers:
        with grabber:
            camera = fitting_camera(camera, grabber.format, grabber.name)
            counts.append(grabber.frame_count)
    assert camera is not None
    if given is None:
        camera = replace(camera, sx=None)
    focal_length_mm = focal_length_of(args)
    if focal_length_mm is not None:
        camera = camera.with_focal_length(*focal_length_mm)
    if camera.complete and not np.diag(camera.covariance).any():
        raise ConfigError(
            f"{args.camera}: gives all values without a sigma, so that none is left to be found; leave some out"
        )
    known = [c for c in counts if c is not None]
    return camera, sum(known) if len(known) == len(counts) else None


def _collect(
    grabbers: Sequence[ReplayGrabber], collector: Collector, camera: Camera, order: str | None, bar: tqdm[Never]
) -> None:
    """Measure all sources with a camera, and have the collector look at the results."""
    for grabber in grabbers:
        collector.begin()
        with grabber:
            vision = Measurer(camera, collector.lattice, time.perf_counter_ns, at_rest=AT_REST)
            measurer = FrameMeasurer(vision, field_order(order).field, grabber.clock)
            grabber.start()
            for frame in grabber:
                for result in measurer.answer(frame)[0]:
                    collector.take(result.measurement)
                bar.update()
                bar.set_postfix_str(f"{len(collector.kept)} kept", refresh=False)
