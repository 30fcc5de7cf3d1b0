"""Strict reading of TOML: every key known, every value possible, each error with its remedy."""

from __future__ import annotations

import difflib
import math
import tomllib
from typing import TYPE_CHECKING, Any, TypeVar

from drivers.errors import ConfigError

if TYPE_CHECKING:
    import enum
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["MISSING", "Table", "read_toml"]

E = TypeVar("E", bound="enum.StrEnum")
MISSING: Any = object()
"""Stands for 'no default: the key must be there'."""


def read_toml(path: Path) -> Table:
    """Read a TOML file; raises ConfigError where it cannot be read or is not TOML."""
    try:
        return Table(tomllib.loads(path.read_text(encoding="utf-8")), str(path))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder; name a TOML file") from None
    except PermissionError:
        raise ConfigError(f"{path}: this user may not read it; check its permissions") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start}); is it a TOML file?") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None


class Table:
    """One table of a TOML file, taken key by key; `finish` refuses what nobody took."""

    def __init__(self, values: dict[str, Any], file: str, path: str = "") -> None:
        self.values, self.file, self.path = values, file, path
        self._known: set[str] = set()

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def error(self, key: str, message: str) -> ConfigError:
        """Make the error of one key, naming file, key and value."""
        name = f"{self.path}.{key}" if self.path else key
        said = f" = {self.values[key]!r}" if key in self.values else ""
        return ConfigError(f"{self.file}: {name}{said}: {message}")

    def finish(self) -> None:
        """Refuse keys that nobody asked for, naming the nearest known one."""
        for key in self.values:
            if key not in self._known:
                near = difflib.get_close_matches(key, self._known, 1, 0.5)
                hint = f"did you mean {near[0]}?" if near else f"known keys: {', '.join(sorted(self._known))}"
                raise self.error(key, f"unknown key; {hint}")

    def _take(self, key: str, default: object, kind: str) -> Any:
        self._known.add(key)
        if key in self.values:
            return self.values[key]
        if default is MISSING:
            near = difflib.get_close_matches(key, self.values, 1, 0.6)
            raise self.error(key, f"missing; give {kind}" + (f" (there is {near[0]})" if near else ""))
        return default

    def number(
        self,
        key: str,
        default: Any = MISSING,
        *,
        above: float = -math.inf,
        minimum: float = -math.inf,
        maximum: float = math.inf,
    ) -> Any:
        """Take a finite number within limits; float, or `default` as it is."""
        value = self._take(key, default, "a number")
        return value if value is default else self.checked(key, value, above, minimum, maximum)

    def checked(
        self, key: str, value: object, above: float = -math.inf, minimum: float = -math.inf, maximum: float = math.inf
    ) -> float:
        """Check one number of a key."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(key, "must be a number")
        if not math.isfinite(value):
            raise self.error(key, "must be finite")
        if value <= above:
            raise self.error(key, f"must be above {above:g}")
        if not minimum <= value <= maximum:
            limits = [f"at least {minimum:g}"] * (minimum > -math.inf) + [f"at most {maximum:g}"] * (maximum < math.inf)
            raise self.error(key, f"must be {' and '.join(limits)}")
        return float(value)

    def integer(self, key: str, default: Any = MISSING, *, minimum: int, maximum: int = 2**53) -> Any:
        """Take a whole number within limits."""
        value = self._take(key, default, "a whole number")
        if value is default:
            return value
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, "must be a whole number")
        return int(self.checked(key, value, minimum=minimum, maximum=maximum))

    def numbers(self, key: str, count: int, default: Any = MISSING, *, above: float = -math.inf) -> Any:
        """Take a list of `count` finite numbers as a tuple of floats."""
        value = self._take(key, default, f"a list of {count} numbers")
        if value is default:
            return value
        if not isinstance(value, list) or len(value) != count:
            raise self.error(key, f"must be a list of {count} numbers")
        return tuple(self.checked(key, v, above) for v in value)

    def pairs(self, key: str, default: Any = MISSING) -> Any:
        """Take a list of pairs of finite numbers as a tuple of pairs of floats."""
        value = self._take(key, default, "a list of pairs of numbers")
        if value is default:
            return value
        if not isinstance(value, list) or any(not isinstance(p, list) or len(p) != 2 for p in value):
            raise self.error(key, "must be a list of pairs of numbers")
        return tuple((self.checked(key, a), self.checked(key, b)) for a, b in value)

    def text(self, key: str, default: Any = MISSING) -> Any:
        """Take a string."""
        value = self._take(key, default, "a text in quotes")
        if value is not default and not isinstance(value, str):
            raise self.error(key, "must be a text in quotes")
        return value

    def texts(self, key: str, default: Any = MISSING) -> Any:
        """Take a list of strings as a tuple."""
        value = self._take(key, default, "a list of texts")
        if value is default:
            return value
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.error(key, "must be a list of texts in quotes")
        return tuple(value)

    def flag(self, key: str, default: Any = MISSING) -> Any:
        """Take true or false."""
        value = self._take(key, default, "true or false")
        if value is not default and not isinstance(value, bool):
            raise self.error(key, "must be true or false")
        return value

    def choice(self, key: str, kind: type[E], default: Any = MISSING) -> E:
        """Take one of an enumeration's values."""
        value = self._take(key, default, f"one of {', '.join(kind)}")
        try:
            return kind(value)
        except ValueError:
            near = difflib.get_close_matches(str(value), list(kind), 1, 0.5)
            hint = f"did you mean {near[0]}? " if near else ""
            raise self.error(key, f"{hint}it must be one of {', '.join(kind)}") from None

    def table(self, key: str, *, required: bool = False) -> Table:
        """Take a sub-table; an empty one where it is not given."""
        value = self._take(key, MISSING if required else {}, "a table")
        if not isinstance(value, dict):
            raise self.error(key, "must be a table")
        return Table(value, self.file, f"{self.path}.{key}" if self.path else key)

    def matrix(self, key: str, size: int) -> Sequence[Sequence[float]]:
        """Take a square matrix of finite numbers."""
        value = self._take(key, MISSING, f"a {size} x {size} matrix")
        if (
            not isinstance(value, list)
            or len(value) != size
            or any(not isinstance(r, list) or len(r) != size for r in value)
        ):
            raise self.error(key, f"must be a {size} x {size} matrix (a list of {size} lists of {size} numbers)")
        return [[self.checked(key, v) for v in row] for row in value]
