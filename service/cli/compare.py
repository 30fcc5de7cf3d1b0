"""`bowlsight compare`: the paper's Table 2 for a picture, and the modern answer beside it."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from drivers.decoding import decode_picture
from drivers.errors import ConfigError, UnsupportedFormatError
from service.cli.inputs import large_enough
from service.cli.live import prepare_kernels
from service.cli.outputs import check_outputs
from service.config.cameras import read_camera, write_atomically
from service.config.generators import load_generator
from service.vision.measurement import Lock, Measurement, Origin
from service.vision.paper import MethodResult, Sighting, assumed_camera, compare
from service.vision.process import Measurer

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from service.vision.camera import Camera
    from service.vision.lattice import Lattice
    from service.vision.tsai import TsaiResult

    Pixels: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
    Engine: TypeAlias = Callable[[Pixels, Lattice, Camera], Measurement]

__all__ = ["run", "run_compare"]

COLUMNS = (("tubes", 6), ("Tz/f", 16), ("f mm", 18), ("C px", 17), ("Tz mm", 18), ("rms px", 8))
FINDING = (
    "Tz/f is what one picture tells; f, and Tz with it, follow from the little by which the tilt shortens the picture."
)


def run(args: argparse.Namespace) -> int:
    """Compare, with the live service's engine beside the paper's methods; returns the exit status."""
    return run_compare(args.picture, args.generator, args.camera, args.json, _engine)


def _engine(pixels: Pixels, lattice: Lattice, camera: Camera) -> Measurement:
    """Measure one picture; of an interlaced one the first field."""
    prepare_kernels()
    return Measurer(camera, lattice, time.perf_counter_ns).measure(pixels, 0)[0]


def run_compare(picture: Path, generator: str, camera: Path | None, json_out: str | None, engine: Engine) -> int:
    """Compare the paper's five centre methods on a picture; print a table, or JSON where `json_out` is "-".

    Any other `json_out` names a file to write the JSON to, beside the table.

    Returns
    -------
    int
        0, with tubes or without: a picture that shows none is a result.

    Raises
    ------
    ConfigError, UnsupportedFormatError
        The picture, the steam generator or the camera file cannot be used.
    """
    known = load_generator(generator)
    out = None if json_out in (None, "-") else Path(json_out)
    check_outputs([out] if out else [], [p for p in (picture, camera) if p])
    pixels = _read_picture(picture)
    used = _camera_of(pixels, picture, camera)
    sighting, methods = compare(pixels, known.lattice, used)
    document = {
        "picture": str(picture),
        "generator": known.key,
        "camera": _camera(used, assumed=camera is None),
        **_sighting(sighting, methods),
        "methods": {str(m.method): _method(m) for m in methods},
        "modern": _modern(engine(pixels, known.lattice, used), known.lattice, _origin_px(methods)),
    }
    text = json.dumps(document, indent=1, allow_nan=False)
    if out is not None:
        write_atomically(out, text + "\n")
    print(text if json_out == "-" else "\n".join(_text(document)))
    return 0


def _read_picture(path: Path) -> Pixels:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}; name a picture") from None
    pixels, damage = decode_picture(data, str(path))
    if damage:
        raise UnsupportedFormatError(str(path), f"is damaged ({damage}); copy it again")
    return pixels


def _camera_of(pixels: Pixels, picture: Path, camera: Path | None) -> Camera:
    size = pixels.shape[1], pixels.shape[0]
    large_enough(size, str(picture))
    if camera is None:
        return assumed_camera(size)
    read = read_camera(camera)
    if read.image_size_px != size:
        raise ConfigError(
            f"{camera}: image_size_px = {list(read.image_size_px)}: {picture} has {size[0]} x {size[1]} pixels; "
            "give the camera file that belongs to the picture"
        )
    return read


def _camera(camera: Camera, *, assumed: bool) -> dict[str, Any]:
    return {
        "name": camera.name,
        "assumed": assumed,
        "pixel_pitch_mm": list(camera.pixel_pitch_mm),
        "sx": camera.sx,
        "center_px": camera.principal_point_px and list(camera.principal_point_px),
        "middle_px": list(camera.middle_px),
    }


def _sighting(sighting: Sighting, methods: Sequence[MethodResult]) -> dict[str, Any]:
    return {
        "threshold": str(sighting.threshold),
        "tubes": len(sighting.contours),
        "dark_tubes": max(len(m.dark.site) for m in methods),
        "reason": sighting.reason,
        "origin_px": _origin_px(methods),
    }


def _origin_px(methods: Sequence[MethodResult]) -> list[float] | None:
    """Where the tube is whose depth is Tz: site (0, 0)."""
    site, center_px = methods[-1].site, methods[-1].center_px
    at = np.flatnonzero((site == 0).all(axis=1))
    return center_px[at[0]].tolist() if len(at) else None


def _method(m: MethodResult) -> dict[str, Any]:
    return {
        "tubes": len(m.site),
        "tz_over_f": m.tz_over_f,
        **_figures(m.answer),
        "center_refined": m.refined is not None,
        "center_held": {"tz_over_f": m.held and m.held.tz_over_f, **_figures(m.held)},
        "notes": list(m.notes),
    }


def _figures(r: TsaiResult | None) -> dict[str, Any]:
    if r is None:
        return dict.fromkeys(("focal_length_mm", "center_px", "tz_mm", "rms_px", "sigma"))
    s = r.sigma
    return {
        "focal_length_mm": r.focal_length_mm,
        "center_px": list(r.principal_point_px),
        "tz_mm": float(r.translation_mm[2]),
        "rms_px": math.sqrt(r.sum_of_squares_px2 / (2 * r.points)),
        "sigma": {"tz_over_f": s.tz_over_f, "focal_length_mm": s.focal_length_mm, "tz_mm": s.tz_mm},
    }


def _modern(m: Measurement, lattice: Lattice, origin_px: list[float] | None) -> dict[str, Any]:
    """Tell the engine's answer, its Tz as the depth of the same tube."""
    out: dict[str, Any] = {
        "lock": str(m.lock),
        "reason": m.reason,
        "doubt": [str(d) for d in m.doubt],
        "field": m.field,
        "tubes": int(np.count_nonzero(m.tubes.origin == Origin.MEASURED)),
    }
    pose = m.pose
    if pose is None or m.lock is Lock.NONE or pose.camera.focal_length_mm is None:
        return {**out, "tz_over_f": None, **_figures(None)}
    site = np.zeros((1, 2), np.int64)
    if origin_px is not None and len(m.tubes):
        nearest = np.argmin(np.hypot(*(m.tubes.center_px - origin_px).T))
        site = np.array([[m.tubes.row[nearest], m.tubes.column[nearest]]], np.int64)
    place = np.append(lattice.sheet_points(*site.T)[0], 0.0)
    tz_mm, f_mm = float(pose.rotation[2] @ place) + pose.tz_mm, pose.camera.focal_length_mm
    sigma = {k: getattr(pose.sigma, k) for k in ("tz_mm", "distance_mm", "tilt_deg", "focal_length_mm")}
    return {
        **out,
        "tz_over_f": tz_mm / f_mm,
        "focal_length_mm": f_mm,
        "center_px": list(pose.camera.principal_point_px or pose.camera.middle_px),
        "tz_mm": tz_mm,
        "distance_mm": pose.distance_mm,
        "tilt_deg": pose.tilt_deg,
        "rms_px": pose.reprojection_error_px,
        "sigma": {k: v if math.isfinite(v) else None for k, v in sigma.items()},
    }


def _text(d: dict[str, Any]) -> Iterator[str]:
    """Lay out the comparison for people."""
    methods, modern = d["methods"], d["modern"]
    yield f"Table 2 of the paper for {d['picture']} ({d['generator']})"
    yield from _camera_in_words(d["camera"])
    if d["reason"]:
        yield f"The paper's steps find no lattice of tubes: {d['reason']}."
    else:
        yield (
            f"{d['tubes']} tubes linked (threshold by {d['threshold']}), up to {d['dark_tubes']} more by intersecting "
            "lines. Tz is the depth of the tube at ({:.1f}, {:.1f}) px.".format(*d["origin_px"])
        )
        starred = {f"{name}{'' if m['center_refined'] else ' *'}": m for name, m in methods.items()}
        yield from _table("C refined, as in Table 2", starred)
        if len(starred.keys() - methods.keys()):
            yield "* refining C has no answer, see below; C as held, or the scale alone"
        yield from _table("C held", {name: {**m, **m["center_held"]} for name, m in methods.items()})
    yield from _table("Modern", {str(modern["lock"]): modern})
    if modern["field"] != "progressive":
        yield f"Taken for interlaced: this is its {modern['field']} field; the paper's steps take both as one picture."
    if modern["reason"]:
        yield f"No lock: {modern['reason']}"
    if modern["tz_over_f"] is not None:
        distance, tilt = (_value(modern[k], modern["sigma"][k], 2) for k in ("distance_mm", "tilt_deg"))
        doubt = ", ".join(modern["doubt"])
        yield f"distance {distance} mm, tilt {tilt} deg{f'; in doubt: {doubt}' if doubt else ''}"
    if not d["reason"]:
        yield ""
        yield f"Spread over the methods: Tz/f {_spread(methods, 'tz_over_f')}, f {_spread(methods, 'focal_length_mm')}."
        yield FINDING
        yield from (f"{name}: {note}" for name, m in methods.items() for note in m["notes"])


def _camera_in_words(c: dict[str, Any]) -> Iterator[str]:
    pitch = "{:.3f} x {:.3f} um".format(*(1000 * v for v in c["pixel_pitch_mm"]))
    if c["assumed"]:
        yield f"No --camera: pixels of {pitch} assumed, those of a 1/4-inch sensor as in the paper's camera."
        yield "f and Tz scale with their size, and f suffers where their shape is another; Tz/f hardly does."
        return
    center = "({:.1f}, {:.1f}) px".format(*(c["center_px"] or c["middle_px"]))
    sx = "1 (assumed: not in the file)" if c["sx"] is None else format(c["sx"], "g")
    yield f"Camera {c['name']}: pixels of {pitch}, sx {sx}"
    yield f"C held at {center}{'' if c['center_px'] else ', the middle: not in the file'}"


def _table(title: str, rows: dict[str, dict[str, Any]]) -> Iterator[str]:
    yield ""
    yield f"{title:26}" + "".join(f"{name:>{width}}" for name, width in COLUMNS)
    for name, row in rows.items():
        sigma = row["sigma"] or {}
        center = "-" if row["center_px"] is None else "{:.1f} {:.1f}".format(*row["center_px"])
        cells = (
            str(row["tubes"]),
            _value(row["tz_over_f"], sigma.get("tz_over_f"), 3),
            _value(row["focal_length_mm"], sigma.get("focal_length_mm"), 2),
            center,
            _value(row["tz_mm"], sigma.get("tz_mm"), 1),
            _value(row["rms_px"], None, 2),
        )
        yield f"{name:26}" + "".join(f"{c:>{width}}" for c, (_, width) in zip(cells, COLUMNS, strict=True))


def _value(value: float | None, sigma: float | None, digits: int) -> str:
    if value is None:
        return "-"
    return f"{value:.{digits}f}" + ("" if sigma is None else f" +-{sigma:.{digits}f}")


def _spread(methods: dict[str, dict[str, Any]], key: str) -> str:
    """Largest less smallest, over the mean, in words."""
    values = [m[key] for m in methods.values() if m[key] is not None]
    if len(values) < 2:
        return "unknown"
    share = 100 * (max(values) - min(values)) * len(values) / sum(values)
    return f"{share:.0f} %" if share >= 10 else f"{share:.2g} %"
