"""What tests in the guest share: vivid, the kernel's own test driver, and its levers."""

import contextlib
import os
import subprocess
import time
from pathlib import Path

import pytest

from drivers.errors import DeviceNotFoundError
from drivers.identity import find_video_nodes
from drivers.v4l2 import calls
from drivers.v4l2.calls import LinuxCalls, Node
from drivers.v4l2.constants import ControlFlag, FieldOrder, StandardBits, fourcc
from drivers.v4l2.controls import SETTINGS
from drivers.v4l2.grabber import V4l2Grabber

VIVID = "path-platform-vivid.0"
BOARD = "n_devs=1 num_inputs=4 input_types=0xEA num_outputs=2 output_types=0x02 node_types=0x101"
"""Three S-Video inputs and an HDMI one, as outputs an S-Video and an HDMI one: a board with a switch."""
BIND = Path("/sys/bus/platform/drivers/vivid")


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
