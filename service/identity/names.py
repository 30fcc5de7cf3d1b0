"""A tube's name: read in every spelling, printed in one."""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass

from drivers.errors import ConfigError
from service.config.generators import Naming

__all__ = ["Leg", "NamingError", "TubeName", "parse_name"]

LARGEST_NUMBER = 999
_LETTERS = re.compile(
    r"(ROW|R|LINE|LN|L|COLUMN|COL|C)[ .:=]*([0-9]+)[ ,;:/_.-]*(ROW|R|LINE|LN|L|COLUMN|COL|C)[ .:=]*([0-9]+)"
)
_BARE = re.compile(r"([0-9]+) *[ :/_-] *([0-9]+)")
"""Not with a comma: that is how lattice places are written."""
_GENERATOR = re.compile(r"(?:R?SG|S/G)[ -]?[A-Z0-9]+(?=[ ,:])")
_LEG = re.compile(r"^(?:HL|CL)(?![A-Z])|(?<![A-Z])(?:HL|CL)$")


class NamingError(ConfigError):
    """A name that cannot be: not spelt as one, or of no tube; the message says what is right."""


class Leg(enum.StrEnum):
    """Which half of the channel head."""

    HOT = "HL"
    COLD = "CL"


@dataclass(frozen=True, slots=True, order=True)
class TubeName:
    """A tube as the plant calls it.

    Attributes
    ----------
    naming
        How it is spelt.
    row, column
        The plant's numbers, never an array's index; `column` is the line where tubes are named by line and row.
    """

    naming: Naming
    row: int
    column: int

    def __str__(self) -> str:
        if self.naming is Naming.LINE_ROW:
            return f"L{self.column}R{self.row}"
        return f"ROW{self.row} COL{self.column}"

    def full(self, steam_generator: str = "", leg: Leg | None = None) -> str:
        """The name with where it is: ``SG2 HL L83R87``."""
        return " ".join(part for part in (steam_generator, leg, str(self)) if part)


def parse_name(text: str, naming: Naming, steam_generator: str = "", leg: Leg | None = None) -> TubeName:
    """Read a name in any spelling that has one meaning: L83R87, r87 l83, 83/87, LINE 83 ROW 87, SG2 HL L83R87.

    Two bare numbers come in the order of the canonical name: line and row, or row and column.

    Raises
    ------
    NamingError
        It has no meaning, or names a steam generator or leg that is not this one.
    """
    rest = _without_place(text, steam_generator, leg)
    order = "LR" if naming is Naming.LINE_ROW else "RC"
    if match := _LETTERS.fullmatch(rest):
        found = {match[1][0]: int(match[2]), match[3][0]: int(match[4])}
    elif match := _BARE.fullmatch(rest):
        found = dict(zip(order, map(int, match.groups()), strict=True))
    else:
        found = {}
    if set(found) != set(order):
        right = "L83R87 (line 83, row 87)" if naming is Naming.LINE_ROW else "ROW12 COL34 (row 12, column 34)"
        raise NamingError(f"tube {text!r}: cannot be read; tubes of this steam generator are named like {right}")
    if not all(1 <= n <= LARGEST_NUMBER for n in found.values()):
        raise NamingError(f"tube {text!r}: its numbers must be from 1 to {LARGEST_NUMBER}")
    return TubeName(naming, found["R"], found[order.replace("R", "")])


def _without_place(text: str, steam_generator: str, leg: Leg | None) -> str:
    """The name alone, in capitals; what is said of steam generator and leg must be true of this one."""
    rest, here = text.strip().upper(), steam_generator.upper()
    said = here if here and rest.startswith(f"{here} ") else ""
    if not said and (match := _GENERATOR.match(rest)):
        said = match[0]
    if said:
        if _compact(said) != _compact(here):
            raise NamingError(f"tube {text!r}: is in {said}; {_this('steam_generator', steam_generator)}")
        rest = rest[len(said) :].lstrip(" ,:")
    if match := _LEG.search(rest):
        if match[0] != leg:
            raise NamingError(f"tube {text!r}: is in leg {match[0]}; {_this('leg', leg)}")
        rest = (rest[: match.start()] + rest[match.end() :]).strip(" ,:")
    return rest


def _compact(text: str) -> str:
    return re.sub(r"[^A-Z0-9]", "", text)


def _this(key: str, value: str | None) -> str:
    return f"this one is {value}" if value else f"set [identity] {key} to say which this one is"
