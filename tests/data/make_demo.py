"""Make `service/demo/bowl.mp4` and `camera.toml` from the rendered pan `v0_WF_nominal_pan_640x480`.

    python tests/data/make_demo.py FOLDER [OUT]

FOLDER holds ``bowl/videos/v0_WF_nominal_pan_640x480.mp4`` and its ``.json``. The first frames go there and back again
(0 .. n-1, n-2 .. 1), so that the end leads on to the beginning. x264 runs without its psychovisual tricks: what they
spend bits on is pleasing texture, not the edges that are measured. The range stays full and the luma untouched, and the
script ends with the PSNR of what a reader gets back.
"""

import argparse
import itertools
import json
import math
from pathlib import Path

import av
import numpy as np

from service.config.cameras import write_camera
from service.vision.camera import Camera, TsaiLens

NAME = "v0_WF_nominal_pan_640x480"
FRAMES = 124  # of 160: leaves each frame enough of 12 MB for 40 dB
CODEC = {"crf": "17", "preset": "veryslow", "tune": "psnr", "g": "100"}
FULL_RANGE = 2
HEADER = """\
# The camera that the demonstration video was rendered with. Its values are the truth itself and stand without [sigma]:
# they count as exact. A real camera's file comes from `bowlsight calibrate` and says how well each value is known.

"""


def luma(path: Path) -> list[np.ndarray]:
    """Y planes of a video as they are stored."""
    with av.open(str(path)) as video:
        return [
            np.frombuffer(f.planes[0], np.uint8).reshape(f.height, f.planes[0].line_size)[:, : f.width].copy()
            for f in video.decode(video=0)
        ]


def encode(pictures: list[np.ndarray], path: Path) -> None:
    height, width = pictures[0].shape
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as video:
        stream = video.add_stream("libx264", rate=25, options=CODEC)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.color_range = FULL_RANGE
        for picture in pictures:
            frame = av.VideoFrame(width, height, "yuv420p")
            frame.color_range = FULL_RANGE
            for plane, values in zip(frame.planes, (picture, None, None), strict=True):
                rows = np.full((plane.height, plane.line_size), 128, np.uint8)
                if values is not None:
                    rows[:, :width] = values
                plane.update(rows)
            video.mux(stream.encode(frame))
        video.mux(stream.encode())


def camera(truth: dict) -> Camera:
    c = truth["camera"]
    return Camera(
        image_size_px=(c["width"], c["height"]),
        pixel_pitch_mm=tuple(c["pixel_mm"]),
        focal_length_mm=c["focal_mm"],
        lens=TsaiLens(c["distortion"]["kappa1_per_mm2"]),
        principal_point_px=(c["K"][0][2], c["K"][1][2]),
        name="demonstration (rendered)",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path, nargs="?", default=Path(__file__).resolve().parents[2] / "service" / "demo")
    arguments = parser.parse_args()
    source = arguments.folder / "bowl" / "videos" / NAME

    there = luma(source.with_suffix(".mp4"))[:FRAMES]
    pictures = there + there[-2:0:-1]
    video, toml = arguments.out / "bowl.mp4", arguments.out / "camera.toml"
    encode(pictures, video)
    write_camera(toml, camera(json.loads(source.with_suffix(".json").read_text())))
    toml.write_text(HEADER + toml.read_text())

    back = itertools.zip_longest(luma(video), pictures)
    errors = [np.mean((a.astype(float) - b) ** 2) for a, b in back]
    psnr, worst = (10 * math.log10(255**2 / e) for e in (np.mean(errors), max(errors)))
    size = video.stat().st_size / 1e6
    print(f"{video}: {len(pictures)} frames, {size:.2f} MB, PSNR {psnr:.2f} dB, worst frame {worst:.2f} dB")


if __name__ == "__main__":
    main()
