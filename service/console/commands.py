"""The commands of the page: their arguments, as they are checked and as they are described to programs."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from service.console.operations import Operations

__all__ = ["COMMANDS", "LOGIN", "Argument", "BadRequestError", "Command", "read_arguments"]

PLACE: Final = 9999
"""Lattice rows and columns are within this."""
GENERATION: Final = 2**31 - 1
UNWRITTEN: Final = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]")
"""Control characters, and halves of letters, which no file takes."""


class BadRequestError(Exception):
    """A request is not what it should be; how, in a line."""


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument of a command: text, whole number or flag, as JSON has it.

    Attributes
    ----------
    kind
        "string", "integer" or "boolean".
    required
        Whether it must be given; where not, null is the same as left out.
    most
        Letters of a text; a number lies from -most to most.
    least
        Letters of a text at the least.
    """

    kind: str
    required: bool = False
    most: int = 80
    least: int = 0

    def check(self, name: str, value: Any) -> Any:
        """The value; raises BadRequestError."""
        if value is None and not self.required:
            return None
        if self.kind == "integer" and isinstance(value, float) and value.is_integer():
            value = int(value)  # JSON knows one kind of number
        if type(value) is not {"string": str, "integer": int, "boolean": bool}[self.kind]:
            raise BadRequestError(f"{name}: must be a {self.kind}")
        if isinstance(value, str) and not self.least <= len(value) <= self.most:
            raise BadRequestError(f"{name}: must have {self.least} to {self.most} letters")
        if isinstance(value, str) and UNWRITTEN.search(value):
            raise BadRequestError(f"{name}: has letters that cannot be printed")
        if isinstance(value, int) and not -self.most <= value <= self.most:
            raise BadRequestError(f"{name}: must be from {-self.most} to {self.most}")
        return value

    def schema(self) -> dict[str, Any]:
        """As JSON schema has it."""
        limits: dict[str, Any] = {}
        if self.kind == "string":
            limits = {"minLength": self.least, "maxLength": self.most, "pattern": r"^[^\x00-\x1f\x7f]*$"}
        elif self.kind == "integer":
            limits = {"minimum": -self.most, "maximum": self.most}
        return {"type": self.kind if self.required else [self.kind, "null"], **limits}


@dataclass(frozen=True, slots=True)
class Command:
    """What may be asked for, with POST and a JSON object."""

    summary: str
    arguments: Mapping[str, Argument]
    run: Callable[[Operations, Mapping[str, Any]], Any]


LOGIN: Final[Mapping[str, Argument]] = {"token": Argument("string", required=True, most=200)}
OPERATOR = {"operator": Argument("string")}
AT = {"generation": Argument("integer", most=GENERATION), "index": Argument("integer", most=GENERATION)}

COMMANDS: Final[Mapping[str, Command]] = {
    "target": Command(
        "choose the tube to align to: nearest, a name, or a lattice place ROW,COLUMN",
        {"tube": Argument("string", required=True, least=1), **AT, **OPERATOR},
        lambda o, a: {"target": o.choose(a["tube"], a["generation"], a["operator"] or "", a["index"])},
    ),
    "anchor": Command(
        "name the tube at a lattice place, and thereby all others",
        {
            "row": Argument("integer", required=True, most=PLACE),
            "column": Argument("integer", required=True, most=PLACE),
            "name": Argument("string", required=True, least=1),
            **AT,
            **OPERATOR,
        },
        lambda o, a: {
            "anchor": o.anchor(a["row"], a["column"], a["name"], a["generation"], a["operator"] or "", a["index"]),
        },
    ),
    "acknowledge": Command(
        "note that an alarm was seen; without a key, all",
        {"key": Argument("string"), **OPERATOR},
        lambda o, a: {"acknowledged": o.acknowledge(a["key"], a["operator"] or "")},
    ),
    "recording": Command(
        "start or stop recording a session",
        {"on": Argument("boolean", required=True), **OPERATOR},
        lambda o, a: {"folder": o.record(a["on"], a["operator"] or "")},
    ),
    "mark": Command(
        "note that data acquisition begins or ends here, with evidence from before and after",
        {"text": Argument("string", required=True, least=1, most=200), **OPERATOR},
        lambda o, a: o.mark(a["text"], a["operator"] or ""),
    ),
    "verify": Command(
        "put the picture on record as evidence, with the tube it is claimed to be; overriding it needs a reason",
        {"claim": Argument("string", least=1), "reason": Argument("string", most=500), **OPERATOR},
        lambda o, a: o.verify(a["claim"], a["operator"] or "", a["reason"]),
    ),
    "input": Command(
        "switch to another video input of the device",
        {"name": Argument("string", required=True, least=1), **OPERATOR},
        lambda o, a: o.select_input(a["name"], a["operator"] or ""),
    ),
}
"""Name: what it does, what it takes, what does it."""


def read_arguments(wanted: Mapping[str, Argument], body: bytes) -> dict[str, Any]:
    """Read arguments out of a JSON object; raises BadRequestError where they are not sound."""
    given = _read_object(body)
    if unknown := [name for name in given if name not in wanted]:
        raise BadRequestError(f"{unknown[0][:40]!r}: unknown; known: {', '.join(wanted)}")
    if missing := [name for name, argument in wanted.items() if argument.required and name not in given]:
        raise BadRequestError(f"{missing[0]}: is missing")
    return {name: argument.check(name, given.get(name)) for name, argument in wanted.items()}


def _read_object(body: bytes) -> dict[str, Any]:
    try:
        given = json.loads(body)
    except (ValueError, RecursionError):
        raise BadRequestError("the body must be JSON") from None
    if not isinstance(given, dict):
        raise BadRequestError("the body must be a JSON object")
    return given
