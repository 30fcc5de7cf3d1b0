"""One place that decides how kernels are compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar, cast

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["compiled"]

F = TypeVar("F", bound="Callable[..., object]")


def compiled(function: F) -> F:
    """Compile a kernel with numba: cached on disk, releasing the interpreter lock.

    `fastmath` is limited to flags that keep NaN and infinity meaningful: a picture may hold neither, but a pose that
    diverged does, and must be seen to.
    """
    flags = {"contract", "reassoc", "arcp", "nsz"}
    return cast("F", numba.njit(cache=True, nogil=True, fastmath=flags, error_model="numpy")(function))
