"""What a session's results rest on besides its frames, brought back at the pictures where it took effect."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivers.reading import Quality
from drivers.session_index import Outside
from service.acquisition.cross_check import CrossCheck
from service.acquisition.readings import Calibration, InstrumentReadings
from service.alignment.interpreter import Interpreter
from service.alignment.targets import Target, parse_anchor

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from service.alignment.priors import Priors
    from service.alignment.result import Alignment
    from service.identity.counting import NamingRule
    from service.sinks.session.reader import RecordedSession
    from service.vision.measurement import Measurement

__all__ = ["RecalledCheck", "RecalledInterpreter"]


class _Recall:
    """Reads the index along with the measuring; pictures come in the order in which they came then."""

    def __init__(self, session: RecordedSession, key: str) -> None:
        self._items: Iterator[Outside] = (i for i in session.index() if isinstance(i, Outside) and key in i.values)
        self._next = next(self._items, None)

    def at(self, measurement: Measurement) -> Mapping[str, Any] | None:
        """What took effect with a picture; None where nothing did."""
        found = self._next
        if found is None or (found.time_ns, found.field) != (measurement.time_ns, measurement.field):
            return None
        self._next = next(self._items, None)
        return found.values


class RecalledInterpreter(Interpreter):
    """Names and judges with the anchors and targets that the operator chose, picture by picture."""

    def __init__(self, session: RecordedSession, interpreter: Interpreter) -> None:
        super().__init__(interpreter.namer, interpreter.aligner)
        self._anchors, self._targets = _Recall(session, "anchors"), _Recall(session, "target")

    def read(
        self, measurement: Measurement, generation: int, *, fresh: bool = True
    ) -> tuple[Sequence[str | None], Alignment | None]:
        """As `Interpreter.read`, after what was chosen then."""
        rule = self.namer.rule
        if (chosen := self._anchors.at(measurement)) is not None:
            anchors = [parse_anchor(text, rule) for text in chosen["anchors"]]
            self.namer.anchor(anchors, chosen["generation"], chosen.get("index", measurement.index))
        if (chosen := self._targets.at(measurement)) is not None and self.aligner is not None:
            self.aligner.target = _target(chosen["target"], rule)
        return super().read(measurement, generation, fresh=fresh)


def _target(values: Mapping[str, Any], rule: NamingRule) -> Target:
    name, place = values["name"], values["place"]
    return Target(
        name=None if name is None else rule.parse(name),
        place=None if place is None else (place[0], place[1]),
        generation=values["generation"],
        index=values.get("index"),
    )


class RecalledCheck(CrossCheck):
    """Holds measurements against what lens and range finder said then."""

    def __init__(self, session: RecordedSession) -> None:
        self._recall, self._now = _Recall(session, "readings"), InstrumentReadings()
        super().__init__(lambda: self._now)

    def apply(self, measurement: Measurement) -> tuple[Measurement, Priors]:
        """As `CrossCheck.apply`, with the readings of that picture."""
        if (said := self._recall.at(measurement)) is not None:
            values = said["readings"]
            self._now = InstrumentReadings(
                **{
                    **values,
                    "distance_quality": Quality(values["distance_quality"]),
                    "focal_quality": Quality(values["focal_quality"]),
                    "calibration": Calibration(values["calibration"]),
                }
            )
        return super().apply(measurement)
