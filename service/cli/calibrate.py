"""`bowlsight calibrate`: a camera from pictures of the tubesheet itself, or from points whose places are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.errors import ConfigError
from service.cli.calibrate_pictures import run_pictures
from service.cli.calibrate_points import run_points

if TYPE_CHECKING:
    import argparse

__all__ = ["run"]

OF_PICTURES = ("generator", "out", "range_mm", "focal_length_mm", "field_order")


def run(args: argparse.Namespace) -> int:
    """Calibrate; returns the exit status."""
    if args.points is None:
        if args.method is not None:
            raise ConfigError(f"--method {args.method}: is for --points; leave it out")
        return run_pictures(args)
    if args.paths:
        raise ConfigError(f"{args.paths[0]}: calibrates from pictures, --points from points; give one of the two")
    for name in OF_PICTURES:
        if getattr(args, name) is not None:
            raise ConfigError(f"--{name.replace('_', '-')}: is for pictures, not for --points; leave it out")
    if args.camera is None:
        raise ConfigError("calibrate --points: give --camera FILE with the picture's size and the pixel pitch")
    return run_points(args.points, args.camera, args.method or "tsai", args.json)
