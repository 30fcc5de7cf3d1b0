"""A bar that shows how far long work is."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from tqdm import tqdm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["progress"]


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on a terminal; yields what is told what goes on, how much of it is done, and how much there is."""
    tqdm.monitor_interval = 0  # no thread of its own
    with tqdm(disable=None, leave=False, unit_scale=True) as bar:
        shown = ""

        def show(what: str, done: int, total: int) -> None:
            nonlocal shown
            if what != shown:
                shown = what
                bar.reset(total)
                bar.set_description(what)
            bar.update(done - bar.n)

        yield show
