"""The inputs of a USB grabber, and the unit that switches between them."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final

from drivers.grabber import Input

if TYPE_CHECKING:
    from drivers.uvc.descriptors import VideoFunction

__all__ = ["INPUT_SELECT", "list_inputs"]

INPUT_SELECT: Final = 0x01
"""The selector unit's control (table A-11): a pin, counted from 1."""
TERMINALS: Final = {
    0x0201: ("Camera", "camera"),
    0x0401: ("Composite", "analogue"),
    0x0402: ("S-Video", "analogue"),
    0x0403: ("Component", "analogue"),
}
"""Names and kinds of input terminals (tables B-2 and B-3)."""


def list_inputs(function: VideoFunction) -> tuple[Input, ...]:
    """Give the inputs that the selector unit chooses from, in its order; none where it has no such unit.

    Inputs of one kind are numbered from 1; what is no terminal of a known type is an "Input".
    """
    kinds = [TERMINALS.get(function.terminals.get(pin, 0), ("Input", "camera")) for pin in function.pins]
    alike, seen = Counter(kinds), Counter[tuple[str, str]]()
    inputs = []
    for name, kind in kinds:
        seen[name, kind] += 1
        inputs.append(Input(f"{name} {seen[name, kind]}" if alike[name, kind] > 1 else name, kind))
    return tuple(inputs)
