"""Measuring a recorded session again: its own configuration, its frames, the code that measures live."""

from __future__ import annotations

import argparse
import itertools
import logging
import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from drivers.errors import ConfigError
from drivers.session_index import Measured, Outside
from drivers.session_replay import SessionGrabber
from service.acquisition.measuring import FrameMeasurer
from service.alignment.interpreter import Interpreter
from service.cli.inputs import fitting_camera
from service.cli.interpreting import interpreter_for
from service.cli.recall import RecalledCheck, RecalledInterpreter
from service.config.station import read_station
from service.identity.namer import TubeNamer
from service.vision.process import Measurer

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from drivers.frame import Field, Frame
    from service.acquisition.cross_check import CrossCheck
    from service.config.generators import SteamGenerator
    from service.identity.counting import NamingRule
    from service.results import FrameResult
    from service.sinks.session.reader import RecordedSession
    from service.vision.camera import Camera

__all__ = [
    "measured_again",
    "measured_as_recorded",
    "recalled",
    "recalled_check",
    "recorded_said",
    "recorded_source",
    "remembered",
]


log = logging.getLogger(__name__)


def recorded_said(args: argparse.Namespace, session: RecordedSession) -> None:
    """Fill in what the options leave open: all that a result depends on is then as it was recorded."""
    if args.config is None:
        args.config = session.station
        args.anchor = args.anchor or list(session.about.anchors)
        args.target = args.target or session.about.target or None


def recorded_source(session: RecordedSession) -> str:
    """Name of the source that was recorded: it stands in results and in reasons."""
    return str(session.about.device.get("name", session.folder))


def remembered(session: RecordedSession) -> Mapping[str, Any] | None:
    """What measuring remembered when the recording began; None where that is nothing, or cannot be had."""
    try:
        return session.memory()
    except ConfigError as error:
        log.warning("%s; it is measured again without", error)
        return None


def measured_as_recorded(
    session: RecordedSession, memory: Mapping[str, Any] | None = None
) -> Iterator[tuple[Frame, Sequence[FrameResult]]]:
    """Measure a session again, as it was measured; raises ConfigError where its configuration was damaged."""
    s = read_station(session.station)
    said = argparse.Namespace(anchor=list(session.about.anchors), target=session.about.target or None)
    interpreter = interpreter_for(said, s.identity, s.alignment, s.generator)
    interpreter = recalled(session, interpreter, s.identity.rule(s.generator))
    return measured_again(
        session, s.generator, s.camera, s.measuring.field_order.field, interpreter, recalled_check(session), memory
    )


def recalled(session: RecordedSession, interpreter: Interpreter | None, rule: NamingRule) -> Interpreter:
    """An interpreter that is told what the operator chose while the session was recorded."""
    return RecalledInterpreter(session, interpreter or Interpreter(TubeNamer(rule), None))


def recalled_check(session: RecordedSession) -> CrossCheck | None:
    """What holds results against the instruments' readings that were recorded; None where there were none."""
    until_first = itertools.takewhile(lambda item: not isinstance(item, Measured), session.index())
    said = any(isinstance(item, Outside) and "readings" in item.values for item in until_first)
    return RecalledCheck(session) if said else None


def measured_again(
    session: RecordedSession,
    generator: SteamGenerator,
    camera: Camera | None,
    field: Field | None,
    interpreter: Interpreter | None,
    check: CrossCheck | None = None,
    memory: Mapping[str, Any] | None = None,
) -> Iterator[tuple[Frame, Sequence[FrameResult]]]:
    """Measure the frames that were measured, in their order, at full speed, from what was remembered on."""

    def measurer_for(size_px: tuple[int, int]) -> Measurer:
        shown = replace(grabber.format, width_px=size_px[0], height_px=size_px[1])
        known = fitting_camera(camera, shown, grabber.name, quiet=True)
        return Measurer(known, generator.lattice, time.perf_counter_ns)

    with SessionGrabber(session.folder, speed=math.inf, name=recorded_source(session)) as grabber:
        size_px = grabber.format.width_px, grabber.format.height_px
        measurer = FrameMeasurer(
            measurer_for(size_px), field, grabber.clock, interpreter, check, lambda frame: measurer_for(frame.size_px)
        )
        if memory is not None:
            measurer.recall(memory)
        grabber.start()
        for frame in grabber:
            yield frame, measurer.answer(frame)[0]
