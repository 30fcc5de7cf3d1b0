"""`bowlsight align-setup`: measure where the guide's axis is in the camera frame."""

from __future__ import annotations

import math
import time
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from tqdm import tqdm

from drivers.errors import ConfigError
from drivers.replay import ReplayGrabber
from service.acquisition.measuring import FrameMeasurer
from service.alignment.bands import Bands
from service.alignment.setup import solve_guide
from service.alignment.targets import parse_anchor
from service.cli.inputs import field_order, fitting_camera, station
from service.cli.live import prepare_kernels
from service.cli.outputs import check_outputs
from service.cli.standings import StandingOver
from service.cli.terminal import say
from service.config.alignment import IdentitySettings
from service.config.cameras import read_camera
from service.config.generators import load_generator
from service.config.guide import write_guide
from service.config.standings import read_standings
from service.identity.anchors import check_anchors
from service.identity.namer import TubeNamer
from service.vision.process import Measurer

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from service.alignment.setup import GuideSetup, Standing
    from service.config.generators import SteamGenerator
    from service.results import FrameResult
    from service.vision.camera import Camera
    from service.vision.lattice import Lattice

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Measure, solve, write; returns the exit status."""
    generator, camera = load_generator(args.generator), read_camera(args.camera)
    play_mm = _play_sigma_mm(args, generator)
    identity = IdentitySettings() if args.config is None else station(args.config).identity
    rule = identity.rule(generator)
    anchors = [parse_anchor(text, rule) for text in args.anchor]
    if anchors:
        check_anchors(rule, anchors)
    lines = None if args.table is None else read_standings(args.table, rule)
    if args.guide_px is None and (lines is None or any(str(line.target) == "nearest" for line in lines)):
        raise ConfigError(
            "align-setup: over which tube does the guide stand? give --guide-px X,Y, where in the picture it points"
            " (the nearest tube is taken), or --table FILE with frames and tubes"
        )
    check_outputs([args.out], [p for p in (args.path, args.camera, args.table, args.config) if p])
    over = StandingOver(generator.lattice, args.guide_px, lines, TubeNamer(rule, anchors), apart=args.path.is_dir())
    for result in _results(args, camera, generator.lattice):
        over.take(result)
    standings = over.standings(args.inserted_mm)
    setup = solve_guide(standings, play_mm, args.gap_mm, args.gap_sigma_mm)
    utc = datetime.now(UTC).isoformat(timespec="seconds")
    write_guide(args.out, setup, utc, str(args.path), camera.name)
    _report(args, standings, setup)
    return 0


def _play_sigma_mm(args: argparse.Namespace, generator: SteamGenerator) -> float:
    """One sigma per axis of what stands in the tube; anywhere within a radial clearance c, that is c / 2."""
    if args.play_sigma_mm is not None:
        return float(args.play_sigma_mm)
    if args.probe_diameter_mm is None:
        raise ConfigError(
            "align-setup: how closely is the guide held over its tube? give --probe-diameter-mm of what stands in the"
            " tubes, or --play-sigma-mm"
        )
    tube = 2 * generator.lattice.rim_radius_mm
    if args.probe_diameter_mm >= tube:
        raise ConfigError(
            f"--probe-diameter-mm {args.probe_diameter_mm:g}: does not go into a tube of {generator.label}, inner"
            f" diameter {tube:.2f} mm"
        )
    return float(tube - args.probe_diameter_mm) / 4


def _results(args: argparse.Namespace, camera: Camera, lattice: Lattice) -> Iterator[FrameResult]:
    """Measure every frame of the recording."""
    grabber = ReplayGrabber(args.path, speed=math.inf)
    with grabber:
        fitting_camera(camera, grabber.format, grabber.name)
        prepare_kernels()
        vision = Measurer(camera, lattice, time.perf_counter_ns)
        measurer = FrameMeasurer(vision, field_order(args.field_order).field, grabber.clock)
        tqdm.monitor_interval = 0  # no thread of its own
        grabber.start()
        for frame in tqdm(grabber, total=grabber.frame_count, unit="frame", disable=None, leave=False):
            yield from measurer.answer(frame)[0]


def _report(args: argparse.Namespace, standings: Sequence[Standing], setup: GuideSetup) -> None:
    for s, off_mm in zip(standings, setup.off_mm, strict=True):
        depth = f", {s.inserted_mm:g} mm inserted" if s.inserted_mm else ""
        print(f"  {s.label}: {len(s.views)} picture{'s' * (len(s.views) != 1)}{depth}; {off_mm:.2f} mm off the axis")
    x, y, z = setup.guide.direction
    print(f"axis ({x:.5f}, {y:.5f}, {z:.5f}) in the camera frame, known to {setup.turn_sigma_deg:.2f} deg")
    print(f"place on the sheet known to {setup.shift_sigma_mm:.2f} mm per axis")
    print(f"points {setup.residual_mm:.2f} mm off the axis, {setup.expected_mm:.2f} expected of play and tubes")
    bands = Bands()
    if setup.turn_sigma_deg > bands.tilt_sigma_deg:
        say(f"tilt will not be judged with it (above {bands.tilt_sigma_deg:g} deg); insert more, or add standings")
    if setup.shift_sigma_mm > bands.offset_sigma_mm:
        say(f"offset will not be judged with it (above {bands.offset_sigma_mm:g} mm); add standings over other tubes")
    print(f'{args.out}: written; for the station file: [alignment] guide = "{args.out.name}"')
    if not setup.guide.at_mouth:
        print("where the guide's mouth is was not measured (no --gap-mm): the station file must give gap_mm as well")
