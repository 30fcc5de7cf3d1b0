"""Measuring a recorded session again: its own configuration, its frames, the code that measures live."""

from __future__ import annotations

import argparse
import math
import time
from typing import TYPE_CHECKING

from drivers.session_replay import SessionGrabber
from service.acquisition.measuring import FrameMeasurer
from service.cli.inputs import fitting_camera
from service.cli.interpreting import interpreter_for
from service.config.station import read_station
from service.vision.process import Measurer

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from drivers.frame import Field, Frame
    from service.alignment.interpreter import Interpreter
    from service.config.generators import SteamGenerator
    from service.results import FrameResult
    from service.sinks.session.reader import RecordedSession
    from service.vision.camera import Camera

__all__ = ["measured_again", "measured_as_recorded", "recorded_said"]


def recorded_said(args: argparse.Namespace, session: RecordedSession) -> None:
    """Fill in what the options leave open: all that a result depends on is then as it was recorded."""
    if args.config is None:
        args.config = session.station
        args.anchor = args.anchor or list(session.about.anchors)
        args.target = args.target or session.about.target or None


def measured_as_recorded(session: RecordedSession) -> Iterator[tuple[Frame, Sequence[FrameResult]]]:
    """Measure a session again, as it was measured; raises ConfigError where its configuration was damaged."""
    s = read_station(session.station)
    said = argparse.Namespace(anchor=list(session.about.anchors), target=session.about.target or None)
    interpreter = interpreter_for(said, s.identity, s.alignment, s.generator)
    return measured_again(session, s.generator, s.camera, s.measuring.field_order.field, interpreter)


def measured_again(
    session: RecordedSession,
    generator: SteamGenerator,
    camera: Camera | None,
    field: Field | None,
    interpreter: Interpreter | None,
) -> Iterator[tuple[Frame, Sequence[FrameResult]]]:
    """Measure the frames that were measured, in their order, at full speed."""
    with SessionGrabber(session.folder, speed=math.inf, name=str(session.folder)) as grabber:
        known = fitting_camera(camera, grabber.format, grabber.name, quiet=True)
        vision = Measurer(known, generator.lattice, time.perf_counter_ns)
        measurer = FrameMeasurer(vision, field, grabber.clock, interpreter)
        grabber.start()
        for frame in grabber:
            yield frame, measurer.answer(frame)[0]
