"""`bowlsight demo`: the bundled bowl video through the live service, there and back until stopped."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.replay import ReplayGrabber
from service.acquisition.liveness import Liveness
from service.cli.live import LiveRun, watch
from service.config.cameras import read_camera
from service.config.generators import load_generator
from service.config.station import MeasuringSettings, ViewerSettings
from service.demo import DEMO_GENERATOR, demo_camera, demo_video

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Play and measure; returns the exit status."""
    generator = load_generator(DEMO_GENERATOR)
    return watch(
        LiveRun(
            kind=Liveness.REPLAY,
            grabber=ReplayGrabber(demo_video(), loop=True, name="demo"),
            generator=generator,
            camera=read_camera(demo_camera()),
            measuring=MeasuringSettings(),
            viewer=ViewerSettings(),
        ),
        args,
    )
