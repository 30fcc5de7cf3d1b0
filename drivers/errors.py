"""What can go wrong with a device or a recording.

::

    DeviceError                    something about one device
    ├── DeviceNotFoundError        nothing answers to that name, path or identity
    ├── DeviceBusyError            somebody else holds it
    ├── DevicePermissionError      this user may not open it
    ├── DeviceStateError           the call does not fit the device's state (read before start)
    ├── DeviceDisconnectedError    it was there and is gone; reopening may find it again
    ├── DeviceTimeoutError         nothing arrived in time; also a TimeoutError
    ├── DeviceProtocolError        it answered something that its protocol does not allow
    └── UnsupportedFormatError     it offers nothing that this driver can read
    EndOfRecordingError            a recording was played to its end: no failure
    ConfigError                    a setting is missing, unknown or impossible
    CalibrationError               points or camera data do not determine what was asked

Every message is one line that names the device, file or key, the value and the remedy.
"""

from __future__ import annotations

__all__ = [
    "CalibrationError",
    "ConfigError",
    "DeviceBusyError",
    "DeviceDisconnectedError",
    "DeviceError",
    "DeviceNotFoundError",
    "DevicePermissionError",
    "DeviceProtocolError",
    "DeviceStateError",
    "DeviceTimeoutError",
    "EndOfRecordingError",
    "UnsupportedFormatError",
]


class DeviceError(Exception):
    """A failure of one device; `device` names it. Raise a subclass where one fits."""

    def __init__(self, device: str, message: str) -> None:
        super().__init__(f"{device}: {message}")
        self.device = device
        self.message = message

    def __reduce__(self) -> tuple[type[DeviceError], tuple[str, str]]:
        return type(self), (self.device, self.message)


class DeviceNotFoundError(DeviceError):
    """Nothing answers to that name, path or identity. Raised by `open` only."""


class DeviceBusyError(DeviceError):
    """Somebody else holds the device."""


class DevicePermissionError(DeviceError):
    """The device is there but this user may not open it; the message names the group or rule that helps."""


class DeviceStateError(DeviceError):
    """The call does not fit the device's state, such as `read` before `start`. A mistake of the caller."""


class DeviceDisconnectedError(DeviceError):
    """The device was there and is gone (unplugged, broken off). Close it; a later `open` may find it again."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """No frame or answer in the time allowed. The device stays usable: the call may be repeated."""


class DeviceProtocolError(DeviceError):
    """The device answered something that its protocol does not allow."""


class UnsupportedFormatError(DeviceError):
    """The device or file offers no picture format that this driver can read."""


class EndOfRecordingError(Exception):
    """A recording was played to its end. Not a failure, and not a `DeviceError`."""


class ConfigError(ValueError):
    """A setting is missing, unknown or impossible; the message names file, key, value and remedy."""


class CalibrationError(ValueError):
    """The points or camera data given do not determine what was asked."""
