"""What is compiled just now and what is loaded from the disk is the same machine code."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from service.vision.compiled import sort_columns

ROOT = Path(__file__).parents[2]
SOURCE = """
from service.vision.compiled import compiled, median_in_place

@compiled
def calling_kernel(a):
    return median_in_place(a, 3) + median_in_place(a[1:], 4) + median_in_place(a[2:], 5)
"""
PROGRAM = """
import hashlib
from dataclasses import replace
from drivers.scene import NOMINAL
from tests.scenes.rendered import film, looking, measurer_of

look = replace(NOMINAL, scatter_mm=0.1)
pictures = film([looking(5.0 + 0.05 * k) for k in range(4)], "model-f", look)
measurer = measurer_of(pictures[0].camera, pictures[0].lattice)
digest = hashlib.sha256()
for k, picture in enumerate(pictures):
    for seen in measurer.measure(picture.image, k * 40_000_000):
        digest.update(seen.tubes.center_px.tobytes() + seen.pose.rotation.tobytes())
print(digest.hexdigest())
"""


def test_a_kernel_takes_in_those_that_it_calls(tmp_path, monkeypatch):
    (tmp_path / "calling.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(tmp_path))
    kernel = importlib.import_module("calling").calling_kernel
    kernel.compile("float64(float64[::1])")
    (code,) = kernel.inspect_asm().values()
    lines = [line for line in code.splitlines() if "NumbaEnv" not in line]
    assert any("calling_kernel" in line for line in lines)
    assert not [line for line in lines if "median_in_place" in line]


@pytest.mark.slow
def test_the_first_run_gives_what_later_ones_give(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    runs = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=1800,
            check=True,
        ).stdout
        for _ in range(2)
    ]  # fmt: skip
    assert runs[0] == runs[1] != ""


@pytest.mark.parametrize("count", [1, 2, 3, 8, 16, 20, 24])
def test_columns_are_sorted_each_by_itself(count):
    a = np.random.default_rng(count).normal(size=(count, 33)).astype(np.float32)
    a[np.random.default_rng(1).random(a.shape) < 0.2] = np.inf
    expected = np.sort(a, axis=0)
    sort_columns(a)
    assert np.array_equal(a, expected)
