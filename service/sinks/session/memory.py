"""What measuring remembers at one moment, kept exactly: a recording that begins in the midst of a watch begins with it.

Values are written as what they are made of: numbers to the last bit, arrays with their layout, objects of this program
by class and attributes. Nothing of a file is run when it is read, and no class but those of measuring is made.
"""

from __future__ import annotations

import collections
import dataclasses
import enum
import hashlib
import importlib
import io
import json
import zipfile
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from drivers.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

__all__ = ["Memory"]

VERSION: Final = 2
OURS: Final = ("service.vision.", "service.identity.", "service.alignment.", "service.config.", "drivers.frame")
PLAIN: Final = (bool, int, str, type(None))


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """Values as they were; later changes do not reach them.

    Attributes
    ----------
    tree
        What they are made of, JSON; arrays by their number. Empty: they could not be kept.
    arrays
        Copies.
    """

    tree: str
    arrays: Sequence[NDArray[Any]]

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Memory:
        """Keep values; raises TypeError where one is of a kind that cannot be."""
        arrays: list[NDArray[Any]] = []
        tree = _taken(dict(values), arrays)
        return cls(json.dumps({"version": VERSION, "values": tree}), arrays)

    @classmethod
    def none(cls) -> Memory:
        """What stands for values that could not be kept."""
        return cls("", ())

    def values(self) -> dict[str, Any]:
        """Make the values anew; raises ConfigError where that cannot be, for they are of another version."""
        try:
            read = json.loads(self.tree)
            made: dict[str, Any] = _made(read["values"], self.arrays) if read["version"] == VERSION else {}
        except (ValueError, KeyError, TypeError, AttributeError, ImportError, IndexError) as error:
            raise ConfigError(f"what was remembered cannot be read: {error}") from error
        if not made:
            raise ConfigError(f"what was remembered is of version {read['version']}, this Bowlsight reads {VERSION}")
        return made

    def to_bytes(self) -> bytes:
        """As a file holds it, a compressed .npz."""
        file = io.BytesIO()
        tree = np.frombuffer(self.tree.encode(), np.uint8)
        np.savez_compressed(file, tree, *self.arrays, allow_pickle=False)
        return file.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes) -> Memory:
        """Read it; raises ConfigError where it is none."""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                tree, *arrays = (file[f"arr_{i}"] for i in range(len(file.files)))
            return cls(tree.tobytes().decode(), arrays)
        except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise ConfigError(f"what was remembered cannot be read: {error}") from error

    @staticmethod
    def sha256(data: bytes) -> str:
        """The hash that the index has of the file."""
        return hashlib.sha256(data).hexdigest()


def _taken(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """A value as JSON; what is not JSON's own is an object with one key, its kind."""
    kind = type(value)
    if kind in PLAIN:
        return value
    if isinstance(value, enum.Enum):
        content: Any = "enum", [_class_name(kind), value.value]
    elif isinstance(value, np.ndarray | np.generic):
        content = _array_taken(value, arrays)
    elif kind is float:
        content = "float", value.hex()
    elif kind in (tuple, list):
        content = kind.__name__, [_taken(item, arrays) for item in value]
    elif kind is collections.deque:
        content = "deque", [[_taken(item, arrays) for item in value], value.maxlen]
    elif kind is dict:
        content = "dict", [[_taken(key, arrays), _taken(item, arrays)] for key, item in value.items()]
    else:
        attributes = {name: _taken(getattr(value, name), arrays) for name in _attributes(value)}
        content = "object", [_class_name(kind), attributes]
    return dict([content])


def _array_taken(value: NDArray[Any] | np.generic, arrays: list[NDArray[Any]]) -> tuple[str, Any]:
    arrays.append(np.array(value))
    if isinstance(value, np.generic):
        return "scalar", len(arrays) - 1
    if value.dtype.hasobject:
        raise TypeError("an array of objects")
    order = "C" if value.flags.c_contiguous else "F" if value.flags.f_contiguous else "gaps"
    return "array", [len(arrays) - 1, order, value.flags.writeable]


def _attributes(value: object) -> Sequence[str]:
    if dataclasses.is_dataclass(value):
        return [field.name for field in dataclasses.fields(value)]
    return list(vars(value))


def _class_name(kind: type) -> str:
    if not f"{kind.__module__}.".startswith(OURS):
        raise TypeError(f"a {kind.__module__}.{kind.__qualname__}")
    return f"{kind.__module__}:{kind.__qualname__}"


def _class_named(name: str) -> type:
    module, _, qualname = name.partition(":")
    if not f"{module}.".startswith(OURS):
        raise TypeError(f"a {name}")
    kind = getattr(importlib.import_module(module), qualname)
    if not isinstance(kind, type) or kind.__module__ != module:
        raise TypeError(f"a {name}")
    return kind


def _made(value: Any, arrays: Sequence[NDArray[Any]]) -> Any:
    if type(value) in PLAIN:
        return value
    ((kind, content),) = value.items()
    return MAKERS[kind](content, arrays)


def _object_made(content: Any, arrays: Sequence[NDArray[Any]]) -> object:
    name, attributes = content
    kind = _class_named(name)
    made: object = object.__new__(kind)
    if dataclasses.is_dataclass(kind) and set(attributes) != {field.name for field in dataclasses.fields(kind)}:
        raise TypeError(f"another {name}")
    for attribute, item in attributes.items():
        object.__setattr__(made, attribute, _made(item, arrays))
    return made


def _array_made(content: Any, arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """An array with the layout that it had: compiled kernels differ by it, and so might last digits."""
    number, order, writeable = content
    made: NDArray[Any]
    if order == "gaps":
        wide = np.zeros((*arrays[number].shape, 2), arrays[number].dtype)
        made = wide[..., 0]
        made[...] = arrays[number]
    else:
        made = np.array(arrays[number], order=order)
    made.flags.writeable = writeable
    return made


def _each(content: Any, arrays: Sequence[NDArray[Any]]) -> list[Any]:
    return [_made(item, arrays) for item in content]


MAKERS: Final[Mapping[str, Callable[[Any, Sequence[NDArray[Any]]], Any]]] = {
    "float": lambda content, _: float.fromhex(content),
    "enum": lambda content, _: _class_named(content[0])(content[1]),
    "scalar": lambda content, arrays: arrays[content][()],
    "array": _array_made,
    "tuple": lambda content, arrays: tuple(_each(content, arrays)),
    "list": _each,
    "deque": lambda content, arrays: collections.deque(_each(content[0], arrays), content[1]),
    "dict": lambda content, arrays: dict(_each(pair, arrays) for pair in content),
    "object": _object_made,
}
