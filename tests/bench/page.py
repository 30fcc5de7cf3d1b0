"""From the camera to the operator's page: how old a picture is when it is drawn, and what pages cost the measuring.

    python -m tests.bench.page [SECONDS]

The service runs as its users start it: a simulated 640x480 camera at 30 frames a second, measured in full. First with
nobody watching; then with one page in a headless Chromium, whose own clock, set by the service's, says how long after
its exposure each picture was drawn; then with ten more pages, which take and receipt every message but draw nothing.
"""

import asyncio
import json
import os
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from websockets.asyncio.client import connect

from tests.browser.chromium import Chromium, program

STATION = '[source]\ndevice = "simulated:model-f?size=640x480&rate_hz=30"\n[generator]\nname = "model-f"\n'
SETTLE_S = 4.0
PAGES = 10


class Service:
    """The command, until the end of the block; then `summary` is what it printed."""

    def __init__(self, folder: Path) -> None:
        self._station = folder / "station.toml"
        self._station.write_text(STATION)

    def __enter__(self):
        code = "import sys; from service.cli import main; sys.exit(main())"
        command = [sys.executable, "-c", code, "run", "--config", str(self._station), "--no-viewer"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for line in self._process.stdout:
            if line.startswith("operator's page: "):
                self.url = line.split()[-1]
                break
        time.sleep(SETTLE_S)
        self._began = time.monotonic(), self._cpu_s()
        return self

    def _cpu_s(self) -> float:
        """What the process has computed so far, s."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def __exit__(self, *_):
        self._cores = (self._cpu_s() - self._began[1]) / (time.monotonic() - self._began[0])
        self._process.send_signal(signal.SIGINT)
        self.summary = self._process.communicate(timeout=30)[0]

    def timing(self) -> str:
        """Of the measuring, from the summary."""
        processed = re.search(r"([\d,]+) delivered = ([\d,]+) processed", self.summary)
        timing = re.search(r"latency p50 ([\d.]+) ms, p99 ([\d.]+) ms", self.summary)
        share = int(processed[2].replace(",", "")) / int(processed[1].replace(",", ""))
        within = f"p50 {timing[1]} ms, p99 {timing[2]} ms; {self._cores:.2f} cores"
        return f"measured {100 * share:5.1f} % of the frames, {within}"


async def watch(url: str, seconds: float) -> list[float]:
    """Be a page that draws nothing; ages of the pictures as they came, ms."""
    ages, number, end_s = [], 0, time.monotonic() + seconds
    address = url.replace("http", "ws") + "live"
    async with connect(address, origin=url.rstrip("/"), max_size=None, compression=None) as line:
        while time.monotonic() < end_s:
            message = await line.recv()
            if isinstance(message, bytes):
                number += 1
                await line.send(json.dumps({"seen": number}))
                head = json.loads(message[4 : 4 + struct.unpack("<I", message[:4])[0]])
                ages.append(time.monotonic_ns() / 1e6 - head["grabbed_ms"])
    return ages


async def watch_all(url: str, seconds: float) -> np.ndarray:
    return np.concatenate(await asyncio.gather(*(watch(url, seconds) for _ in range(PAGES))))


def drawn(page, seconds: float) -> str:
    """What the page says of itself after so long."""
    page.wait("document.body.dataset.latencyP95")
    time.sleep(seconds)
    found = json.loads(page.run("JSON.stringify(document.body.dataset)"))
    rate = page.text("#rate")
    return f"p50 {float(found['latencyP50']):5.1f} ms, p95 {float(found['latencyP95']):5.1f} ms ({rate} grabbed)"


def main(seconds: float) -> None:
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as folder:
        with Service(Path(folder)) as service:
            time.sleep(seconds)
        print(f"{'nobody watches':34} {service.timing()}")
        if program() is not None:
            with Service(Path(folder)) as service, Chromium() as browser:
                print(f"{'camera to drawn page, Chromium':34} {drawn(browser.page(service.url), seconds)}", flush=True)
            print(f"{'one page in Chromium':34} {service.timing()}", flush=True)
        with Service(Path(folder)) as service:
            ages = asyncio.run(watch_all(service.url, seconds))
        p50, p95 = np.percentile(ages, [50, 95])
        rate = len(ages) / seconds / PAGES
        print(f"{f'camera to {PAGES} pages':34} p50 {p50:5.1f} ms, p95 {p95:5.1f} ms ({rate:.1f}/s each)")
        print(f"{f'{PAGES} pages':34} {service.timing()}")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 15.0)
