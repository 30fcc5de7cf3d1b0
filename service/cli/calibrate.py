"""`bowlsight calibrate --points`: a camera from points whose places are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

from service.cli.calibrate_points import run_points

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Calibrate; returns the exit status."""
    return run_points(args.points, args.camera, args.method, args.json)
