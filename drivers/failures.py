"""The kernel's error numbers as errors that say what to do."""

from __future__ import annotations

import contextlib
import errno
from typing import TYPE_CHECKING, Final

from drivers.access import holders, how_to_permit
from drivers.errors import (
    DeviceBusyError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceNotFoundError,
    DevicePermissionError,
    DeviceProtocolError,
    UnsupportedFormatError,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["device_error", "gone", "told"]

GONE: Final = frozenset({errno.ENODEV, errno.ENXIO, errno.ESHUTDOWN})


def _absent(node: str) -> str:
    return f"there is no {node}; bowlsight devices lists what there is"


def _forbidden(node: str) -> str:
    return f"may not be opened by this user; {how_to_permit(node)}"


def _held(node: str) -> str:
    return f"it is in use by {', '.join(map(str, holders(node))) or 'another program'}"


def _no_bandwidth(node: str) -> str:
    return f"the USB bus of {node} has no bandwidth left; use another port or a smaller size"


OPENING: Final[dict[int, tuple[type[DeviceError], Callable[[str], str]]]] = {
    errno.ENOENT: (DeviceNotFoundError, _absent),
    errno.ENOTDIR: (DeviceNotFoundError, _absent),
    errno.EACCES: (DevicePermissionError, _forbidden),
    errno.EPERM: (DevicePermissionError, _forbidden),
}
BUSY: Final[dict[int, Callable[[str], str]]] = {errno.EBUSY: _held, errno.ENOSPC: _no_bandwidth}


@contextlib.contextmanager
def told(device: str, doing: str, node: str) -> Iterator[None]:
    """Turn what system calls raise within the block into a DeviceError."""
    try:
        yield
    except DeviceError:  # DeviceTimeoutError is an OSError too
        raise
    except OSError as error:
        raise device_error(device, doing, node, error) from error


def gone(device: str) -> DeviceDisconnectedError:
    """Say that the device was there and is not any more."""
    return DeviceDisconnectedError(device, "is gone; was it unplugged? Plug it in, close it and open it again")


def device_error(device: str, doing: str, node: str, error: OSError) -> DeviceError:
    """Give the error for a system call's: `doing` says what it was for, as in 'cannot start'."""
    number = error.errno or 0
    if number in GONE:
        return gone(device)
    if number in OPENING:
        kind, words = OPENING[number]
        return kind(device, words(node))
    if number in BUSY:
        return DeviceBusyError(device, f"{doing}: {BUSY[number](node)}")
    if number == errno.ENOTTY:
        return UnsupportedFormatError(device, f"{doing}: {node} is no video capture device")
    return DeviceProtocolError(device, f"{doing}: {error.strerror} ({errno.errorcode.get(number, number)})")
