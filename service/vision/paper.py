"""The paper's nine steps as one list, and its Table 2: what Tsai's calibration makes of five kinds of centre.

"A Study on Extraction of the Center Point of Steam Generator Tubes", Proceedings of the Korean Nuclear Autumn Meeting,
Yongpyong, October 2002.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.camera import Camera
from service.vision.centers import CenterMethod, center, center_sigma_px
from service.vision.errors import DegenerateError
from service.vision.lines import Crossings, Line, crossings, fit_lines
from service.vision.linking import link
from service.vision.segmentation import Contour, Threshold, binarize, circular, contours, label, smooth, threshold
from service.vision.tsai import TsaiResult, calibrate_coplanar
from service.vision.tsai_full import calibrate_full

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.lattice import Lattice
    from service.vision.segmentation import Picture

    Points: TypeAlias = NDArray[np.float64]

__all__ = ["MethodResult", "Sighting", "assumed_camera", "compare", "follow_paper", "measure", "sight"]

SENSOR_MM = (3.6, 2.7)
"""Of a 1/4-inch CCD, as in the paper's DCR-PC5."""
WIDESCREEN = 1.55
"""Width over height from which a picture's pixels are square; below, it is taken to show all of a 4:3 sensor."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Steps 1 to 5 and the linking of step 7: the tubes that can be told from their background.

    Attributes
    ----------
    threshold
        What the threshold was taken from: of the three, what gave the most linked tubes.
    regions
        Dark regions that were looked at.
    contours
        Of the linked tubes.
    site
        (n, 2) int64, (row, column) of each. (0, 0) is the tube nearest to the picture's top left corner.
    reason
        Why there are none, or None.
    """

    threshold: Threshold
    regions: int
    contours: tuple[Contour, ...]
    site: NDArray[np.int64]
    reason: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MethodResult:
    """Steps 6 to 9 for one kind of centre: one row of Table 2.

    Attributes
    ----------
    method
        Which of the five.
    site, center_px, sigma_px
        (n, 2) int64 (row, column), (n, 2) and (n,): centres and their one sigma per axis, px.
    lines, dark
        Step 7's lines; step 8's intersections at the places without a centre.
    held, refined
        Tsai's calibration with the principal point held where the camera has it, and refined too, as in Table 2;
        None where f and Tz cannot be told apart.
    tz_over_f
        Of `refined`, else of `held`, else of the tubes' middle by their scale alone; None without tubes.
    notes
        In words, what is missing and why.
    """

    method: CenterMethod
    site: NDArray[np.int64]
    center_px: Points
    sigma_px: NDArray[np.float64]
    lines: tuple[Line, ...]
    dark: Crossings
    held: TsaiResult | None
    refined: TsaiResult | None
    tz_over_f: float | None
    notes: tuple[str, ...]

    @property
    def answer(self) -> TsaiResult | None:
        """What Table 2 shows: with the principal point refined where that has an answer."""
        return self.refined or self.held


def follow_paper(picture: Picture, lattice: Lattice, camera: Camera, method: CenterMethod) -> MethodResult:
    """Take a grey picture, (h, w), through all nine steps."""
    return measure(sight(picture, lattice, camera), lattice, camera, method)


def compare(picture: Picture, lattice: Lattice, camera: Camera) -> tuple[Sighting, list[MethodResult]]:
    """Table 2 for a grey picture, (h, w): the same tubes through all five methods."""
    sighting = sight(picture, lattice, camera)
    return sighting, [measure(sighting, lattice, camera, method) for method in CenterMethod]


def sight(picture: Picture, lattice: Lattice, camera: Camera) -> Sighting:
    """Steps 1 to 5 and linking: by each of the three thresholds in turn; the one that links the most tubes is kept."""
    grey = smooth(picture)  # step 1
    return max((_sight(grey, lattice, camera, by) for by in Threshold), key=lambda s: len(s.contours))


def _sight(grey: NDArray[np.float32], lattice: Lattice, camera: Camera, by: Threshold) -> Sighting:
    dark = binarize(grey, threshold(grey, by))  # step 2
    labels, table = label(dark)  # step 3
    outlines = contours(labels, table)  # step 4
    found = circular(outlines)  # step 5
    points = np.array([center(c, CenterMethod.CENTROID) for c in found]).reshape(-1, 2)
    radii = np.array([math.sqrt(c.region.sum() / math.pi) for c in found])
    links = link(points, radii, lattice, camera.pixel_pitch_mm[1] / camera.pixel_pitch_mm[0])
    used = np.flatnonzero(links.used)
    site = links.site[used] - _corner_site(points[used], links.site[used], grey.shape)
    return Sighting(by, len(table) - 1, tuple(found[i] for i in used), site, links.reason)


def _corner_site(points_px: Points, site: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Site of the tube nearest to the top left corner.

    Tsai's coplanar calibration needs the world's origin away from the picture's centre and from the camera's y axis
    (Willson); the paper's printed T = (-85, -74, 1063) mm has it up and left of the picture's centre too. Over a
    sheet tilted by 7 deg Tz differs by a few per cent from side to side, so a Tz means that of this tube.
    """
    if not len(site):
        return np.zeros(2, np.int64)
    return np.asarray(site[np.argmin(points_px @ (1 / shape[1], 1 / shape[0]))])


def measure(sighting: Sighting, lattice: Lattice, camera: Camera, method: CenterMethod) -> MethodResult:
    """Steps 6 to 9 with one kind of centre.

    Step 9 takes the measured centres only: the intersections are sums of them and would add no evidence, only the
    bend that the lens gives to straight lines.
    """
    center_px = np.array([center(c, method) for c in sighting.contours]).reshape(-1, 2)  # step 6
    sigma_px = np.array([center_sigma_px(c, method) for c in sighting.contours])
    known = np.isfinite(center_px).all(axis=1)
    site, center_px, sigma_px = sighting.site[known], center_px[known], sigma_px[known]
    lines = fit_lines(center_px, sigma_px, site, lattice)  # step 7
    dark = crossings(lines, camera.image_size_px, lattice).without(site)  # step 8
    held, refined, ratio, notes = _calibrated(lattice.sheet_points(*site.T), center_px, camera)  # step 9
    if sighting.reason:
        notes = (sighting.reason,)
    return MethodResult(method, site, center_px, sigma_px, tuple(lines), dark, held, refined, ratio, notes)


def _calibrated(
    sheet_mm: Points, center_px: Points, camera: Camera
) -> tuple[TsaiResult | None, TsaiResult | None, float | None, tuple[str, ...]]:
    """Step 9: Tsai's answers with the principal point held and refined, Tz/f, and what is missing."""
    if not len(sheet_mm):
        return None, None, None, ("no tubes",)
    answers: list[TsaiResult | None] = []
    notes: list[str] = []
    for words, calibrate in (("held", calibrate_coplanar), ("refined", calibrate_full)):
        try:
            answers.append(calibrate(sheet_mm, center_px, camera))
        except DegenerateError as error:
            answers.append(None)
            notes.append(f"with C {words}: {error}")
    held, refined = answers
    found = refined or held
    return held, refined, found.tz_over_f if found else _scale(sheet_mm, center_px, camera), tuple(notes)


def _scale(sheet_mm: Points, center_px: Points, camera: Camera) -> float:
    """Depth of the tubes' middle over f, from the affine map of sheet to sensor: the direction that no tilt shortens.

    It stands where perspective is too weak, or the centres too rough, for f.
    """
    sensor = center_px * camera.pixel_pitch_mm / np.array([camera.sx or 1.0, 1.0])
    affine = np.linalg.lstsq(sheet_mm - sheet_mm.mean(axis=0), sensor - sensor.mean(axis=0))[0]
    return float(1 / np.linalg.svd(affine, compute_uv=False)[0])


def assumed_camera(image_size_px: tuple[int, int]) -> Camera:
    """Stand in for a camera that nobody described: the paper's 1/4-inch sensor, 3.6 mm wide.

    Pictures of the old formats (640x480, 720x480, 720x576) show its whole 3.6 x 2.7 mm; wider ones have square
    pixels. Tz/f depends little on it; f and Tz scale with it.
    """
    width, height = image_size_px
    dx = SENSOR_MM[0] / width
    dy = dx if width / height > WIDESCREEN else SENSOR_MM[1] / height
    return Camera(image_size_px, (dx, dy), name="assumed: 1/4\" sensor, as the paper's DCR-PC5")
