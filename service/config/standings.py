"""Tables of which tube the guide stood over, for `align-setup`: one standing a line, ``FRAMES TUBE [INSERTED_MM]``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from service.alignment.targets import parse_target

if TYPE_CHECKING:
    from pathlib import Path

    from service.alignment.targets import Target
    from service.identity.counting import NamingRule

__all__ = ["TableLine", "read_standings"]

EXPECTED = 'a line holds FRAMES TUBE [INSERTED_MM], such as "10-25 3,-2 40" or "30 L83R87"'
LARGEST_BYTES = 1_000_000
_FRAMES = re.compile(r"([0-9]{1,9})(?:-([0-9]{1,9}))?")
_LENGTH = re.compile(r"[0-9]{1,4}(?:\.[0-9]*)?")


@dataclass(frozen=True, slots=True)
class TableLine:
    """The guide over one tube, and not moved, from frame `first` to frame `last`.

    Attributes
    ----------
    first, last
        Frame numbers, as `analyze` prints them.
    target
        Which tube.
    inserted_mm
        How far something straight reached into it; None: as for all.
    """

    first: int
    last: int
    target: Target
    inserted_mm: float | None

    def __str__(self) -> str:
        return f"frame {self.first}" if self.first == self.last else f"frames {self.first}-{self.last}"


def read_standings(path: Path, rule: NamingRule) -> list[TableLine]:
    """Read a table; blank lines and ``#`` comments are skipped; raises ConfigError where a line says nothing sound."""
    lines: list[TableLine] = []
    for number, text in enumerate(_text(path).splitlines(), 1):
        if words := text.partition("#")[0].split():
            line = _line(words, f"{path}:{number}", rule)
            if taken := next((t for t in lines if line.first <= t.last and t.first <= line.last), None):
                raise ConfigError(f"{path}:{number}: {line} belong to {taken} already; give each frame one tube")
            lines.append(line)
    if not lines:
        raise ConfigError(f"{path}: no standing in it; {EXPECTED}")
    return lines


def _line(words: list[str], where: str, rule: NamingRule) -> TableLine:
    frames = _FRAMES.fullmatch(words[0])
    if frames is None or len(words) < 2:
        raise ConfigError(f"{where}: {' '.join(words)[:60]!r}: {EXPECTED}")
    first, last = int(frames[1]), int(frames[2] or frames[1])
    if last < first:
        raise ConfigError(f"{where}: {words[0]}: the last frame comes before the first")
    inserted = float(words.pop()) if len(words) > 2 and _LENGTH.fullmatch(words[-1]) else None
    try:
        return TableLine(first, last, parse_target(" ".join(words[1:]), rule), inserted)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise ConfigError(f"{path}: too large for a table of standings; {EXPECTED}")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start}); is it a table of standings?") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
