"""A disk that is really full: a small file system in a namespace of its own."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

MOUNT = 'mount -t tmpfs -o size=2m none "$1" && shift && exec "$@"'
SCRIPT = """
import json, sys
from pathlib import Path
from service.cli import main
from service.sinks.session.reader import open_session
from service.sinks.session.verification import verify_session
root = Path(sys.argv[1])
status = main(["run", "--config", sys.argv[2], "--no-viewer", "--seconds", "8", "--record", str(root)])
(folder,) = (p for p in root.iterdir() if p.is_dir())
session = open_session(folder)
grave = [f"{f}" for f in verify_session(folder) if f.grave]
print(json.dumps({"status": status, "frames": session.counts().frames, "end": session.counts().end, "grave": grave}))
"""


def in_a_small_disk(folder: Path, *command: str) -> subprocess.CompletedProcess:
    if shutil.which("unshare") is None:
        pytest.skip("no unshare here to mount a small disk with")
    probe = subprocess.run(
        ["unshare", "-rm", "sh", "-c", MOUNT, "sh", str(folder), "true"], capture_output=True, check=False
    )
    if probe.returncode:
        pytest.skip(f"no small disk can be mounted here: {probe.stderr.decode().strip()}")
    return subprocess.run(
        ["unshare", "-rm", "sh", "-c", MOUNT, "sh", str(folder), *command],
        capture_output=True, text=True, check=False, timeout=600, cwd=Path(__file__).parents[2],
    )  # fmt: skip


def test_a_full_disk_ends_the_recording_and_not_the_watch(tmp_path):
    root, station = tmp_path / "disk", tmp_path / "s.toml"
    root.mkdir()
    station.write_text(
        '[source]\ndevice = "simulated?size=320x240&loop_frames=4&pitch_px=40"\n[generator]\nname = "model-f"\n'
        "[recording]\nviewer = false\nkeep_free_mib = 0\n[console]\nenabled = false\n"
    )
    done = in_a_small_disk(root, sys.executable, "-c", SCRIPT, str(root), str(station))
    assert done.stdout, done.stderr
    *summary, said = done.stdout.splitlines()
    found = json.loads(said)
    assert "No space left on device; make room" in done.stderr
    assert "the watch goes on without it" in done.stderr
    assert any("recording stopped" in line for line in summary)
    assert any(line.startswith("time is up after") for line in summary)
    delivered = next(int(line.split()[0].replace(",", "")) for line in summary if " delivered = " in line)
    assert 20 < found["frames"] < delivered
    assert (found["status"], found["end"], found["grave"]) == (1, "interrupted", [])
