"""The operator's page as a whole: made for a run, served while it lasts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from service.console.access import Access, Tokens
from service.console.app import WebApp
from service.console.board import Board
from service.console.operations import Operations
from service.console.server import WebServer, bind, reachable
from service.console.sink import ConsoleSink
from service.console.state import StateTeller
from service.console.trend import Trend

if TYPE_CHECKING:
    from drivers.grabber import Clock
    from service.alignment.desk import AlarmDesk, Tell
    from service.alignment.interpreter import Interpreter
    from service.console.watched import About, Watched
    from service.sinks.session.control import SessionControl

__all__ = ["Console"]


class Console:
    """Serves the page, from when its sink is started to when that is closed.

    Parameters
    ----------
    about
        What is watched.
    interpreter
        Names the tubes and judges the alignment.
    watched
        The live service.
    recorder
        Records sessions; None where nothing is recorded.
    clock
        The one that frames are timed by.
    desk
        The alarms.
    tell
        Told of what operators do.
    """

    def __init__(
        self,
        about: About,
        interpreter: Interpreter,
        watched: Watched,
        recorder: SessionControl | None,
        clock: Clock,
        desk: AlarmDesk,
        tell: Tell,
    ) -> None:
        settings = about.settings
        self._settings, self._clock = settings, clock
        self.tokens = None if settings.is_loopback else Tokens.fresh()
        self._board, trend = Board(), Trend()
        self._operations = Operations(interpreter, desk, watched, recorder, clock, tell)
        self._teller = StateTeller(about, watched, self._operations, desk, trend, interpreter.aligner, recorder, clock)
        self._server: WebServer | None = None
        self.port: int | None = None
        self.sink = ConsoleSink(
            settings,
            about.rule,
            self._board,
            trend,
            self._operations,
            clock,
            live=about.kind != "REPLAY",
            start=self._start,
            finish=self._finish,
        )

    def _start(self) -> None:
        listening = bind(self._settings.address, self._settings.port)
        self.port = listening.getsockname()[1]
        access = Access(self._settings, self.port, self.tokens)
        app = WebApp(access, self._board, self._teller, self._operations, self._clock, self._settings.clients)
        self._server = WebServer(app.asgi, listening)
        self._server.start()

    def _finish(self, timeout_s: float) -> None:
        if self._server is not None:
            self._server.close(timeout_s)

    def announce(self) -> None:
        """Say where the page is, once it is served; with tokens, which are shown nowhere else."""
        print("\n".join(self._addresses()), flush=True)

    def _addresses(self) -> list[str]:
        host = reachable(self._settings.address)
        where = f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"
        if self.tokens is None:
            return [f"operator's page: {where}"]
        return [
            f"operator's page, to operate: {where}#token={self.tokens.control}",
            f"                 to watch:   {where}#token={self.tokens.view}",
        ]
