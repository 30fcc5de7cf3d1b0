"""Take a picture of the viewer showing a recording, without a screen.

    bowlsight demo --save demo.rrd            (stop it with Ctrl-C after ten seconds or so)
    python tests/browser/make_screenshot.py demo.rrd docs/viewer.png [--at 8.0] [--size 1600x900]

Needs a Vulkan driver; Debian's mesa-vulkan-drivers brings one that draws in software. The recording carries its layout,
so the picture is what an operator sees.
"""

import argparse
import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from rerun.experimental import ViewerClient

from service.sinks.viewer_drawing import TIME
from service.sinks.viewer_page import rerun_program

PATIENCE_S = 60.0
SETTLE_S = 3.0
MARGIN_PX = 10


@contextlib.contextmanager
def headless_viewer(recording: Path, size: str) -> Iterator[ViewerClient]:
    """A viewer without a window that shows the recording."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    command = [
        str(rerun_program()), "--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size", size,
        str(recording),
    ]  # fmt: skip
    quiet = os.environ | {"CI": "1", "RUST_LOG": "off"}
    with subprocess.Popen(command, env=quiet, stderr=subprocess.DEVNULL) as process:
        try:
            yield connect(port, process)
        finally:
            process.kill()


def connect(port: int, process: subprocess.Popen[bytes]) -> ViewerClient:
    """Wait until the viewer has read the whole recording."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(RuntimeError, ConnectionError):
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            state = client.get_state()
            if state.recordings and state.recordings[0].timelines and not state.loading:
                return client
        time.sleep(0.2)
    sys.exit("the viewer did not come up: is a Vulkan driver installed (Debian: mesa-vulkan-drivers)?")


def take_screenshot(recording: Path, out: Path, size: str, at_s: float | None = None) -> None:
    """Write a PNG of the viewer with the recording at `at_s`, or at its end."""
    with headless_viewer(recording, size) as client:
        if at_s is not None:
            client.set_time(TIME, duration=at_s, play_state="paused")
        time.sleep(SETTLE_S)
        client.save_screenshot(str(out.resolve()))
    picture = cv2.imread(str(out))
    written = picture.max(axis=(1, 2)) > 150
    cv2.imwrite(str(out), picture[max(0, int(np.argmax(written)) - MARGIN_PX) :])  # without a window's empty title bar


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--at", type=float, help="seconds of the recording; its end where left out")
    parser.add_argument("--size", default="1600x900")
    arguments = parser.parse_args()
    if not arguments.recording.is_file():
        sys.exit(f"{arguments.recording}: no such recording; bowlsight demo --save makes one")
    take_screenshot(arguments.recording, arguments.out, arguments.size, arguments.at)


if __name__ == "__main__":
    main()
