"""Lines of JSON that tell when one of them was changed, taken out or cut short.

Each line ends with ``"check"``: the CRC-32 of its text before that key, begun with the check of the line before it. A
line that was cut short has no line end: it was being written when the power, or the program, went.
"""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

__all__ = ["Line", "LineChecker", "read_checked"]

_SUFFIX = re.compile(rb',"check":"([0-9a-f]{8})"}')
_SUFFIX_BYTES = 20


@dataclass(frozen=True, slots=True)
class Line:
    """One line of such a file.

    Attributes
    ----------
    number
        From 1 on.
    record
        What it says, without its check; None where that is not to be trusted.
    problem
        None, or in words what is wrong with it.
    torn
        Whether it is the file's last one, cut short while it was written.
    """

    number: int
    record: dict[str, Any] | None
    problem: str | None = None
    torn: bool = False


class LineChecker:
    """Puts the checks on the lines of one file, from its first one on."""

    def __init__(self) -> None:
        self.check = 0
        """That of the last line; put it back where that line could not be written."""

    def line(self, record: Mapping[str, Any]) -> str:
        """Give the next line, without its line end, in ASCII. A record has at least one key."""
        body = json.dumps(record, separators=(",", ":"), allow_nan=False)[:-1]
        self.check = zlib.crc32(body.encode("ascii"), self.check)
        return f'{body},"check":"{self.check:08x}"}}'


def read_checked(path: Path) -> Iterator[Line]:
    """Read such a file line by line; raises OSError where it cannot be read.

    A line with a problem is given, too; the lines after it are checked from what it says its check is.
    """
    check = 0
    with path.open("rb") as file:
        for number, raw in enumerate(file, 1):
            line, check = _read(raw, number, check)
            yield line


def _read(raw: bytes, number: int, before: int) -> tuple[Line, int]:
    if not raw.endswith(b"\n"):
        if _record(raw, before) is None and _record(raw[:-1], before) is None:
            return Line(number, None, "is cut short: writing it was interrupted", torn=True), before
        return Line(number, None, "was changed: its line end is gone"), before
    found = _SUFFIX.fullmatch(raw, max(0, len(raw) - 1 - _SUFFIX_BYTES), len(raw) - 1)
    check = before if found is None else int(found[1], 16)
    record = _record(raw[:-1], before)
    if record is None:
        return Line(number, None, "was changed, or the line before it was taken out"), check
    return Line(number, record), check


def _record(line: bytes, before: int) -> dict[str, Any] | None:
    """What a whole line says; None where its check is not right."""
    body = line[:-_SUFFIX_BYTES]
    found = _SUFFIX.fullmatch(line, len(body))
    if found is None or int(found[1], 16) != zlib.crc32(body, before):
        return None
    try:
        record = json.loads(body + b"}")
    except ValueError:  # a right check on what is no JSON: made up
        return None
    return record if isinstance(record, dict) else None
