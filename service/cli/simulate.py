"""`bowlsight simulate`: a bowl video, its truth, and the camera file that goes with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from drivers.errors import ConfigError
from drivers.scene import GENERATORS, TubeLattice
from drivers.simulated_video import render_video
from drivers.simulation import default_scene
from service.config.cameras import write_camera
from service.config.generators import SteamGenerator, load_generator
from service.vision.camera import Camera, OpenCVLens, TsaiLens

if TYPE_CHECKING:
    import argparse

    from drivers.optics import Optics

__all__ = ["camera_of", "run"]


def run(args: argparse.Namespace) -> int:
    """Render; returns the exit status."""
    tubes = _tubes(load_generator(args.generator))
    scene = default_scene(tubes, np.random.default_rng(args.seed), frames=args.frames)
    camera_file = args.out.with_suffix(".camera.toml")
    tqdm.monitor_interval = 0  # no thread of its own
    with tqdm(total=args.frames, unit="frame", disable=None, leave=False) as bar:

        def show(done: int, total: int) -> None:
            del total
            bar.update(done - bar.n)

        truth = render_video(scene, args.out, args.frames, progress=show)
    write_camera(camera_file, camera_of(scene.optics))
    print(f"{args.out}: {args.frames} frames; truth in {truth}, camera in {camera_file}")
    return 0


def _tubes(generator: SteamGenerator) -> TubeLattice:
    shipped, lattice = GENERATORS.get(generator.key), generator.lattice
    try:
        return TubeLattice(
            arrangement=str(lattice.arrangement),
            pitch_mm=lattice.pitch_mm,
            rim_radius_mm=lattice.rim_radius_mm,
            outer_radius_mm=lattice.outer_radius_mm,
            model=shipped.model if shipped else generator.key,
            label=generator.label,
        )
    except ValueError as error:
        raise ConfigError(f"steam generator {generator.key}: cannot be rendered: {error}") from None


def camera_of(optics: Optics) -> Camera:
    """Give the camera that the pictures were rendered with, exactly known."""
    bent = optics.opencv_distortion
    return Camera(
        image_size_px=(optics.width_px, optics.height_px),
        pixel_pitch_mm=optics.pixel_pitch_mm,
        focal_length_mm=optics.focal_length_mm,
        lens=TsaiLens(optics.kappa1_per_mm2) if bent is None else OpenCVLens(bent),
        principal_point_px=optics.principal_point_px,
        name="simulated",
    )
