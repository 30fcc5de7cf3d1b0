"""Sees to it that somebody owns the source: replaces the thread that is stuck in it, and tells what operators see."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Final

from service.acquisition.device import Device
from service.acquisition.liveness import Evidence, Liveness, Shown, shown
from service.acquisition.recovery import Recovery, Supervision
from service.acquisition.tell import Tell
from service.acquisition.thread import UNSUPERVISED, AcquisitionThread
from service.acquisition.watchdog import is_hung

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.grabber import FrameFormat, Grabber
    from service.acquisition.health import AcquisitionState
    from service.acquisition.intake import Intake
    from service.acquisition.watchdog import Call

__all__ = ["Supervisor"]

TICK_S: Final = 0.05
MOST_LEFT_BEHIND: Final = 4
"""Threads stuck in a device at once; with more, the device is waited for."""


class Supervisor:
    """Runs the thread that owns the source, one at a time, and watches it.

    Parameters
    ----------
    grabber
        Closed.
    intake
        Where frames go.
    kind
        What the source is when nothing is wrong with it: LIVE, REPLAY or SIMULATED.
    prepare
        Sets the grabber up once it is open, before it streams.
    supervision
        How the source is got back; None for recordings, whose failures are final.
    tell
        Gets every event in words, with INFO, WARN or ERROR. Called by several threads; must return at once.
    measuring_ns
        Tells when the frame in hand was begun to be measured; None where none is.
    """

    def __init__(
        self,
        grabber: Grabber,
        intake: Intake,
        kind: Liveness = Liveness.LIVE,
        prepare: Callable[[Grabber], None] | None = None,
        supervision: Supervision | None = None,
        tell: Callable[[str, str], None] | None = None,
        measuring_ns: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._intake, self._kind, self._prepare, self._supervision = intake, kind, prepare, supervision
        self._suspect: Call | None = None
        self._clock, self._name, self._measuring_ns = grabber.clock, grabber.name, measuring_ns
        self._tell = Tell(grabber.name, tell)
        self._recovery = None if supervision is None else Recovery(supervision, grabber.clock)
        self._replacing = threading.Lock()
        self._over, self._watched = threading.Event(), threading.Event()
        self._owner = self._owned(Device(grabber, prepare))
        self._left: list[AcquisitionThread] = []
        self._told_of: Shown | None = None
        self._thread = threading.Thread(target=self._watch, name="bowlsight-supervision", daemon=True)

    def _owned(self, device: Device, takes_over: str | None = None) -> AcquisitionThread:
        return AcquisitionThread(device, self._intake, self._tell, self._recovery, takes_over)

    # -- called from outside -------------------------------------------------------------------------------------------

    def open(self, timeout_s: float) -> FrameFormat:
        """Open the source; raises what that raised, or DeviceTimeoutError."""
        return self._owner.open(timeout_s)

    def begin(self) -> None:
        """Let it stream, and begin to watch."""
        self._owner.begin()
        self._thread.start()

    def request_stop(self) -> None:
        """Ask it to end; returns at once."""
        self._over.set()
        with self._replacing:
            self._owner.request_stop()

    def join(self, timeout_s: float) -> bool:
        """Wait for its end; False where it is stuck in its device."""
        if not self._owner.join(timeout_s):
            return False
        self._over.set()
        # An interrupted Thread.join takes the thread for ended (CPython 3.11): wait for an event instead.
        return self._thread.ident is None or self._watched.wait(max(TICK_S, timeout_s))

    def select_input(self, name: str) -> None:
        """Have the source switched to another of its inputs; raises ValueError where it has none of that name."""
        if name not in self.inputs:
            raise ValueError(f"{self._name} has no input {name!r}; it offers {', '.join(self.inputs) or 'none'}")
        self._owner.ask_for_input(name)

    @property
    def state(self) -> AcquisitionState:
        """Where acquisition stands."""
        return self._owner.state

    @property
    def failure(self) -> Exception | None:
        """What ended it, where that was neither a stop nor the end of a recording."""
        return self._owner.failure

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the source's inputs, once open."""
        return self._owner.device.inputs

    @property
    def input(self) -> str:
        """Name of the input in use; empty before it was open."""
        return self._owner.device.input or ""

    @property
    def recoveries(self) -> int:
        """How often the source was got back."""
        return 0 if self._recovery is None else self._recovery.recoveries

    def shown(self) -> Shown:
        """What operators are told now."""
        owner, last, watch = self._owner, self._intake.last, self._intake.watch
        evidence = Evidence(
            kind=self._kind,
            state=owner.state,
            trouble="" if self._recovery is None else self._recovery.trouble,
            since_ns=None if last is None else last.time_ns,
            started=last is not None and last.started,
            rate_hz=None if owner.device.format is None else owner.device.format.rate_hz,
            late_ns=0 if last is None else last.late_ns,
            content=None if watch is None else watch.content,
            measuring_ns=self._measuring_ns(),
        )
        settings = UNSUPERVISED if self._supervision is None else self._supervision.settings
        return shown(self._clock.monotonic_ns(), evidence, settings)

    # -- the watch -----------------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        try:
            while not self._over.wait(TICK_S):
                self._replace_if_hung()
                self._tell_of_change()
        finally:
            self._watched.set()

    def _tell_of_change(self) -> None:
        """Tell what is shown, where that is something else than before; why it reconnects, its own thread tells."""
        now = self.shown()
        before, self._told_of = self._told_of, now
        same = before is not None and (before.liveness, before.reason) == (now.liveness, now.reason)
        if not same and now.liveness is not Liveness.RECONNECTING:
            self._tell(str(now), "INFO" if now.good or now.liveness is Liveness.STARTING else "WARN")

    def _replace_if_hung(self) -> None:
        """Replace the thread where its call hangs, seen twice: a process that was halted hangs for one look only."""
        call, supervision = self._owner.device.call, self._supervision
        if call is None or supervision is None or supervision.remake is None:
            return
        if not is_hung(self._clock.monotonic_ns(), call, supervision.settings.hung_s):
            return
        seen_before, self._suspect = self._suspect is call, call
        if not seen_before:
            return
        self._left = [thread for thread in self._left if not thread.join(0)]
        if len(self._left) < MOST_LEFT_BEHIND:
            self._replace(supervision.remake(), call.doing)

    def _replace(self, grabber: Grabber, doing: str) -> None:
        with self._replacing:
            if self._over.is_set():
                return
            stuck = self._owner
            stuck.leave_behind()
            self._left.append(stuck)
            self._owner = self._owned(Device(grabber, self._prepare, like=stuck.device), takes_over=doing)
            self._owner.take_over()
