"""`bowlsight replay`: a recording through the live service; a session's results held against those recorded."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from drivers.replay import ReplayGrabber
from drivers.session_replay import SessionGrabber, is_session
from service.acquisition.liveness import Liveness
from service.cli.again import measured_again, recalled, recalled_check, recorded_said, recorded_source, remembered
from service.cli.inputs import field_order, station, station_file
from service.cli.interpreting import interpreter_for
from service.cli.live import LiveRun, prepare_kernels, watch
from service.cli.recording import RecordingChoice
from service.config.cameras import read_camera
from service.config.generators import load_generator
from service.sinks.session.comparison import Comparison
from service.sinks.session.configuration import configuration
from service.sinks.session.reader import open_session
from service.sinks.session.surroundings import changed, machine, software

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from service.sinks.base import Sink
    from service.sinks.session.reader import RecordedSession

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Play and measure; returns the exit status."""
    if is_session(args.path):
        return _session(args, open_session(args.path))
    if args.check:
        raise ConfigError(f"{args.path}: is no recorded session, and only that can be checked; leave --check out")
    grabber = ReplayGrabber(args.path, speed=args.speed, loop=args.loop)
    return watch(_live(args, grabber, every_frame=math.isinf(args.speed)), args)


def _live(
    args: argparse.Namespace, grabber: ReplayGrabber, *, every_frame: bool, sinks: Sequence[Sink] = ()
) -> LiveRun:
    s = station(args.config)
    generator = load_generator(args.generator) if args.generator else s.generator
    order = field_order(args.field_order, s.measuring.field_order)
    return LiveRun(
        kind=Liveness.REPLAY,
        grabber=grabber,
        generator=generator,
        camera=read_camera(args.camera) if args.camera else s.camera,
        measuring=replace(s.measuring, field_order=order),
        viewer=s.viewer,
        health=s.health,
        console=s.console,
        every_frame=every_frame,
        interpreter=interpreter_for(args, s.identity, s.alignment, generator),
        recording=RecordingChoice(
            replace(s.recording, enabled=False),  # what is recorded already is recorded again where that is asked for
            configuration(
                station_file(args.config),
                device=str(args.path),
                generator=args.generator,
                camera=args.camera,
                field_order=order,
            ),
            s.identity.rule(generator),
        ),
        sinks=sinks,
    )


def _session(args: argparse.Namespace, session: RecordedSession) -> int:
    """Measure the frames of a session again: as they were measured, unless the options say otherwise."""
    otherwise = args.config, args.generator, args.camera, args.field_order, args.target, *args.anchor
    memory = None if any(option is not None for option in otherwise) else remembered(session)
    recorded_said(args, session)
    comparison = Comparison(session, remembered=memory is not None)
    grabber = SessionGrabber(
        args.path, speed=math.inf if args.check else args.speed, loop=args.loop, name=recorded_source(session)
    )
    live = _live(args, grabber, every_frame=True, sinks=[comparison])
    assert live.recording is not None, "replays can be recorded"
    interpreter = recalled(session, live.interpreter, live.recording.rule)
    live = replace(live, interpreter=interpreter, check=recalled_check(session), remembered=memory)
    status = _check(session, live, comparison) if args.check else watch(live, args)
    for line in [*comparison.lines(), *_surroundings(session, comparison)]:
        print(line)
    return max(status, int(args.check and not comparison.same))


def _check(session: RecordedSession, live: LiveRun, comparison: Comparison) -> int:
    """Measure all of it, without a viewer, and show nothing but what comes of it."""
    prepare_kernels()
    field = live.measuring.field_order.field
    again = measured_again(session, live.generator, live.camera, field, live.interpreter, live.check, live.remembered)
    for frame, results in again:
        comparison.accept(frame, results)
    counts = session.counts()
    lost = f", {counts.overflowed:,} lost by the recorder" if counts.overflowed else ""
    print(f"{session.name}: {counts.frames:,} frames recorded, {counts.measured:,} measured{lost}, {counts.end}")
    return 0


def _surroundings(session: RecordedSession, comparison: Comparison) -> list[str]:
    """What may have made a difference, where there is one."""
    if comparison.same or comparison.different == 0:
        return []
    other = changed(session.about.software, software()) + changed(session.about.machine, machine())
    return [f"  not the same: {what}" for what in other]
