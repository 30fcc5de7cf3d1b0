"""Kernels are compiled by another process, once, and then only loaded."""

import importlib
import sys

import pytest
from numba import njit

import service.vision.process  # noqa: F401 - its kernels are what is looked for
from service.cli import kernels


@pytest.fixture
def started(monkeypatch):
    commands = []
    monkeypatch.setattr("subprocess.run", lambda command, **more: commands.append((command, more)))
    return commands


def test_nothing_is_compiled_where_all_is_kept(started, monkeypatch):
    monkeypatch.setattr(kernels, "_is_missing", lambda kernel: False)
    kernels.compile_apart()
    assert started == []


def test_one_missing_kernel_is_enough(started, monkeypatch):
    monkeypatch.setattr(kernels, "_is_missing", lambda kernel: kernel.py_func.__name__ == "_gauss_newton")
    kernels.compile_apart()
    ((command, more),) = started
    assert command[0] == sys.executable
    assert "warm_up" in command[2]
    assert more["env"]["PYTHONPATH"].split(":")[: len(sys.path)] == sys.path


def test_every_kernel_of_vision_is_known_once():
    names = [f"{k.py_func.__module__}.{k.py_func.__name__}" for k in kernels._kernels()]
    assert "service.vision.pose._gauss_newton" in names
    assert len(names) == len(set(names)) > 30


def test_a_kernel_is_missing_until_it_is_kept(tmp_path, monkeypatch):
    source = tmp_path / "made.py"
    source.write_text("def twice(x):\n    return 2 * x\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    kernel = njit(cache=True)(importlib.import_module("made").twice)
    assert kernels._is_missing(kernel)
    assert kernel(2) == 4
    assert not kernels._is_missing(kernel)
