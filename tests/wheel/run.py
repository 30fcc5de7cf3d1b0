"""`make test-wheel`: install the wheel as a user does, and run every command in an empty folder of a new home.

Slow (a new environment, and kernels compiled anew) and fetching packages, so no part of `make test`.
"""

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from drivers.replay import ReplayGrabber
from service.demo import demo_camera, demo_video
from tests.wheel.building import ROOT, build_wheel

PATIENCE_S = 600
CAMERA = "image_size_px = [640, 480]\npixel_pitch_mm = [0.005, 0.005]\n"
FOCAL_LENGTH_MM = 5.0
OF_DEMO = ["--generator", "model-f", "--camera", "demo.toml"]
OF_BOWL = ["--generator", "model-f", "--camera", "bowl.camera.toml"]
LIVE = ["--no-viewer", "--no-console", "--seconds", "2"]
COMMANDS = [
    (["--help"], 0, "demo"),
    (["devices"], 0, "simulated"),
    (["simulate", "bowl.mkv", "--generator", "model-f", "--frames", "12"], 0, "12 frames"),
    (["analyze", "bowl.mkv", *OF_BOWL, "--jsonl", "bowl.jsonl"], 0, "12 of 12 pictures locked"),
    (["replay", "bowl.mkv", *OF_BOWL, "--speed", "max", "--no-viewer", "--no-console"], 0, "every frame accounted for"),
    (["replay", "bowl.mkv", *OF_BOWL, "--save", "bowl.rrd", "--no-console"], 0, "viewer: http://127.0.0.1:"),
    (["run", *LIVE], 0, "SIMULATED"),
    (["demo", *LIVE], 0, "REPLAY"),
    (["compare", "demo.png", *OF_DEMO], 0, "Table 2 of the paper"),
    (["calibrate", "--points", "points.dat", "--camera", "camera.toml"], 0, f"{FOCAL_LENGTH_MM:.3f}"),
    (
        ["align-setup", "bowl.mkv", *OF_BOWL, "--play-sigma-mm", "1", "--out", "guide.toml"],
        2,
        "over which tube does the guide stand?",
    ),
    (["analyze", "none.mp4", *OF_BOWL], 2, "none.mp4: cannot be opened"),
]
"""Arguments, the status that is right, and words that must be printed."""


def install(folder: Path) -> Path:
    """Install the wheel into an environment of its own; the program's path."""
    wheel = build_wheel(folder)
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    pip = [folder / "venv/bin/pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--constraint", ROOT / "constraints.txt", wheel], check=True, timeout=PATIENCE_S)
    return folder / "venv/bin/bowlsight"


def put_inputs(folder: Path) -> None:
    """Leave a picture with its camera, and points as a camera of known focal length sees them at 30 deg."""
    with ReplayGrabber(demo_video(), speed=math.inf) as replay:
        assert cv2.imwrite(str(folder / "demo.png"), replay.start().read(1.0).pixels)
    (folder / "demo.toml").write_bytes(demo_camera().read_bytes())
    (folder / "camera.toml").write_text(CAMERA)
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-20, 20, 9), np.linspace(-15, 15, 7)))
    depth_mm, f_px = 100 + x * math.sin(math.pi / 6), FOCAL_LENGTH_MM / 0.005
    seen = 319.5 + f_px * x * math.cos(math.pi / 6) / depth_mm, 239.5 + f_px * y / depth_mm
    np.savetxt(folder / "points.dat", np.column_stack([x + 50, y + 50, np.zeros_like(x), *seen]))


def check(program: Path, folder: Path, environment: dict[str, str]) -> list[str]:
    """Run every command; what was wrong, a line each."""
    wrong = []
    for arguments, right, words in COMMANDS:
        began_s = time.monotonic()
        done = subprocess.run(
            [program, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False,
            timeout=PATIENCE_S,
        )  # fmt: skip
        said = done.stdout + done.stderr
        if done.returncode != right or words not in said or "Traceback" in said or "mistake in" in said:
            wrong.append(f"bowlsight {' '.join(arguments)}: status {done.returncode}\n{said}")
        print(f"  {time.monotonic() - began_s:6.1f} s  bowlsight {' '.join(arguments)}", flush=True)
    return wrong


def check_stop(program: Path, folder: Path, environment: dict[str, str]) -> list[str]:
    """Stop the demonstration, viewer and all, as Ctrl-C does."""
    with subprocess.Popen(
        [program, "demo"], cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        while line := process.stdout.readline():
            if line.startswith("REPLAY"):
                break
        began_s = time.monotonic()
        process.send_signal(signal.SIGINT)
        said = line + process.communicate(timeout=PATIENCE_S)[0]
    print(f"  {time.monotonic() - began_s:6.1f} s  to stop bowlsight demo", flush=True)
    if process.returncode or "stopped after" not in said or "every frame accounted for" not in said:
        return [f"bowlsight demo, interrupted: status {process.returncode}\n{said}"]
    return []


def main() -> int:
    """Install, run, tell; the exit status."""
    with tempfile.TemporaryDirectory(prefix="bowlsight-wheel-") as name:
        folder = Path(name)
        program = install(folder)
        work, home = folder / "work", folder / "home"
        work.mkdir()
        home.mkdir()
        put_inputs(work)
        environment = {"PATH": os.defpath, "HOME": str(home), "LANG": "C.UTF-8"}
        wrong = [*check(program, work, environment), *check_stop(program, work, environment)]
        lines = (work / "bowl.jsonl").read_text().splitlines()
        if [json.loads(line)["sequence"] for line in lines] != list(range(12)):
            wrong.append(f"bowl.jsonl has {len(lines)} lines, not one for each of 12 frames")
    print("\n".join(wrong) or f"{len(COMMANDS) + 1} commands of the installed wheel did what they should")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
