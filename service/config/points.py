"""Point files in the format of Willson's calibration data: one point a line, ``xw yw zw Xf Yf``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from drivers.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["read_points"]

EXPECTED = "a line holds five numbers, xw yw zw (mm) Xf Yf (px), separated by blanks"
FEWEST = 5
LARGEST_BYTES = 50_000_000


def read_points(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read coplanar calibration points; blank lines and ``#`` comments are skipped.

    Returns
    -------
    sheet_mm, points_px
        (n, 3) with one zw, and (n, 2).

    Raises
    ------
    ConfigError
        Not readable, a line that is no point, points of several heights, or too few.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        if words := line.partition("#")[0].split():
            rows.append(_point(words, f"{path}:{number}"))
            if abs(rows[-1][2] - rows[0][2]) > 1e-6:
                raise ConfigError(
                    f"{path}:{number}: zw = {words[2]}, but the first has {rows[0][2]:g}; give points of one plane"
                )
    if len(rows) < FEWEST:
        raise ConfigError(f"{path}: {len(rows)} points; give at least {FEWEST} ({EXPECTED})")
    points = np.array(rows)
    return points[:, :3].copy(), points[:, 3:].copy()


def _point(words: list[str], where: str) -> list[float]:
    said = " ".join(words)
    said = said if len(said) <= 60 else said[:57] + "..."
    if len(words) != 5:
        raise ConfigError(f"{where}: {said!r}: {len(words)} values; {EXPECTED}")
    values = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            raise ConfigError(f"{where}: {said!r}: {word[:30]!r} is no number; {EXPECTED}") from None
    if not all(map(math.isfinite, values)):
        raise ConfigError(f"{where}: {said!r}: not finite; leave out a point that was not measured")
    return values


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise ConfigError(f"{path}: larger than {LARGEST_BYTES // 1_000_000} MB; is it a point file? {EXPECTED}")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder; name a point file") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not text (byte {error.start}); is it a point file? {EXPECTED}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; check its permissions") from None
