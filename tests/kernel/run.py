"""`make test-kernel`: the tests that need real kernel devices, in a virtual machine; ends with their exit status.

Where the machine cannot be had, it says so, not to be overlooked, and ends with 0.
"""

import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from drivers.replay import ReplayGrabber
from service.demo import demo_video
from tests.kernel.vm import UnavailableError, boot

HERE = Path(__file__).parent
GUEST_S, HOST_S = 900, 240
PICTURES = 10
PYTEST = ["-m", "pytest", "-p", "no:cacheprovider", "--color=no", "--tb=short", "-v", "--durations=12"]


def put_pictures(exchange: Path):
    """Leave the beginning of the demonstration video for the guest to play: no need to decode it in an emulation."""
    with ReplayGrabber(demo_video(), speed=math.inf) as replay:
        replay.start()
        np.save(exchange / "pictures.npy", np.stack([replay.read(1.0).pixels for _ in range(PICTURES)]))


def run(guest_files: list[str], exchange: Path) -> int:
    """Run tests in the guest, and then those of what it brought back; gives an exit status.

    Raises
    ------
    UnavailableError
        There can be no guest here.
    """
    put_pictures(exchange)
    try:
        status = boot([sys.executable, *PYTEST, *guest_files], exchange, GUEST_S)
    except TimeoutError as error:
        print(f"kernel tests FAILED: {error}")
        return 1
    if (exchange / "caught.npy").exists():
        host_files = sorted(map(str, HERE.glob("host_*.py")))
        told = os.environ | {"BOWLSIGHT_EXCHANGE": str(exchange)}
        command = [sys.executable, *PYTEST, *host_files]
        status = subprocess.run(command, env=told, timeout=HOST_S, check=False).returncode or status
    return status


def main(arguments: list[str]) -> int:
    began = time.monotonic()
    guest_files = arguments or sorted(map(str, HERE.glob("guest_*.py")))
    with tempfile.TemporaryDirectory(prefix="bowlsight-kernel-") as folder:
        try:
            status = run(guest_files, Path(folder))
        except UnavailableError as error:
            print(f"{'!' * 120}\nkernel tests did NOT run: {error}\n{'!' * 120}", flush=True)
            return 0
        figures = Path(folder) / "figures"
        print(figures.read_text() if figures.exists() else "", end="")
    verdict = "passed" if status == 0 else "FAILED"
    print(f"kernel tests {verdict} after {time.monotonic() - began:.0f} s", flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
