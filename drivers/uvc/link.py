"""An open USB device: requests and bulk reads, through pyusb, with every failure told."""

from __future__ import annotations

import array
import contextlib
import errno
import math
from typing import TYPE_CHECKING, Any, Final

import usb.core
import usb.util

from drivers.errors import DeviceBusyError, DeviceError, DeviceNotFoundError, DeviceTimeoutError
from drivers.failures import device_error
from drivers.identity import find_usb_devices, usb_video_devices

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from drivers.identity import UsbDevice

__all__ = ["UsbLink", "open_link", "reset_usb_device", "the_usb_device"]

REQUEST_MS: Final = 1000
SET_CUR, GET_CUR = 0x01, 0x81
TO_INTERFACE, FROM_INTERFACE = 0x21, 0xA1
FROM_DEVICE, GET_DESCRIPTOR, CONFIGURATION = 0x80, 0x06, 0x0200
MOST_DESCRIPTOR_BYTES: Final = 0xFFFF
CAME_BACK_AS_ANOTHER: Final = frozenset({errno.ENOENT, errno.ENODEV})


@contextlib.contextmanager
def usb_told(device: str, doing: str, node: str) -> Iterator[None]:
    """Turn what pyusb raises within the block into a DeviceError."""
    try:
        yield
    except DeviceError:  # DeviceTimeoutError is an OSError too
        raise
    except usb.core.NoBackendError as error:
        raise DeviceNotFoundError(
            device, "cannot be looked for: libusb is not installed (Debian package libusb-1.0-0)"
        ) from error
    except usb.core.USBTimeoutError as error:
        raise DeviceTimeoutError(device, f"{doing}: it does not answer") from error
    except OSError as error:  # pyusb's own errors are such
        raise device_error(device, doing, node, error) from error


class UsbLink:
    """An open USB device.

    Parameters
    ----------
    device
        pyusb's.
    name
        What errors call it.
    node
        Its device node.
    """

    def __init__(self, device: Any, name: str, node: str) -> None:
        self._device, self.name, self.node = device, name, node
        self._buffer = array.array("B")

    def told(self, doing: str) -> contextlib.AbstractContextManager[None]:
        """Turn what pyusb raises within the block into a DeviceError."""
        return usb_told(self.name, doing, self.node)

    def configuration(self) -> bytes:
        """Give the descriptor of the configuration in use."""
        with self.told("cannot be asked what it is"):
            index = self._device.get_active_configuration().index
            head = self._descriptor(index, 9)
            length = int.from_bytes(head[2:4], "little") if len(head) >= 4 else 0
            return self._descriptor(index, length) if length else head

    def _descriptor(self, index: int, length: int) -> bytes:
        told = self._device.ctrl_transfer(
            FROM_DEVICE, GET_DESCRIPTOR, CONFIGURATION | index, 0, min(length, MOST_DESCRIPTOR_BYTES), REQUEST_MS
        )
        return bytes(told)

    def get(self, selector: int, interface: int, length: int, *, entity: int = 0, request: int = GET_CUR) -> bytes:
        """Read a class control of an interface or of a unit in it; the interface is claimed."""
        return bytes(
            self._device.ctrl_transfer(
                FROM_INTERFACE, request, selector << 8, entity << 8 | interface, length, REQUEST_MS
            )
        )

    def set(self, selector: int, interface: int, data: bytes, *, entity: int = 0) -> None:
        """Write a class control."""
        self._device.ctrl_transfer(TO_INTERFACE, SET_CUR, selector << 8, entity << 8 | interface, data, REQUEST_MS)

    def set_alternate(self, interface: int, number: int) -> None:
        """Switch an interface to one of its settings."""
        self._device.set_interface_altsetting(interface, number)

    def clear_halt(self, endpoint: int) -> None:
        """Set an endpoint back: it begins anew."""
        self._device.clear_halt(endpoint)

    def read(self, endpoint: int, size: int, timeout_s: float) -> bytes | None:
        """Read at most `size` bytes; None where nothing came within `timeout_s`."""
        if len(self._buffer) != size:
            self._buffer = array.array("B", bytes(size))
        try:
            count = self._device.read(endpoint, self._buffer, max(1, math.ceil(timeout_s * 1000)))
        except usb.core.USBTimeoutError:
            return None
        return bytes(memoryview(self._buffer)[:count])

    def reset(self) -> None:
        """Reset the device on its bus; it may come back as another one, which is what was wanted."""
        try:
            self._device.reset()
        except OSError as error:
            if error.errno not in CAME_BACK_AS_ANOTHER:
                raise

    def close(self) -> None:
        """Let go of it; nothing is raised for a device that is gone."""
        with contextlib.suppress(OSError):
            usb.util.dispose_resources(self._device)


def the_usb_device(identity: str, name: str, sysfs: Path) -> UsbDevice:
    """Find the one USB video device with an identity; raises DeviceNotFoundError."""
    found = find_usb_devices(identity.partition("#")[0], sysfs)
    if not found:
        there = ", ".join(d.identity for d in usb_video_devices(sysfs)) or "no USB video device at all"
        raise DeviceNotFoundError(name, f"is not there; there is {there}")
    if len(found) > 1:
        places = " or ".join(d.place for d in found)
        raise DeviceNotFoundError(name, f"is not the only one with that number; name its place: {places}")
    return found[0]


def open_link(seen: UsbDevice, name: str, backend: Any | None) -> UsbLink:
    """Open a USB device that the system shows.

    Raises
    ------
    DeviceBusyError
        One of the kernel's drivers serves it.
    DeviceNotFoundError
        libusb is missing, or does not see it.
    """
    if seen.kernel_driver:
        raise DeviceBusyError(
            name, f'is served by the kernel\'s {seen.kernel_driver}; set device = "v4l2:{seen.identity}"'
        )
    return UsbLink(_device_of(seen, name, backend), name, seen.node)


def _device_of(seen: UsbDevice, name: str, backend: Any | None) -> Any:
    bus, address = seen.bus_and_address
    with usb_told(name, "cannot be looked for", seen.node):
        device = usb.core.find(backend=backend, bus=bus, address=address)
    if device is None:
        raise DeviceNotFoundError(
            name, f"the system shows it at {seen.node}, libusb does not yet; try again, or plug it in anew"
        )
    return device


def reset_usb_device(identity: str, name: str, sysfs: Path, backend: Any | None = None) -> None:
    """Reset a USB device on its bus, whoever has it open: the last resort, as good as a replug.

    Raises
    ------
    DeviceError
        It is not there, may not be opened, or does not answer even to that.
    """
    seen = the_usb_device(identity, name, sysfs)
    link = UsbLink(_device_of(seen, name, backend), name, seen.node)
    try:
        with link.told("cannot be reset"):
            link.reset()
    finally:
        link.close()
