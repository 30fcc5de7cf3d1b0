"""The program as it is started: a process of its own, real vision, real signals."""

import itertools
import json
import os
import signal
import subprocess
import sys
from time import perf_counter_ns

import cv2
import pytest

from drivers.replay import ReplayGrabber
from service.acquisition.live import LiveService
from service.cli import main
from service.cli.live import PREPARING
from service.config.cameras import read_camera
from service.config.generators import load_generator
from service.demo import DEMO_GENERATOR, demo_camera, demo_video
from service.vision.process import Measurer
from tests.fakes.scripted import RememberingSink

PROGRAM = [sys.executable, "-c", "import sys; from service.cli import main; sys.exit(main())"]
PATIENCE_S = 120


@pytest.fixture
def start(tmp_path):
    """Start the program in an empty folder; whatever a test leaves running is killed."""
    processes = []

    def popen(*arguments):
        process = subprocess.Popen(
            [*PROGRAM, *map(str, arguments)], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        processes.append(process)
        return process

    yield popen
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def test_help_and_version_load_nothing_heavy():
    code = (
        "import sys; from service.cli import main; main(['--version']); main(['analyze', '--help']);"
        "sys.exit(', '.join({'numpy', 'cv2', 'numba', 'scipy', 'av', 'rerun', 'tqdm'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.stderr == "\n"


@pytest.mark.parametrize("closed", ["1", "2"])
def test_a_closed_stream_is_no_mistake(closed, tmp_path):
    command = " ".join(f"'{word}'" for word in PROGRAM)
    for arguments, status in (("--version", 0), ("analyze none.mp4 --generator model-f", 2), ("devices", 0)):
        line = f"{command} {arguments} {closed}>&-"
        done = subprocess.run(
            line, shell=True, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=PATIENCE_S
        )
        assert done.returncode == status
        assert "mistake" not in done.stderr


def test_letters_that_a_terminal_lacks_are_replaced():
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run([*PROGRAM, "größe"], env=environment, capture_output=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 2
    assert done.stderr.startswith(b"bowlsight: unknown command")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_demonstration_runs_from_any_folder_until_it_is_stopped(start, number):
    process = start("demo", "--no-viewer", "--no-console")
    assert process.stdout.readline().startswith("REPLAY")
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert "stopped after" in out
    assert "every frame accounted for" in out
    assert "Traceback" not in err


@pytest.mark.slow
def test_a_reader_that_goes_away_ends_it_without_a_word(start):
    process = start("analyze", demo_video(), "--generator", DEMO_GENERATOR, "--camera", demo_camera(), "--jsonl", "-")
    assert json.loads(process.stdout.readline())["lock"] == "full"
    process.stdout.close()
    assert process.wait(PATIENCE_S) == 141
    assert [line for line in process.stderr if PREPARING not in line] == []  # said where the machine is slow


@pytest.mark.slow
def test_an_interrupted_analysis_has_written_whole_lines(start, tmp_path):
    out = tmp_path / "o.jsonl"
    process = start("analyze", demo_video(), "--generator", DEMO_GENERATOR, "--camera", demo_camera(), "--jsonl", out)
    process.stdout.readline()
    process.stdout.readline()  # the table's first row: a frame is done
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "interrupted" in err
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert [line["sequence"] for line in lines] == list(range(len(lines)))
    assert lines


@pytest.mark.slow
def test_the_live_service_and_analyze_give_the_same_results_to_the_last_bit(tmp_path, capsys):
    folder = tmp_path / "bowl"
    folder.mkdir()
    with ReplayGrabber(demo_video(), speed=1e6) as grabber:
        for i, frame in enumerate(itertools.islice(grabber.start(), 12)):
            assert cv2.imwrite(str(folder / f"{i}.png"), frame.pixels)
    lattice, camera = load_generator(DEMO_GENERATOR).lattice, read_camera(demo_camera())
    sink = RememberingSink()
    with LiveService(
        ReplayGrabber(folder, speed=1e6), lambda _: Measurer(camera, lattice, perf_counter_ns), [sink], every_frame=True
    ) as service:
        service.start()
        assert service.wait(PATIENCE_S)
    options = ["--generator", DEMO_GENERATOR, "--camera", str(demo_camera()), "--jsonl", "-"]
    assert main(["analyze", str(folder), *options]) == 0
    analyzed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    live = [json.loads(result.to_json()) for _, results in sink.got for result in results]
    for line in (*analyzed, *live):
        del line["elapsed_ms"]
    assert len(live) == 12
    assert live == analyzed
