"""How near the measurement comes to what noise alone would allow: the Cramer-Rao bound, and the errors, by grade.

    python -m tests.bench.bound FOLDER_OF_STILLS

A tube end's shift along x is known no better than ``noise / gain / sqrt(pi r integral(T'^2))``: white noise of the
picture, height, radius (px) and profile of its edge. For the pose, centres so good, and tube ends that stand off.
"""

import math
import sys
from pathlib import Path

import numpy as np

from service.vision.edges import GRID
from service.vision.pose import NO_PRIOR, fit_pose
from service.vision.process import packed
from service.vision.rims import Rims
from service.vision.stopwatch import Stopwatch
from service.vision.tracking import Tracker
from tests.bench.pictures import Take, stills
from tests.bench.tables import table

LEAST_NOISE = 0.3  # of 8 bits
FAR_PX = 3.0


def noise_of(picture, center_px, radius_px):
    """Of grey values in the bore: second differences, which only noise makes."""
    x, y, k = int(center_px[0]), int(center_px[1]), max(2, int(radius_px / 2))
    bore = picture[max(0, y - k) : y + k, max(0, x - k) : x + k].astype(float)
    second = np.abs(np.diff(bore, 2, axis=1)) / math.sqrt(6.0)
    return max(LEAST_NOISE, 1.4826 * float(np.median(second))) if second.size else LEAST_NOISE


def shift_bound_px(picture, rims: Rims, used, radius_px):
    """(n,) one sigma per axis of each tube that is used."""
    profile = rims.profile() or rims.looked
    slope = np.gradient(profile.template, GRID * profile.width_px)
    sharp = float(np.trapezoid(slope**2, GRID * profile.width_px))
    noise = np.array([noise_of(picture, c, radius_px) for c in rims.center_px[used]])
    return noise / rims.gain[used] / np.sqrt(math.pi * radius_px * sharp * np.maximum(rims.rays[used], 0.3))


def bound_and_error(take: Take, rng):
    """Bound and error of centres (px), distance (mm) and tilt (deg); None where it is not locked.

    Brutal pictures are interlaced: of these the first field is taken.
    """
    parity = 0 if take.name == "brutal" else None
    picture, truth = packed(take.pictures[0] if parity is None else take.pictures[0][0::2]), take.truth[0]
    refined = Tracker(take.camera, take.lattice).step(picture, parity, 0, Stopwatch(lambda: 0)).refined
    if refined is None:
        return None
    used, fit = refined.used, refined.fit
    scale = float(np.median(np.hypot(refined.place[:, 0, 0], refined.place[:, 0, 1])))
    bound = shift_bound_px(picture, refined.rims, used, take.lattice.rim_radius_mm * scale)
    center, there = nearest(refined.rims.center_px[used], truth.center_px, parity)
    exact = np.column_stack([bound**2, np.zeros(len(bound)), bound**2])
    off = rng.normal(0, take.lattice.scatter_mm * scale, (len(bound), 2))
    ideal = fit_pose(
        refined.sites.sheet_mm[used], refined.predicted_px[used] + off, exact, fit.camera, fit.rotation,
        fit.translation_mm, take.lattice, NO_PRIOR,
    )  # fmt: skip
    n, t = fit.rotation[:, 2], fit.translation_mm
    along = np.concatenate([np.cross(n, ideal.pivot_mm), n])
    true_n, true_t = truth.rotation[:, 2], truth.translation_mm
    return {
        "centre": (float(np.median(bound)), float(np.sqrt(np.mean(center[there] ** 2)))),
        "distance": (math.sqrt(along @ ideal.covariance @ along), abs(float(n @ t - true_n @ true_t))),
        "tilt": (
            math.degrees(math.sqrt(np.trace(ideal.covariance[:2, :2]) / 2)),
            math.degrees(math.acos(min(1.0, float(n @ true_n)))),
        ),
    }


def nearest(measured_px, true_px, parity):
    """Errors, (n, 2), and which are of a tube's own end rather than of none."""
    true_px = true_px if parity is None else true_px / [1.0, 2.0]
    off = measured_px[:, None] - true_px[None]
    best = np.argmin(np.hypot(off[..., 0], off[..., 1]), axis=1)
    error = off[np.arange(len(best)), best]
    return error, np.hypot(*error.T) < FAR_PX


def main(folder: str) -> None:
    rng = np.random.default_rng(0)
    grades: dict[str, list] = {}
    for take in stills(Path(folder)):
        found = bound_and_error(take, rng)
        if found is not None:
            grades.setdefault(take.name, []).append(found)
    rows = []
    for grade, each in sorted(grades.items()):
        row = [f"{grade} ({len(each)})"]
        for what in ("centre", "distance", "tilt"):
            row += [f"{np.median([e[what][k] for e in each]):.3g}" for k in (0, 1)]
        rows.append(row)
    head = ["grade", "centre: bound, px", "error", "distance: bound, mm", "error", "tilt: bound, deg", "error"]
    print(table(head, rows))


if __name__ == "__main__":
    main(sys.argv[1])
