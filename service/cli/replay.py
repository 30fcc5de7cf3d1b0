"""`bowlsight replay`: a recording through the live service."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from drivers.replay import ReplayGrabber
from service.acquisition.liveness import Liveness
from service.cli.inputs import field_order, station
from service.cli.interpreting import interpreter_for
from service.cli.live import LiveRun, watch
from service.config.cameras import read_camera
from service.config.generators import load_generator

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Play and measure; returns the exit status."""
    s = station(args.config)
    generator = load_generator(args.generator) if args.generator else s.generator
    return watch(
        LiveRun(
            kind=Liveness.REPLAY,
            grabber=ReplayGrabber(args.path, speed=args.speed, loop=args.loop),
            generator=generator,
            camera=read_camera(args.camera) if args.camera else s.camera,
            measuring=replace(s.measuring, field_order=field_order(args.field_order, s.measuring.field_order)),
            viewer=s.viewer,
            every_frame=math.isinf(args.speed),
            interpreter=interpreter_for(args, s.identity, s.alignment, generator),
        ),
        args,
    )
