"""A station for the operator's page without devices: what it is told to be, and what was asked of it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from service.acquisition.alarms import AlarmWatch
from service.acquisition.liveness import Liveness, Shown
from service.alignment.desk import AlarmDesk
from service.alignment.interpreter import Interpreter
from service.config.console import ConsoleSettings
from service.config.generators import Naming
from service.console.access import Access, Tokens
from service.console.app import WebApp
from service.console.board import Board
from service.console.operations import Operations
from service.console.sink import ConsoleSink
from service.console.state import StateTeller
from service.console.trend import Trend
from service.console.watched import About, RefusedError, SourceStatus
from service.identity.counting import Growth, NamingRule
from service.identity.namer import TubeNamer
from service.identity.names import Leg
from service.sinks.session.control import RecordingError, RecordingState
from tests.fakes.clock import ManualClock
from tests.fakes.drawn import LATTICE

RULE = NamingRule(
    Naming.ROW_COLUMN, LATTICE, rows_grow=Growth.UP, columns_grow=Growth.RIGHT, steam_generator="SG1", leg=Leg.HOT
)


class FakeWatched:
    def __init__(self):
        self.shown = SourceStatus("LIVE", capture_fps=30.0, inputs=("CH1", "CH2"), input="CH1")

    def status(self):
        return self.shown

    def select_input(self, name):
        if name == "CH2":
            raise RefusedError("CH2: the device does not answer")
        self.shown = SourceStatus("LIVE", inputs=self.shown.inputs, input=name)


class FakeRecorder:
    def __init__(self):
        self.state = RecordingState()
        self.asked = []

    def start_recording(self):
        self.state = RecordingState(folder=Path("/sessions/one"))
        return self.state.folder

    def stop_recording(self):
        self.state = RecordingState()

    def mark(self, text, operator=""):
        return self._record("mark", text, operator)

    def verify(self, claim, operator="", reason=None):
        return self._record("verify", claim, operator, reason)

    def _record(self, *what):
        if self.state.folder is None:
            raise RecordingError("nothing is being recorded; start recording first")
        self.asked.append(what)
        values = {"tube_claimed": what[1], "tube_seen": "ROW3 COL4", "agrees": what[1] == "ROW3 COL4", "secret": 1}
        return SimpleNamespace(number=len(self.asked) - 1, sha256="0" * 64, values=values)


class WatchingTeller(StateTeller):
    """Has alarms looked for whenever the state is asked for, instead of in a thread."""

    def look(self):
        self.alarms.look()
        return super().look()


class FakeStation:
    """All of the console but the server; `app` is its ASGI application, `sink` takes frames."""

    def __init__(
        self, *, kind="LIVE", tokens=None, aligner=None, recorder=True, rule=RULE, clock=None, port=8420, **settings
    ):
        self.clock, self.watched, self.told = clock or ManualClock(), FakeWatched(), []
        self.recorder = FakeRecorder() if recorder else None
        self.interpreter = Interpreter(TubeNamer(rule), aligner)
        self.settings = ConsoleSettings(port=port, **settings)
        self.latest = None
        self.desk = AlarmDesk(self.tell)
        self.operations = Operations(self.interpreter, self.desk, self.watched, self.recorder, self.clock, self.tell)
        self.board, self.trend = Board(), Trend()
        about = About(kind, "camera 1", "Model F", rule, self.settings)
        self.alarms = AlarmWatch(
            self.desk, Liveness(kind), lambda: Shown(Liveness(self.watched.shown.liveness), self.watched.shown.reason),
            lambda: None if self.latest is None else self.latest.alignment,
            None if aligner is None else aligner.settings.bands,
            lambda: None if self.recorder is None else self.recorder.state.failure, self.clock,
        )  # fmt: skip
        self.teller = WatchingTeller(
            about, self.watched, self.operations, self.desk, self.trend, aligner, self.recorder, self.clock
        )
        self.teller.alarms = self.alarms
        self.sink = ConsoleSink(
            self.settings, rule, self.board, self.trend, self.operations, self.clock,
            live=kind != "REPLAY", start=lambda: None, finish=lambda timeout_s: None,
        )  # fmt: skip
        self.access = Access(self.settings, port, tokens)
        self.web = WebApp(self.access, self.board, self.teller, self.operations, self.clock, self.settings.clients)
        self.app = self.web.asgi

    def tell(self, text, level, *, kind, **more):
        self.told.append(text)

    def show(self, frame, result):
        """Bring a frame to the pages, as the sink's thread would."""
        names, alignment = self.interpreter.read(result.measurement, result.generation)
        result = self.latest = replace(result, names=names, alignment=alignment)
        if isinstance(self.clock, ManualClock):
            self.clock.advance(0.04)
        return self.sink._do_consume(frame, (result,))


TOKENS = Tokens("view-token", "control-token")
