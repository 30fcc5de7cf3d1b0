"""A backend of pyusb's with devices that do what real ones were seen to do: stall, hang, lag, break off and go."""

import errno
import os
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import usb.backend
import usb.core

from drivers.uvc.grabber import UvcGrabber
from tests.drivers.tree import put, usb_device
from tests.fakes.uvc import PACKET_BYTES, FakeUvcDevice, StallError

HELD_FRAMES = 2
"""Of those that nobody reads, as many as the device keeps; later ones it drops and does not count."""


def failure(number: int) -> usb.core.USBError:
    return usb.core.USBError(os.strerror(number), -1, number)


@dataclass(eq=False)
class Plugged:
    """A device on the bus, and what befalls it."""

    device: FakeUvcDevice
    bus: int = 1
    address: int = 4
    events: dict = field(default_factory=dict)
    """By frame number: stall, hang (no data until it is begun anew), gone, lost (never sent nor counted)."""
    refusal: int = 0
    """The errno with which it cannot be opened."""
    claim_refusal: int = 0
    reset_refusal: int = 0

    def __post_init__(self):
        self.gone = self.halted = self.hung = False
        self.began_ns = None
        self.ticks = 0
        self.queue: deque[bytes] = deque()
        self.handles = self.claimed = self.resets = 0
        self.alternates = {}

    def begin(self, now_ns: int):
        self.began_ns, self.ticks, self.hung = now_ns, 0, False
        self.queue.clear()

    def end(self):
        self.began_ns = None

    def next_ns(self) -> int | None:
        if self.began_ns is None or self.hung or self.halted or self.gone:
            return None
        return self.began_ns + (self.ticks + 1) * self.device.period_ns

    def catch_up(self, now_ns: int):
        while (due_ns := self.next_ns()) is not None and due_ns <= now_ns:
            number, self.ticks = self.ticks, self.ticks + 1
            event = self.events.pop(number, None)
            self.halted, self.hung, self.gone = event == "stall", event == "hang", event == "gone"
            held = sum(1 for payload in self.queue if len(payload) > 1 and payload[1] & 2)
            if event is None and held < HELD_FRAMES:
                self.queue.extend(self.device.payloads(number, due_ns - 1_000_000, due_ns))


class FakeUsb(usb.backend.IBackend):
    """The bus.

    Parameters
    ----------
    clock
        A ManualClock: waiting moves it.
    plugged
        What is plugged in.
    """

    def __init__(self, clock, plugged: list[Plugged]):
        self.clock, self.plugged = clock, plugged

    # -- descriptors ---------------------------------------------------------------------------------------------------

    def enumerate_devices(self):
        return iter([p for p in self.plugged if not p.gone])

    def get_parent(self, dev):
        return None

    def get_device_descriptor(self, dev):
        names = (
            "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 idVendor"
            " idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations"
        )
        told = dict.fromkeys(names.split(), 1)
        place = {"address": dev.address, "bus": dev.bus, "port_number": 1, "port_numbers": (1,), "speed": 3}
        return SimpleNamespace(**told, **place)

    def get_configuration_descriptor(self, dev, config):
        if config:
            raise IndexError
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=0, bNumInterfaces=2, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0x80, bMaxPower=250, extra_descriptors=[],
        )  # fmt: skip

    def _settings(self, dev):
        number = dev.device.alternate or (0 if dev.device.bulk else 1)
        return {0: [0], 1: sorted({0, number})}, number

    def get_interface_descriptor(self, dev, intf, alt, config):
        settings, number = self._settings(dev)
        if intf not in settings or alt >= len(settings[intf]):
            raise IndexError
        chosen = settings[intf][alt]
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=intf, bAlternateSetting=chosen,
            bNumEndpoints=int(intf == 1 and chosen == number), bInterfaceClass=0x0E, bInterfaceSubClass=intf + 1,
            bInterfaceProtocol=0, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=0x81, bmAttributes=2 if dev.device.bulk else 5,
            wMaxPacketSize=PACKET_BYTES, bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    # -- devices -------------------------------------------------------------------------------------------------------

    def _there(self, dev) -> Plugged:
        if dev.gone:
            raise failure(errno.ENODEV)
        return dev

    def open_device(self, dev):
        if self._there(dev).refusal:
            raise failure(dev.refusal)
        dev.handles += 1
        return dev

    def close_device(self, dev_handle):
        dev_handle.handles -= 1

    def get_configuration(self, dev_handle):
        return self._there(dev_handle) and 1

    def set_interface_altsetting(self, dev_handle, intf, altsetting):
        self._there(dev_handle).alternates[intf] = altsetting

    def claim_interface(self, dev_handle, intf):
        if self._there(dev_handle).claim_refusal:
            raise failure(dev_handle.claim_refusal)
        dev_handle.claimed += 1

    def release_interface(self, dev_handle, intf):
        dev_handle.claimed -= 1
        self._there(dev_handle)

    def clear_halt(self, dev_handle, ep):
        self._there(dev_handle).halted = False
        dev_handle.device.request(0x02, 1, 0, ep, 0, b"")
        dev_handle.end()

    def reset_device(self, dev_handle):
        self._there(dev_handle).resets += 1
        if dev_handle.reset_refusal:
            raise failure(dev_handle.reset_refusal)
        dev_handle.end()

    def ctrl_transfer(self, dev_handle, bmRequestType, bRequest, wValue, wIndex, data, timeout):
        device, before = self._there(dev_handle).device, dev_handle.device.commits
        try:
            answer = device.request(bmRequestType, bRequest, wValue, wIndex, len(data), data.tobytes())
        except StallError:
            raise failure(errno.EPIPE) from None
        except TimeoutError:
            self.clock.now_ns += timeout * 1_000_000
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT) from None
        if device.commits != before:
            dev_handle.begin(self.clock.now_ns)
        if not bmRequestType & 0x80:
            return len(data)
        data[: len(answer)] = type(data)("B", answer)
        return len(answer)

    def bulk_read(self, dev_handle, ep, intf, buff, timeout):
        deadline_ns = self.clock.now_ns + timeout * 1_000_000
        while True:
            self._there(dev_handle).catch_up(self.clock.now_ns)
            if dev_handle.halted:
                raise failure(errno.EPIPE)
            if dev_handle.queue:
                return self._send(dev_handle, buff)
            next_ns = dev_handle.next_ns()
            if next_ns is None or next_ns > deadline_ns:
                self.clock.now_ns = max(self.clock.now_ns, deadline_ns)
                self._there(dev_handle)
                raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
            self.clock.now_ns = next_ns

    def _send(self, dev_handle, buff) -> int:
        payload = dev_handle.queue.popleft()
        assert len(buff) % PACKET_BYTES == 0, "a packet may not be cut"
        now, later = payload[: len(buff)], payload[len(buff) :]
        full = len(payload) % PACKET_BYTES == 0 and 0 < len(payload) < dev_handle.device.payload_bytes
        if later or (full and len(now) == len(buff)):
            dev_handle.queue.appendleft(later)
        buff[: len(now)] = type(buff)("B", now)
        return len(now)


def plug_in(sysfs: Path, plugged: Plugged, *, port="1-2", driver="") -> Path:
    """Show a device in the system's tree; gives its folder."""
    folder = usb_device(sysfs, port, vendor="1209", product="0001", serial=plugged.device.serial)
    put(folder, busnum=str(plugged.bus), devnum=str(plugged.address), manufacturer="Lab", product="Fake UVC grabber")
    (folder / "descriptors").write_bytes(plugged.device.device_descriptor() + plugged.device.configuration_descriptor())
    for number, subclass in ((0, "01"), (1, "02")):
        interface = put(folder / f"{port}:1.{number}", bInterfaceClass="0e", bInterfaceSubClass=subclass)
        if driver:
            put(sysfs / "bus/usb/drivers" / driver)
            (interface / "driver").symlink_to(sysfs / "bus/usb/drivers" / driver)
    links = put(sysfs / "bus/usb/devices")
    if not (links / port).exists():
        (links / port).symlink_to(folder)
    return folder


def fake_uvc_grabber(clock, sysfs: Path, *, events=None, grabber=None, driver="", **device):
    """A grabber on a fake device, and that device as it is plugged in; `grabber` holds its own arguments."""
    plugged = Plugged(FakeUvcDevice(**device), events=events or {})
    plug_in(sysfs, plugged, driver=driver)
    serial = plugged.device.serial
    identity = f"usb-1209:0001-{serial}" if serial else "path-pci-0000:00:14.0-usb-0:2"
    backend = FakeUsb(clock, [plugged])
    return UvcGrabber(identity, backend=backend, sysfs=sysfs, clock=clock, **(grabber or {})), plugged
