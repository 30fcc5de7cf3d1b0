"""Anti-aliased dark ellipses on a bright ground, and a sheet of tubes seen by a camera."""

import numpy as np

from service.vision.camera import Camera, TsaiLens
from service.vision.lattice import Arrangement, Lattice
from service.vision.projection import project

DARK, BRIGHT = 20.0, 120.0


def draw_ellipses(size_px, ellipses, dark=DARK, bright=BRIGHT):
    """Float picture of (x, y, a, b, angle_deg) each; an edge pixel has the grey of the area that is covered."""
    w, h = size_px
    share = np.zeros((h, w))
    for x, y, a, b, angle_deg in ellipses:
        reach = int(max(a, b)) + 3
        x0, x1, y0, y1 = max(0, int(x) - reach), min(w, int(x) + reach), max(0, int(y) - reach), min(h, int(y) + reach)
        if x0 >= x1 or y0 >= y1:
            continue
        rows, columns = np.mgrid[y0:y1, x0:x1]
        c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        u, v = c * (columns - x) + s * (rows - y), -s * (columns - x) + c * (rows - y)
        radius = np.hypot(u / a, v / b)
        slope = np.hypot(u / a**2, v / b**2) / np.maximum(radius, 1e-9)
        distance = (radius - 1) / np.maximum(slope, 1e-9)
        share[y0:y1, x0:x1] = np.maximum(share[y0:y1, x0:x1], np.clip(0.5 - distance, 0, 1))
    return bright + (dark - bright) * share


def lattice_of(arrangement=Arrangement.TRIANGULAR):
    return Lattice(arrangement, 25.4, 8.46, 9.525)


def turned(rx_deg=0.0, ry_deg=0.0, rz_deg=0.0):
    """R = Rz Ry Rx, as Willson has it."""
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians([rx_deg, ry_deg, rz_deg])) for f in (np.cos, np.sin))
    return (
        np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    )


PAPER_POSE = turned(6.85, -0.80, -0.34)
PAPER_CAMERA = Camera((640, 480), (0.0056, 0.0056), 18.8, TsaiLens(-0.00249), (318.0, 160.0))


def sites_of(count):
    """Sites (row, column) of a square of lattice cells about (0, 0), ((2 count + 1)^2, 2)."""
    steps = np.arange(-count, count + 1)
    return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)


def see(lattice, site, rotation=PAPER_POSE, translation_mm=(-20.0, 10.0, 1062.74), camera=PAPER_CAMERA):
    """Where the sites' centres are in the picture, (n, 2) px; NaN where they are not."""
    return project(camera.vector(), rotation, np.array(translation_mm), lattice.sheet_points(*site.T))


def draw_sheet(lattice, site, rotation=PAPER_POSE, translation_mm=(-20.0, 10.0, 1062.74), camera=PAPER_CAMERA):
    """Float picture of the tube ends at the sites, each rim drawn as the ellipse that it projects to."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = lattice.rim_radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ellipses = []
    for middle in lattice.sheet_points(*site.T):
        points = project(camera.vector(), rotation, np.array(translation_mm), middle + rim)
        center = points.mean(axis=0)
        if not np.all((center > -60) & (center < np.array(camera.image_size_px) + 60)):
            continue
        moments = np.cov((points - center).T, bias=True)
        (small, large), axes = np.linalg.eigh(moments)
        turn = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
        ellipses.append((*center, np.sqrt(2 * large), np.sqrt(2 * small), turn))
    return draw_ellipses(camera.image_size_px, ellipses)
