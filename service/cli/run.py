"""`bowlsight run`: the live service as the station file says."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from drivers.automatics import lock_automatics
from drivers.errors import DeviceBusyError, DeviceNotFoundError, DevicePermissionError
from drivers.grabber import Standard
from drivers.opening import bus_reset, open_grabber
from drivers.replay import ReplayGrabber
from drivers.scene import GENERATORS
from drivers.simulated import SimulatedGrabber
from service.acquisition.instruments import Instruments
from service.acquisition.liveness import Liveness
from service.acquisition.recovery import Supervision
from service.cli.inputs import station, station_file
from service.cli.interpreting import interpreter_for
from service.cli.live import LiveRun, watch
from service.cli.recording import RecordingChoice
from service.cli.simulate import camera_of
from service.cli.terminal import say
from service.sinks.session.configuration import configuration

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from drivers.grabber import Grabber
    from service.config.station import SourceSettings, Station

__all__ = ["run", "wait_for"]

log = logging.getLogger(__name__)


def run(args: argparse.Namespace) -> int:
    """Grab and measure; returns the exit status."""
    s = station(args.config)
    grabber = _grabber(s)
    if args.wait:
        wait_for(grabber, s.supervision.look_s)
    recorded = isinstance(grabber, ReplayGrabber)
    kind, camera = Liveness.REPLAY if recorded else Liveness.LIVE, s.camera
    if isinstance(grabber, SimulatedGrabber):
        kind, camera = Liveness.SIMULATED, s.camera or camera_of(grabber.scene.optics)
    return watch(
        LiveRun(
            kind=kind,
            grabber=grabber,
            generator=s.generator,
            camera=camera,
            measuring=s.measuring,
            viewer=s.viewer,
            console=s.console,
            prepare=_preparing(s.source),
            interpreter=interpreter_for(args, s.identity, s.alignment, s.generator),
            recording=RecordingChoice(
                s.recording,
                configuration(station_file(args.config), camera=None if camera is s.camera else camera),
                s.identity.rule(s.generator),
            ),
            health=s.health,
            instruments=None if s.lens is None and s.range_finder is None else Instruments(s.lens, s.range_finder),
            supervision=None if recorded else _supervision(s),
        ),
        args,
    )


def _grabber(s: Station) -> Grabber:
    device = s.source.device
    if device == "simulated" and s.generator.key in GENERATORS:
        device = f"simulated:{s.generator.key}"
    return open_grabber(device)


def wait_for(grabber: Grabber, look_s: float) -> None:
    """Return once the device can be opened; as often as that takes, but for what waiting cannot help."""
    said = ""
    while True:
        try:
            with grabber:
                return
        except (DeviceNotFoundError, DeviceBusyError, DevicePermissionError) as error:
            if type(error).__name__ != said:
                said = type(error).__name__
                say(f"{error}; waiting for it")
        grabber.clock.sleep(look_s)


def _supervision(s: Station) -> Supervision:
    reset = bus_reset(s.source.device) if s.supervision.usb_reset else None
    return Supervision(s.supervision, remake=lambda: _grabber(s), reset=reset)


def _preparing(source: SourceSettings) -> Callable[[Grabber], None]:
    def prepare(grabber: Grabber) -> None:
        if source.input is not None:
            grabber.select_input(source.input)
        if source.standard is not Standard.NONE:
            grabber.set_standard(source.standard)
        for name, off in lock_automatics(grabber, source.lock).items():
            log.info("%s: %s is off (%g)", grabber.name, name, off)
        for name, asked in source.controls.items():
            taken = grabber.set_control(name, asked)
            if taken != asked:
                log.warning("%s: asked for %s = %g, the device took %g", grabber.name, name, asked, taken)

    return prepare
