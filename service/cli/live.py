"""What `demo`, `run` and `replay` share: the live service with a status line, a viewer and a summary."""

from __future__ import annotations

import contextlib
import functools
import math
import threading
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from drivers.errors import ConfigError
from service.acquisition.alarms import AlarmWatch
from service.acquisition.cross_check import CrossCheck
from service.acquisition.live import STOP_S, LiveService
from service.alignment.desk import AlarmDesk
from service.alignment.interpreter import Interpreter
from service.cli.calibrating import calibration_sink
from service.cli.inputs import fitting_camera
from service.cli.keys import pressed_keys
from service.cli.recording import keys_offered, make_recorder, on_key, recorded_lines
from service.cli.reporting import Reporting
from service.cli.serving import Served, make_console
from service.cli.status import status_parts, summary_lines
from service.cli.terminal import Interrupted, StatusLine, say
from service.cli.viewing import make_viewing, viewer_watch
from service.config.alignment import IdentitySettings
from service.config.console import ConsoleSettings
from service.config.supervision import HealthSettings
from service.identity.namer import TubeNamer
from service.sinks.session.recorder import FRAMES_CAPACITY
from service.vision.process import Measurer, warm_up

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping, Sequence

    from drivers.grabber import Clock, FrameFormat, Grabber
    from service.acquisition.instruments import Instruments
    from service.acquisition.liveness import Liveness
    from service.acquisition.recovery import Supervision
    from service.alignment.desk import Tell
    from service.alignment.result import Alignment
    from service.cli.recording import RecordingChoice
    from service.cli.viewing import Viewing
    from service.config.generators import SteamGenerator
    from service.config.station import MeasuringSettings, ViewerSettings
    from service.identity.counting import NamingRule
    from service.sinks.base import Sink
    from service.sinks.session.recorder import SessionRecorder
    from service.vision.camera import Camera

__all__ = ["LiveRun", "prepare_kernels", "watch"]

PREPARING = "preparing the measuring kernels; the first time after an installation this takes about a minute"
REFRESH_S = 0.2
FLUSH_S = 10.0
"""How long sinks may take to flush when nobody asked for a stop."""


@dataclass(frozen=True, slots=True)
class LiveRun:
    """What to watch, and how.

    Attributes
    ----------
    kind
        LIVE, REPLAY or SIMULATED, when nothing is wrong.
    prepare
        Sets the device up once it is open: input, standard, controls.
    every_frame
        Measure all frames, at the pace at which that goes; otherwise the newest.
    interpreter
        Names the tubes and judges the alignment, where that is set up.
    supervision
        How a live source is watched and got back; None for recordings.
    recording
        What may be recorded; None: nothing can be.
    sinks
        What else gets the results.
    check
        Holds results against what the instruments said when they were recorded; None: against `instruments`, if any.
    health
        Who is told how the service does.
    console
        The operator's page.
    instruments
        Lens and range finder; None where there is neither.
    remembered
        What measuring goes on from; None: from nothing.
    """

    kind: Liveness
    grabber: Grabber
    generator: SteamGenerator
    camera: Camera | None
    measuring: MeasuringSettings
    viewer: ViewerSettings
    prepare: Callable[[Grabber], None] | None = None
    every_frame: bool = False
    interpreter: Interpreter | None = None
    supervision: Supervision | None = None
    recording: RecordingChoice | None = None
    sinks: Sequence[Sink] = ()
    check: CrossCheck | None = None
    health: HealthSettings = field(default_factory=HealthSettings)
    console: ConsoleSettings = field(default_factory=ConsoleSettings)
    instruments: Instruments | None = None
    remembered: Mapping[str, Any] | None = None


def watch(live: LiveRun, args: argparse.Namespace) -> int:
    """Run the live service until its source ends, it is stopped or the time is up; returns the exit status."""

    def measurer_for(picture_format: FrameFormat) -> Measurer:
        camera = fitting_camera(live.camera, picture_format, live.grabber.name)
        return Measurer(camera, live.generator.lattice, time.perf_counter_ns)

    viewing = make_viewing(args, live.viewer, live.generator, live.kind, live.grabber.name)
    recorder, served = _recorder(live, args), Served()
    interpreter = live.interpreter or Interpreter(TubeNamer(_rule(live)), None)
    tell = _teller(viewing, recorder)
    interpreter.namer.tell = functools.partial(tell, kind="names")
    desk = AlarmDesk(tell)
    console = make_console(args, live, interpreter, viewing, recorder, served, desk, tell)

    def prepare(grabber: Grabber) -> None:
        if live.prepare is not None:
            live.prepare(grabber)
        if recorder is not None:
            recorder.note_device(grabber)

    calibrating = calibration_sink(live.camera, live.generator.lattice, args, tell)
    service = LiveService(
        live.grabber,
        measurer_for,
        [
            *viewing.sinks,
            *live.sinks,
            *([calibrating] if calibrating else []),
            *([recorder] if recorder else []),
            *([console.sink] if console else []),
        ],
        prepare=prepare,
        every_frame=live.every_frame,
        field=live.measuring.field_order.field,
        oldest_s=None if live.every_frame else live.measuring.oldest_frame_ms / 1e3,
        interpreter=interpreter,
        check=live.check or (None if live.instruments is None else CrossCheck(live.instruments.readings, tell)),
        kind=live.kind,
        supervision=live.supervision,
        tell=tell,
        memory_wanted=lambda: recorder is not None and recorder.memory_wanted,
        remembered=live.remembered,
    )
    if recorder is not None:
        recorder.listen(service.subscribe(FRAMES_CAPACITY, waits=live.every_frame))
    settings = live.health if args.metrics is None else replace(live.health, metrics_port=args.metrics)
    reporting = Reporting(live.grabber.name, viewing.state, settings, live.grabber.clock)
    with service, live.instruments or contextlib.nullcontext():
        service.open()
        prepare_kernels()
        viewing.announce()
        served.attach(service)
        if console is not None:
            console.announce()
        began_s = time.monotonic()
        with reporting.running(service.health), _alarms(live, service, interpreter, recorder, desk):
            ended_by = _follow(service, reporting, recorder, desk, live.grabber.clock, args.seconds or math.inf)
        tell(ended_by, "INFO" if service.failure is None else "ERROR")
        if live.instruments is not None:
            live.instruments.request_stop()
        service.stop(FLUSH_S if ended_by == "ended" else STOP_S)
    service.stuck.extend(live.instruments.stuck if live.instruments else ())
    if calibrating is not None:
        print(f"calibration: {calibrating.progress}")
    return _conclude(service, recorder, ended_by, time.monotonic() - began_s)


def _teller(viewing: Viewing, recorder: SessionRecorder | None) -> Tell:
    """What passes events on to the viewer and to the session's record; of the source, where no other kind is named."""

    def tell(text: str, level: str, *, kind: str = "source", **more: Any) -> None:
        viewing.event(text, level)
        if recorder is not None:
            recorder.event(text, level, kind=kind, **more)

    return tell


def _alarms(
    live: LiveRun, service: LiveService, interpreter: Interpreter, recorder: SessionRecorder | None, desk: AlarmDesk
) -> AlarmWatch:
    """What looks for alarms while the service runs."""

    def alignment() -> Alignment | None:
        return None if service.latest is None else service.latest.results[-1].alignment

    return AlarmWatch(
        desk,
        live.kind,
        lambda: service.shown,
        alignment,
        None if interpreter.aligner is None else interpreter.aligner.settings.bands,
        lambda: None if recorder is None else recorder.state.failure,
        live.grabber.clock,
        failed=lambda: service.failure is not None,
    )


def _rule(live: LiveRun) -> NamingRule:
    return IdentitySettings().rule(live.generator) if live.recording is None else live.recording.rule


def _recorder(live: LiveRun, args: argparse.Namespace) -> SessionRecorder | None:
    if live.recording is None:
        return None
    shown = viewer_watch(live.generator, live.kind, live.grabber.name)
    return make_recorder(args, live.recording, live.kind, live.generator, live.grabber.clock, shown)


def prepare_kernels() -> None:
    """Compile the measuring kernels, or load them; the first time on a machine takes long enough to say so.

    Raises
    ------
    ConfigError
        There is no room to keep what was compiled.
    """
    notice = threading.Timer(2.0, say, [PREPARING])
    notice.daemon = True
    notice.start()
    try:
        warm_up(time.perf_counter_ns)
    except OSError as error:
        raise ConfigError(
            f"compiled kernels: cannot be kept: {error.strerror or error}; make room for 10 MB, or set NUMBA_CACHE_DIR"
            " to a folder that has it"
        ) from error
    finally:
        notice.cancel()
        notice.join()


def _follow(
    service: LiveService,
    reporting: Reporting,
    recorder: SessionRecorder | None,
    desk: AlarmDesk,
    clock: Clock,
    seconds: float,
) -> str:
    """Begin, show the status, and serve keys, until it is over; in a word, why it is."""
    status, end_s = StatusLine(), time.monotonic() + seconds
    try:
        service.begin()
        with pressed_keys() as keys:
            if keys is not None:
                print(keys_offered(recorder), flush=True)
            while not service.wait(REFRESH_S):
                now = service.health(), service.latest
                reporting.report(now[0])
                alarms = desk.unseen
                status.show(status_parts(*now, alarms), status_parts(*now, alarms, brief=True))
                for key in () if keys is None else keys():
                    on_key(key, recorder, lambda: desk.acknowledge(clock.monotonic_ns(), None, ""))
                if time.monotonic() > end_s:
                    return "time is up"
    except Interrupted:
        return "stopped"
    finally:
        status.clear()
    return "broke off" if service.failure else "ended"


def _conclude(service: LiveService, recorder: SessionRecorder | None, ended_by: str, seconds: float) -> int:
    health = service.health()
    for line in [*summary_lines(health, seconds, ended_by), *([] if recorder is None else recorded_lines(recorder))]:
        print(line)
    for stuck in service.stuck:
        say(f"{stuck} did not stop in time and was left behind")
    if service.failure is not None:
        say(str(service.failure))
    unwell = service.failure is not None or bool(service.stuck) or not health.account.balanced()
    return int(unwell or (recorder is not None and recorder.state.failure is not None))
