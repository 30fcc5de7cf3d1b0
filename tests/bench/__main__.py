"""Bowlsight beside its peers, and by itself: everything measured in one run, as Markdown.

    make bench
    python -m tests.bench [--quick] [--only SECTION ...]

One thread for OpenCV; numba's kernels have one by nature. EdgeDrawing is in opencv-contrib only: `make bench` puts that
OpenCV, which has everything else as well, in a folder of its own and before the other one.
"""

import argparse
import os
import platform
import sys
import time
from pathlib import Path

import cv2
import numba
import numpy as np

import service
from service.vision.process import warm_up
from tests.bench.live import service as live_service
from tests.bench.own import growth, specks, stages
from tests.bench.side_by_side import side_by_side

SHARED = Path(os.environ.get("BOWLSIGHT_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SECTIONS = {
    "peers": (
        "Side by side",
        """\
One thread each, in turns on the same pictures. Rim radius and pitch in the picture are told to OpenCV's finders.
Found: of the open tubes wholly in the picture, for Bowlsight the measured ones alone. False: finds a picture where no
tube is. Error: rms per axis against the true centre of the tube end.""",
    ),
    "stages": ("Cost per stage", "One thread, medians."),
    "growth": ("Growth with tubes and pixels", "Tracked, one thread."),
    "specks": ("Radiation specks", "Errors, rms; the pictures are the same but for the specks."),
    "service": (
        "The service",
        "Simulated grabber, two cores for all of it, from exposure to result. The viewer: rerun without a window.",
    ),
}


def main(argv: list[str] | None = None) -> None:
    arguments = argparse.ArgumentParser(prog="python -m tests.bench", description="Bowlsight beside its peers.")
    arguments.add_argument("--quick", action="store_true", help="a glance at everything: the figures mean nothing")
    arguments.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), metavar="SECTION")
    args = arguments.parse_args(argv)
    cv2.setNumThreads(1)
    warm_up(time.perf_counter_ns)
    shared = SHARED if (SHARED / "bowl").is_dir() else None
    work = {
        "peers": lambda: side_by_side(shared, quick=args.quick),
        "stages": lambda: stages(quick=args.quick),
        "growth": lambda: growth(quick=args.quick),
        "specks": lambda: specks(quick=args.quick),
        "service": lambda: live_service(quick=args.quick),
    }
    print(f"{_machine()}\n", flush=True)
    for name in args.only:
        title, what = SECTIONS[name]
        print(f"### {title}\n\n{what}\n\n{work[name]()}\n", flush=True)


def _machine() -> str:
    """What it is measured on, and with."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
    contrib = "with contrib" if hasattr(cv2, "ximgproc") else "without contrib: EdgeDrawing is not measured"
    return (
        f"Bowlsight {service.__version__} on {model}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the "
        f"start; Python {sys.version.split()[0]}, OpenCV {cv2.__version__} ({contrib}), numba {numba.__version__}, "
        f"numpy {np.__version__}."
    )


if __name__ == "__main__":
    main()
