"""The bundled demonstration: a rendered Model F bowl under a panning camera, there and back so that it loops."""

from __future__ import annotations

from pathlib import Path

__all__ = ["DEMO_GENERATOR", "demo_camera", "demo_video"]

DEMO_GENERATOR = "model-f"
"""The steam generator it shows, as `--generator` takes it."""


def demo_video() -> Path:
    """Path of the video: 640x480, grey, 25 frames/s, its last frame leading on to its first."""
    return Path(__file__).with_name("bowl.mp4")


def demo_camera() -> Path:
    """Path of the camera file that goes with it: the values the pictures were rendered with."""
    return Path(__file__).with_name("camera.toml")
