"""Looks for what is wrong, a few times a second, in a thread of its own, whoever is there to see it."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Final, Self

from service.acquisition.liveness import Liveness
from service.alignment.alarms import Condition
from service.alignment.conditions import alignment_conditions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType

    from drivers.grabber import Clock
    from service.acquisition.liveness import Shown
    from service.alignment.bands import Bands
    from service.alignment.desk import AlarmDesk
    from service.alignment.result import Alignment

__all__ = ["AlarmWatch", "source_conditions"]

log = logging.getLogger(__name__)

LOOK_S: Final = 0.2
WHAT_TO_DO: Final = {
    Liveness.NO_SIGNAL: "check camera, lamp and cable, and which input is chosen; stop moving",
    Liveness.FROZEN: "stop moving: the picture is not live; check the grabber",
    Liveness.STALE: "stop moving: the picture is old; check grabber and cable",
    Liveness.RECONNECTING: "stop moving; it is looked for by itself; check its cable",
    Liveness.ENDED: "stop moving; start the service again",
}


def source_conditions(kind: Liveness, shown: Shown) -> Sequence[Condition]:
    """What is wrong with the source; that a recording is over is no alarm."""
    word = shown.liveness
    if word not in WHAT_TO_DO or (word is Liveness.ENDED and kind is Liveness.REPLAY):
        return ()
    return (Condition(f"source {word.lower()}", str(shown), WHAT_TO_DO[word]),)


class AlarmWatch:
    """Brings what is wrong to the desk, while its block lasts; and once more at its end, where that is a failure.

    Parameters
    ----------
    desk
        Keeps the list.
    kind
        What the source is when nothing is wrong with it.
    shown
        What the picture is worth now.
    alignment
        Gives the newest; None where nothing is judged.
    bands
        Its limits; None where no guide is set up.
    recording_failure
        Why recording stopped, where it did.
    clock
        Times the alarms.
    failed
        Whether the source failed for good.
    """

    def __init__(
        self,
        desk: AlarmDesk,
        kind: Liveness,
        shown: Callable[[], Shown],
        alignment: Callable[[], Alignment | None],
        bands: Bands | None,
        recording_failure: Callable[[], str | None],
        clock: Clock,
        failed: Callable[[], bool] = lambda: False,
    ) -> None:
        self.desk = desk
        self._kind, self._shown, self._alignment, self._bands = kind, shown, alignment, bands
        self._recording_failure, self._clock, self._failed = recording_failure, clock, failed
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bowlsight-alarms", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join(1.0)
        if self._failed():
            self.look()

    def _run(self) -> None:
        while not self._over.wait(LOOK_S):
            try:
                self.look()
            except Exception:
                log.exception("the look for alarms failed")

    def look(self) -> None:
        """Follow what is wrong now."""
        self.desk.look(self._clock.monotonic_ns(), self._conditions())

    def _conditions(self) -> Sequence[Condition]:
        """What is wrong, what explains the others first: with no picture, nothing is said of the alignment."""
        shown = self._shown()
        found = list(source_conditions(self._kind, shown))
        alignment = self._alignment() if shown.good else None
        if alignment is not None and self._bands is not None:
            found.extend(alignment_conditions(alignment, self._bands))
        if (failure := self._recording_failure()) is not None:
            todo = "make room or name another disk, then start recording again; the watch goes on"
            found.append(Condition("recording", failure, todo))
        return found
