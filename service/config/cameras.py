"""Camera files: read strictly, written atomically."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from drivers.errors import ConfigError
from service.config.table import Table, read_toml
from service.vision.camera import Camera, OpenCVLens, TsaiLens

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["CalibrationRecord", "read_camera", "write_atomically", "write_camera"]

MOST_BENT = 3.0
"""Largest share, kappa1 r², by which a lens may bend a picture's corner: at 2 it is a fisheye's."""
LENS_TERMS = ("k1", "k2", "p1", "p2", "k3")
PARAMETERS = ("focal_length_mm", "kappa1_per_mm2", *LENS_TERMS, "cx_px", "cy_px", "sx")


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """What `calibrate` writes beside the values: how they came about."""

    reprojection_error_px: float | None = None
    calibrated_utc: str | None = None
    frames: int | None = None


def read_camera(path: Path) -> Camera:
    """Read a camera file; raises ConfigError where a key is missing, unknown or impossible."""
    t = read_toml(path)
    size = t.numbers("image_size_px", 2, above=0)
    if any(v != int(v) or not 16 <= v <= 65_536 for v in size):
        raise t.error("image_size_px", "must be two whole numbers from 16 to 65536")
    focal = t.number("focal_length_mm", None, minimum=0.1, maximum=10_000)
    kappa1 = t.number("kappa1_per_mm2", None)
    opencv = t.numbers("opencv_distortion", 5, None)
    if kappa1 is not None and opencv is not None:
        raise t.error("opencv_distortion", "give either kappa1_per_mm2 or opencv_distortion, not both")
    if opencv is not None and focal is None:
        raise t.error("opencv_distortion", "means nothing without focal_length_mm; give that, or leave the lens out")
    pitch = t.numbers("pixel_pitch_mm", 2, above=0)
    point = t.numbers("principal_point_px", 2, None)
    if any(not 1e-4 <= p <= 1 for p in pitch):
        raise t.error("pixel_pitch_mm", "must be two numbers from 0.0001 to 1")
    if point is not None and any(not -s <= p <= 2 * s for p, s in zip(point, size, strict=True)):
        raise t.error(
            "principal_point_px", f"must be within a picture's size of the picture, {size[0]:g} x {size[1]:g}"
        )
    if kappa1 is not None and abs(kappa1) * (corner := _corner_mm2(size, pitch)) > MOST_BENT:
        raise t.error(
            "kappa1_per_mm2", f"must be from {-MOST_BENT / corner:.3g} to {MOST_BENT / corner:.3g}: no lens bends more"
        )
    sx = t.number("sx", None, above=0.5, maximum=2)
    t.number("reprojection_error_px", None, minimum=0)
    t.text("calibrated_utc", None)
    t.integer("frames", None, minimum=1)
    lens = OpenCVLens(opencv) if opencv is not None else None if kappa1 is None else TsaiLens(kappa1)
    parameters, covariance = _covariance(t, lens)
    camera = Camera(
        image_size_px=(int(size[0]), int(size[1])),
        pixel_pitch_mm=(pitch[0], pitch[1]),
        focal_length_mm=focal,
        lens=lens,
        principal_point_px=point,
        sx=sx,
        name=t.text("name", path.stem),
        parameters=parameters,
        covariance=covariance,
    )
    t.finish()
    for name in parameters:
        if _value(camera, name) is None:
            raise t.error("sigma", f"gives {name} a sigma, but the file gives it no value")
    return camera


def _corner_mm2(size_px: Sequence[float], pitch_mm: Sequence[float]) -> float:
    """Square of the distance from a picture's middle to its corner, mm² on the sensor."""
    return sum((s * p / 2) ** 2 for s, p in zip(size_px, pitch_mm, strict=True))


def _covariance(t: Table, lens: OpenCVLens | TsaiLens | None) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    sigmas = _sigmas(t.table("sigma"), lens)
    if "covariance" not in t:
        t.table("covariance")
        return tuple(sigmas), np.diag([s**2 for s in sigmas.values()]) if sigmas else np.zeros((0, 0))
    c = t.table("covariance")
    names = c.texts("parameters")
    if unknown := [n for n in names if n not in PARAMETERS]:
        raise c.error("parameters", f"unknown {unknown[0]!r}; known: {', '.join(PARAMETERS)}")
    matrix = np.array(c.matrix("matrix", len(names))).reshape(len(names), len(names))
    c.finish()
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0) or np.linalg.eigvalsh(matrix).min(
        initial=0
    ) < -1e-9 * np.abs(matrix).max(initial=1):
        raise c.error("matrix", "must be symmetric and positive")
    return names, (matrix + matrix.T) / 2


def _sigmas(s: Table, lens: OpenCVLens | TsaiLens | None) -> dict[str, float]:
    sigmas: dict[str, float] = {}
    for key in ("focal_length_mm", "kappa1_per_mm2", "sx"):
        if (value := s.number(key, None, minimum=0)) is not None:
            sigmas[key] = value
    if "kappa1_per_mm2" in sigmas and not isinstance(lens, TsaiLens):
        raise s.error("kappa1_per_mm2", "the file gives no kappa1_per_mm2 to go with it")
    for key, names in (("opencv_distortion", LENS_TERMS), ("principal_point_px", ("cx_px", "cy_px"))):
        if (values := s.numbers(key, len(names), None, above=-1e-300)) is not None:
            sigmas |= dict(zip(names, values, strict=True))
    s.finish()
    return sigmas


def _value(camera: Camera, parameter: str) -> float | None:
    lens, point = camera.lens, camera.principal_point_px
    values: dict[str, float | None] = {
        "focal_length_mm": camera.focal_length_mm,
        "sx": camera.sx,
        "cx_px": point and point[0],
        "cy_px": point and point[1],
        "kappa1_per_mm2": lens.kappa1_per_mm2 if isinstance(lens, TsaiLens) else None,
    }
    if isinstance(lens, OpenCVLens):
        values |= dict(zip(LENS_TERMS, lens.coefficients, strict=True))
    return values.get(parameter)


def write_camera(path: Path, camera: Camera, record: CalibrationRecord | None = None) -> None:
    """Write a camera file whole or not at all; what is unknown is left out."""
    document: dict[str, Any] = {
        "name": camera.name or path.stem,
        "image_size_px": list(camera.image_size_px),
        "pixel_pitch_mm": list(camera.pixel_pitch_mm),
    }
    if camera.sx is not None:
        document["sx"] = camera.sx
    if camera.focal_length_mm is not None:
        document["focal_length_mm"] = camera.focal_length_mm
    if isinstance(camera.lens, TsaiLens):
        document["kappa1_per_mm2"] = camera.lens.kappa1_per_mm2
    elif isinstance(camera.lens, OpenCVLens):
        document["opencv_distortion"] = list(camera.lens.coefficients)
    if camera.principal_point_px is not None:
        document["principal_point_px"] = list(camera.principal_point_px)
    for key in ("reprojection_error_px", "calibrated_utc", "frames"):
        if record is not None and (value := getattr(record, key)) is not None:
            document[key] = value
    if camera.parameters:
        sigma = dict(zip(camera.parameters, np.sqrt(np.diag(camera.covariance)).tolist(), strict=True))
        table: dict[str, Any] = {k: sigma[k] for k in ("focal_length_mm", "kappa1_per_mm2", "sx") if k in sigma}
        for key, names in (("opencv_distortion", LENS_TERMS), ("principal_point_px", ("cx_px", "cy_px"))):
            if any(n in sigma for n in names):
                table[key] = [sigma.get(n, 0.0) for n in names]
        document["sigma"] = table
        document["covariance"] = {"parameters": list(camera.parameters), "matrix": camera.covariance.tolist()}
    write_atomically(path, tomli_w.dumps(document))


def write_atomically(path: Path, text: str) -> None:
    """Write a text file by way of a temporary one beside it, flushed to disk before it takes the name.

    A link stays one. What is there and no file, such as a terminal or a pipe, is written to, never replaced.
    """
    if path.exists() and not path.is_file():
        _write_through(path, text)
        return
    target = path.resolve()
    try:
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part")
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be written: {error.strerror}; choose a folder that this user may write to"
        ) from None
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)  # noqa: PTH101 - mkstemp gives 0600; a camera file is for others to read
        os.replace(temporary, target)  # noqa: PTH105
    except OSError as error:
        os.unlink(temporary)  # noqa: PTH108
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; choose another place") from None


def _write_through(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; choose another place") from None
