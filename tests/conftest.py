"""What all tests share: the truth data, where it is to be had, and a watch on threads left running."""

import os
import threading
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

SHARED = Path(os.environ.get("BOWLSIGHT_SHARED", Path(__file__).resolve().parents[2] / "shared"))

LASTING = {"usbip"}
"""Threads of what tests share for the whole session."""

PATIENCE_S = 60.0
"""How long a thread that is just ending is waited for."""

# A busy machine is slow; that is no fault of what is tested.
settings.register_profile("bowlsight", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("bowlsight")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of the truth data; the test is skipped where it is absent."""
    if not (SHARED / "bowl").is_dir():
        pytest.skip(f"no truth data at {SHARED}; set BOWLSIGHT_SHARED to its folder")
    return SHARED


@pytest.fixture(autouse=True)
def no_thread_left_running():
    """Fail a test that leaves a thread behind; those that are just ending are waited for."""
    before = set(threading.enumerate())
    yield
    deadline = time.monotonic() + PATIENCE_S
    while left := [t for t in threading.enumerate() if t not in before and t.is_alive() and t.name not in LASTING]:
        if time.monotonic() > deadline:
            pytest.fail(f"threads left running: {', '.join(t.name for t in left)}")
        left[0].join(0.05)
