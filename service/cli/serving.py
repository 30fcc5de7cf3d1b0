"""The operator's page as commands use it: made for a live service, told of it, announced in the terminal."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from service.acquisition.liveness import Liveness
from service.console.watched import About, RefusedError, SourceStatus

if TYPE_CHECKING:
    import argparse

    from service.acquisition.live import LiveService
    from service.alignment.desk import AlarmDesk, Tell
    from service.alignment.interpreter import Interpreter
    from service.cli.live import LiveRun
    from service.cli.viewing import Viewing
    from service.console.console import Console
    from service.sinks.session.recorder import SessionRecorder

__all__ = ["Served", "make_console"]

FINE = (Liveness.LIVE, Liveness.REPLAY, Liveness.SIMULATED)


class Served:
    """The live service as the page sees it, from when it is attached."""

    def __init__(self) -> None:
        self._service: LiveService | None = None

    def attach(self, service: LiveService) -> None:
        """Name the service, once it is open."""
        self._service = service

    def status(self) -> SourceStatus:
        """How the source does."""
        if self._service is None:
            return SourceStatus(Liveness.STARTING)
        health = self._service.health()
        shown, account = health.shown, health.account
        return SourceStatus(
            liveness=Liveness.LIVE if shown.liveness in FINE else shown.liveness,
            reason=shown.reason,
            since_ns=shown.since_ns,
            capture_fps=health.capture_fps,
            result_fps=health.result_fps,
            dropped=account.dropped,
            bad=account.corrupt + account.failed,
            inputs=self._service.inputs,
            input=self._service.input,
        )

    def select_input(self, name: str) -> None:
        """Switch to another input."""
        if self._service is None:
            raise RefusedError("the source is not open yet")
        try:
            self._service.select_input(name)
        except ValueError as error:
            raise RefusedError(str(error)) from None


def make_console(
    args: argparse.Namespace,
    live: LiveRun,
    interpreter: Interpreter,
    viewing: Viewing,
    recorder: SessionRecorder | None,
    served: Served,
    desk: AlarmDesk,
    tell: Tell,
) -> Console | None:
    """Make the page that the options and the station ask for; nothing is started."""
    if args.no_console or not live.console.enabled:
        return None
    # the server takes a third of a second to import: only where it serves
    from service.console.console import Console  # noqa: PLC0415

    about = About(
        kind=str(live.kind),
        source=live.grabber.name,
        generator=live.generator.label,
        rule=interpreter.namer.rule,
        settings=replace(live.console, port=args.console_port or live.console.port),
        viewer_url=lambda: None if viewing.live is None else viewing.live.url,
    )
    return Console(about, interpreter, served, recorder, live.grabber.clock, desk, tell)
