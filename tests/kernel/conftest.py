"""What tests in the guest share: vivid, the kernel's own test driver, and its levers; a USB grabber to plug in."""

import contextlib
import gc
import os
import subprocess
import threading
import time
from pathlib import Path

import pytest

from drivers.errors import DeviceDisconnectedError, DeviceNotFoundError
from drivers.identity import find_usb_devices, find_video_nodes
from drivers.v4l2 import calls
from drivers.v4l2.calls import LinuxCalls, Node
from drivers.v4l2.constants import ControlFlag, FieldOrder, StandardBits, fourcc
from drivers.v4l2.controls import SETTINGS
from drivers.v4l2.grabber import V4l2Grabber
from tests.fakes.uvc import FakeUvcDevice, numbered
from tests.kernel.usbip import Plug

VIVID = "path-platform-vivid.0"
BOARD = "n_devs=1 num_inputs=4 input_types=0xEA num_outputs=2 output_types=0x02 node_types=0x101"
"""Three S-Video inputs and an HDMI one, as outputs an S-Video and an HDMI one: a board with a switch."""
BIND = Path("/sys/bus/platform/drivers/vivid")
USB = "usb-1209:0001-SN1"


@pytest.fixture(scope="session")
def exchange() -> Path:
    """Folder that host and guest both see."""
    if "BOWLSIGHT_EXCHANGE" not in os.environ:
        pytest.fail("this test belongs to `make test-kernel`")
    return Path(os.environ["BOWLSIGHT_EXCHANGE"])


@pytest.fixture(scope="session")
def udev(exchange):
    """The daemon that gives nodes their groups and links, with the rule that is shipped."""
    rules = Path("/etc/udev/rules.d")
    rules.mkdir(parents=True, exist_ok=True)
    (rules / "70-bowlsight.rules").write_text(Path("config/deploy/70-bowlsight.rules").read_text())
    subprocess.run(["/lib/systemd/systemd-udevd", "--daemon"], check=True, timeout=30)
    yield
    subprocess.run(["udevadm", "control", "--exit"], check=False, timeout=30)


def settled(there, what: str, seconds: float = 20.0):
    """Wait until something holds; gives what `there` gave."""
    deadline = time.monotonic() + seconds
    while not (found := there()):
        assert time.monotonic() < deadline, f"{what} within {seconds:g} s"
        time.sleep(0.02)
    return found


class Vivid:
    """The board, and what can be done to it behind the grabber's back."""

    def nodes(self) -> list[str]:
        return [n.node for n in find_video_nodes(VIVID)]

    @contextlib.contextmanager
    def lever(self):
        node = Node.open(LinuxCalls(), self.nodes()[0])
        try:
            yield node
        finally:
            node.close()

    def set(self, name: str, value: int = 1):
        """Set a control, or press a button, by its name."""
        with self.lever() as node:
            found = {calls.text(c.name): c for c in calls.controls(node)}
            calls.set_control(node, found[name].id, value)

    def reset(self):
        """Set every input to its first standard or timings, every control to its default."""
        with self.lever() as node:
            for told in calls.inputs(node):
                calls.select_input(node, told.index)
                if told.std:
                    calls.set_standard(node, StandardBits.PAL)
                self._to_defaults(node)
            calls.select_input(node, 0)
            calls.set_pix_format(node, (720, 576), fourcc("GREY"), FieldOrder.INTERLACED)

    def _to_defaults(self, node: Node):
        for control in calls.controls(node):
            if control.type in SETTINGS and not control.flags & (ControlFlag.READ_ONLY | ControlFlag.INACTIVE):
                calls.set_control(node, control.id, control.default_value)

    def unplug(self):
        (BIND / "unbind").write_text("vivid.0")

    def plug(self):
        (BIND / "bind").write_text("vivid.0")
        settled(lambda: len(self.nodes()) == 2, "the nodes are back")

    def grabber(self, **options) -> V4l2Grabber:
        return V4l2Grabber(VIVID, **({"encoding": "GREY"} | options))


@pytest.fixture(scope="session")
def board(udev) -> Vivid:
    """The board, plugged in; to load and unload it for each test would take most of the time."""
    subprocess.run(["modprobe", "vivid", *BOARD.split()], check=True, timeout=60)
    made = Vivid()
    settled(lambda: len(made.nodes()) == 2, "vivid's nodes are there")
    subprocess.run(["udevadm", "settle", "--timeout=20"], check=True, timeout=30)
    return made


@pytest.fixture
def vivid(board) -> Vivid:
    """The board as it comes out of the box, but for its picture, which shows no clock."""
    board.reset()
    board.set("OSD Text Mode", 2)
    return board


@pytest.fixture
def grabber(vivid):
    """A grabber on it, closed."""
    made = vivid.grabber()
    yield made
    made.close()


class UsbSocket:
    """A socket of a USB grabber, and what can be done to it.

    Parameters
    ----------
    driven
        Whether the kernel's uvcvideo is to serve it.
    """

    def __init__(self, *, driven: bool, **device):
        usual = {"sizes": ((160, 120), (320, 240)), "intervals": (1_000_000, 2_000_000), "picture": numbered}
        self.device, self.driven = FakeUvcDevice(**(usual | device)), driven
        self.plugged: Plug | None = None

    def plug(self):
        self.plugged = Plug(self.device).attach()
        settled(lambda: self.driven == bool(find_video_nodes(USB)) and find_usb_devices(USB), "it is there")

    def unplug(self):
        if self.plugged is not None:
            self.plugged.unplug()
            self.plugged = None
            settled(lambda: not find_usb_devices(USB), "it is out")

    def restore(self):
        """Give it back as it comes out of the box."""
        if self.plugged is None:
            subprocess.run(["modprobe", *([] if self.driven else ["-r"]), "uvcvideo"], check=True, timeout=60)
            self.plug()
            subprocess.run(["udevadm", "settle", "--timeout=20"], check=True, timeout=30)
        self.device.faults.clear()
        self.device.channel = 1
        self.plugged.halted = self.plugged.hung = False


class UsbBus:
    """The bus with its one socket: plugging takes time, so what is in it stays there until another is wanted."""

    def __init__(self):
        self._kind, self._socket = None, None

    def socket(self, **kind) -> UsbSocket:
        if kind != self._kind:
            self.close()
            self._kind, self._socket = kind, UsbSocket(**kind)
        self._socket.restore()
        return self._socket

    def close(self):
        if self._socket is not None:
            self._socket.unplug()


@pytest.fixture(scope="session")
def usb_bus(udev):
    """A USB host controller that is software; the kernel's driver for USB video is loaded where a test asks for it."""
    Path("/etc/modprobe.d/bowlsight.conf").write_text("blacklist uvcvideo\n")
    subprocess.run(["modprobe", "vhci-hcd"], check=True, timeout=60)
    bus = UsbBus()
    yield bus
    bus.close()


@pytest.fixture
def usb_socket(usb_bus):
    """A USB grabber with four inputs that uvcvideo serves."""
    return usb_bus.socket(driven=True)


@pytest.fixture
def bare_socket(usb_bus):
    """The same one, which no kernel driver serves."""
    return usb_bus.socket(driven=False)


@pytest.fixture
def measured(request, exchange):
    """Note a figure that the host prints at the end; on an emulated machine it is an upper bound."""

    def note(text: str):
        with (exchange / "figures").open("a") as figures:
            figures.write(f"{request.node.name}: {text}\n")

    return note


def reopened(grabber, seconds: float = 20.0):
    """Open a grabber again once its device is back."""

    def attempt():
        try:
            return grabber.open()
        except DeviceNotFoundError:
            return None

    return settled(attempt, "the device is back", seconds)


def streaming(grabber):
    """Open it, start it, and read its first frame."""
    grabber.open().start()
    grabber.read(10.0)
    return grabber


def read_until(grabber, error, seconds: float = 20.0):
    """Read on until an error is raised."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        try:
            grabber.read(1.0)
        except error:
            return
    pytest.fail(f"no {error} within {seconds:g} s")


def left_open() -> tuple[int, int, int]:
    """How many descriptors and threads this process has, and bytes of memory."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return len(list(Path("/proc/self/fd").iterdir())), threading.active_count(), pages * 4096


def replugged(grabber, unplug, plug, times: int) -> int:
    """Pull it out many times while it streams; gives how much memory that left behind. Nothing else may be."""

    def round_():
        reopened(grabber).start().read(10.0)
        unplug()
        read_until(grabber, DeviceDisconnectedError)
        grabber.close()
        plug()

    for _ in range(3):
        round_()
    descriptors, threads, memory = left_open()
    for _ in range(times):
        round_()
    found = left_open()
    assert found[:2] == (descriptors, threads)
    assert reopened(grabber).grab(10.0).generation == grabber.generation
    grabber.close()
    return found[2] - memory
