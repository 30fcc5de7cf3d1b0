"""Compiled kernels as every run finds them: made beforehand, by a process of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

from numba.core.registry import CPUDispatcher

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["compile_apart"]

WARM_UP = "import time; from service.vision.process import warm_up; warm_up(time.perf_counter_ns)"


def compile_apart() -> None:
    """Compile what is not compiled yet, in another process, so that this one loads all of it.

    What numba has just compiled calls other kernels where they were compiled by themselves, what it loads calls the
    copies that were optimised along with it: equal but for the last digits, which a session measured again must have
    in common with what was recorded. Where that process fails, the kernels are compiled here.
    """
    if any(_is_missing(kernel) for kernel in _kernels()):
        subprocess.run(  # noqa: S603 - ourselves
            [sys.executable, "-c", WARM_UP],
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )


def _kernels() -> Iterator[Any]:
    modules = [module for name, module in sys.modules.items() if name.startswith("service.vision.")]
    for module in modules:
        for value in vars(module).values():
            if isinstance(value, CPUDispatcher) and value.py_func.__module__ == module.__name__:
                yield value


def _is_missing(kernel: Any) -> bool:
    """Whether nothing of a kernel is kept that is as new as its source."""
    return not kernel._cache._cache_file._load_index()  # noqa: SLF001 - numba says it nowhere else before compiling
