"""Nothing is compiled once frames come: a kernel that numba meets anew would stop capture for seconds."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAM = """
import importlib, pkgutil
from dataclasses import replace
import numpy as np
from numba.core.dispatcher import Dispatcher
import service.vision
from drivers.scene import NOMINAL
from service.vision.keyframes import Keyframe
from service.vision.process import warm_up
from service.vision.selfcalibration import calibrate
from tests.scenes.rendered import camera_of, film, looking, measurer_of, unknown_camera

modules = [importlib.import_module(f"service.vision.{m.name}") for m in pkgutil.iter_modules(service.vision.__path__)]
kernels = {k.py_func.__qualname__: k for m in modules for k in vars(m).values() if isinstance(k, Dispatcher)}
assert len(kernels) > 20

def signatures():
    return {(name, str(s)) for name, kernel in kernels.items() for s in kernel.signatures}

warm_up(lambda: 0)
before = signatures()
look = replace(NOMINAL, scatter_mm=0.1, specks=50.0)
for bits, tubes, opencv in ((8, "system80", False), (16, "model-f", True)):
    poses = [looking(6.0), looking(6.0, at_mm=(11.0, 4.0))]
    there, aside = film(poses, tubes, look, opencv=opencv, bend=0.02, bits=bits)
    black = np.zeros_like(there.image)
    some = camera_of(there.optics, lens=None, sx=None, principal_point_px=None)
    loose = camera_of(there.optics, parameters=("focal_length_mm",), covariance=np.array([[1e-4]]))
    for camera in (there.camera, unknown_camera(there.optics), some, loose):
        for field in ("unknown", "progressive", "interlaced-top-first", "top"):
            measurer, seen = measurer_of(camera, there.lattice), []
            for k, pixels in enumerate([*[there.image] * 4, aside.image, black, *[there.image] * 4]):
                cut = pixels[::2] if field == "top" else pixels
                seen += measurer.measure(cut, k * 40_000_000, field)
        if camera is not there.camera:
            calibrate([Keyframe.of(m, there.lattice, 0) for m in seen if m.pose], camera, there.lattice)
new = signatures() - before
print(sorted(new))
"""


@pytest.mark.slow
def test_no_kernel_is_left_to_be_compiled():
    command = [sys.executable, "-W", "error", "-c", PROGRAM]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=1800, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == "[]"
