"""Measure camera_from_guide: the guide's axis in the camera frame, from pictures with the guide over known tubes.

What stands in a tube has its axis near the tube's: at the tube's end within the play, and, pushed in by some length,
within the play there too. Each of these is a point that the axis passes; in the camera frame the axis is the same line
in every picture. Points at one depth alone fix its place, not its direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from drivers.errors import CalibrationError
from service.alignment.geometry import GuideAxis, cross

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from service.alignment.geometry import TubeEnd
    from service.vision.measurement import Pose

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["GuideSetup", "Standing", "solve_guide"]

LARGEST_TURN_DEG = 1.0
LARGEST_SHIFT_MM = 1.0
"""An axis less sure than this is not known."""
STRAY = 4.0
"""A picture further off than so many sigmas shows another tube."""
ANY_TURN_DEG = 15.0
"""One sigma of the guide's direction about the tubes' before anything is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """The guide over one tube, not moved while these pictures were taken.

    Attributes
    ----------
    label
        How messages call it.
    views
        Pose and tube end in each picture.
    inserted_mm
        How far something straight reaches from the guide into the tube; 0 where it only meets the tube's end.
    """

    label: str
    views: Sequence[tuple[Pose, TubeEnd]]
    inserted_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class GuideSetup:
    """The guide's axis as measured.

    Attributes
    ----------
    guide
        For the station.
    shift_sigma_mm, turn_sigma_deg
        One sigma, per axis, of its place on the sheet and of its direction.
    residual_mm, expected_mm
        RMS per axis of the points about the axis, and what play and tubes explain.
    points
        How many points it was fitted to.
    depth_mm
        How far apart these lie along the axis.
    off_mm
        How far off the axis each standing lies, at the worst of its points.
    """

    guide: GuideAxis
    shift_sigma_mm: float
    turn_sigma_deg: float
    residual_mm: float
    expected_mm: float
    points: int
    depth_mm: float
    off_mm: Sequence[float]


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Points that the axis passes, n, in the camera frame, with what they share and what is their own.

    `of` is the number of the standing that each belongs to.
    """

    of: Sequence[int]
    labels: Sequence[str]
    place_mm: Array
    own: Array
    shared: Array
    response: Array


def solve_guide(
    standings: Sequence[Standing], play_sigma_mm: float, gap_mm: float | None = None, gap_sigma_mm: float = 0.0
) -> GuideSetup:
    """Fit the guide's axis to all standings by least squares.

    Parameters
    ----------
    play_sigma_mm
        One sigma per axis of what stands in the tube about the tube's axis; for a rod of radial clearance c, c / 2.
    gap_mm, gap_sigma_mm
        Distance from the guide's mouth to the sheet in these pictures, where it was measured: then the mouth is known.

    Raises
    ------
    CalibrationError
        They do not determine the axis, or contradict each other; the message says what is missing.
    """
    if not standings:
        raise CalibrationError("no picture shows the guide over a known tube; give pictures with a lock, and the tubes")
    points = _points(standings, play_sigma_mm)
    frame = _frame(standings, points.place_mm)
    fit = _fit(points, frame)
    off = np.hypot(*fit.residual_mm.reshape(-1, 2).T)
    setup = GuideSetup(
        guide=_guide(fit, frame, standings, points.shared, gap_mm, gap_sigma_mm),
        shift_sigma_mm=math.sqrt(float(np.trace(fit.covariance[:2, :2])) / 2),
        turn_sigma_deg=math.degrees(math.sqrt(float(np.trace(fit.covariance[2:, 2:])) / 2)),
        residual_mm=math.sqrt(float(np.mean(fit.residual_mm**2))),
        expected_mm=math.sqrt(float(np.mean(np.diag(fit.own)))),
        points=len(points.labels),
        depth_mm=float(np.ptp((points.place_mm - frame.middle_mm) @ frame.along)),
        off_mm=[float(off[np.array(points.of) == i].max()) for i in range(len(standings))],
    )
    _check_known(setup, play_sigma_mm)
    return setup


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """Where the axis is described: about a point (3,), along a direction (3,), by two across it (2, 3)."""

    middle_mm: Array
    along: Array
    across: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """The axis as a shift (2) and a slope (2) in its frame, (4,) with covariance; residuals (2n,) and their own."""

    solution: Array
    covariance: Array
    residual_mm: Array
    own: Array


def _frame(standings: Sequence[Standing], place_mm: Array) -> _Frame:
    along = _unit(np.mean([pose.rotation[:, 2] for s in standings for pose, _ in s.views], axis=0))
    return _Frame(place_mm.mean(axis=0), along, np.linalg.svd(along[None])[2][1:])


def _fit(points: _Points, frame: _Frame) -> _Fit:
    """Weighted least squares; what the points share is carried through as an error common to all."""
    relative, n = points.place_mm - frame.middle_mm, len(points.labels)
    A = np.zeros((2 * n, 4))
    A[0::2, 0] = A[1::2, 1] = 1.0
    A[0::2, 2] = A[1::2, 3] = relative @ frame.along
    into = np.kron(np.eye(n), frame.across)
    own = np.asarray(into @ points.own @ into.T, np.float64)
    W = np.linalg.inv(own)
    prior = np.diag([0.0, 0.0, *[math.radians(ANY_TURN_DEG) ** -2] * 2])
    inverse = np.asarray(np.linalg.inv(A.T @ W @ A + prior), np.float64)
    gain = inverse @ A.T @ W
    y = (relative @ frame.across.T).ravel()
    solution = gain @ y
    residual = y - A @ solution
    _check_agreement(residual, own - A @ inverse @ A.T, own, points.labels)
    excess = max(1.0, float(residual @ W @ residual) / max(1, 2 * n - 4))
    by_shared = gain @ into @ points.response
    return _Fit(solution, inverse * excess + by_shared @ points.shared @ by_shared.T, residual, own)


def _points(standings: Sequence[Standing], play_sigma_mm: float) -> _Points:
    """Every tube end, and every place that something reached inside; tube and play are a standing's own.

    What is uncertain of a pose is taken for the same in all pictures: calibration does not average out.
    """
    of, labels, place, response, blocks = [], [], [], [], []
    for i, s in enumerate(standings):
        reach = [0.0, s.inserted_mm] if s.inserted_mm else [0.0]
        ends = [pose.rotation[:, :2] @ tube.center_mm + pose.translation_mm for pose, tube in s.views]
        normal = _unit(np.mean([pose.rotation[:, 2] for pose, _ in s.views], axis=0))
        pose, tube = s.views[0]
        end_covariance = pose.rotation[:, :2] @ tube.covariance @ pose.rotation[:, :2].T
        for length in reach:
            of.append(i)
            labels.append(s.label)
            place.append(np.mean(ends, axis=0) + length * normal)
            response.append(np.hstack([-cross(length * normal), np.eye(3)]))
        ones = np.ones((len(reach), len(reach)))
        blocks.append(np.kron(ones, end_covariance) + play_sigma_mm**2 * np.eye(3 * len(reach)))
    own = np.zeros((3 * len(place), 3 * len(place)))
    at = 0
    for block in blocks:
        own[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    shared = np.mean([_at_tube(pose, tube) for s in standings for pose, tube in s.views], axis=0)
    return _Points(of, labels, np.array(place), own, shared, np.vstack(response))


def _at_tube(pose: Pose, tube: TubeEnd) -> Array:
    """A pose's covariance as that of a small turn and of the tube end's place in the camera frame, (6, 6)."""
    to_tube = np.eye(6)
    to_tube[3:, :3] = -cross(pose.rotation[:, :2] @ tube.center_mm)
    return np.asarray(to_tube @ pose.covariance @ to_tube.T)


def _guide(
    fit: _Fit, frame: _Frame, standings: Sequence[Standing], shared: Array, gap_mm: float | None, gap_sigma_mm: float
) -> GuideAxis:
    """The axis by its mouth, or by where it met the sheet, with the covariance of a turn and of that point."""
    views = [view for s in standings for view in s.views]
    ends = np.array([pose.rotation[:, :2] @ tube.center_mm + pose.translation_mm for pose, tube in views])
    to_sheet = float(np.mean((ends - frame.middle_mm) @ frame.along))
    direction = frame.along + frame.across.T @ fit.solution[2:]
    u = _unit(direction)
    steep = float(np.mean([pose.rotation[:, 2] @ direction for pose, _ in views]))
    along = to_sheet - (gap_mm or 0.0) / steep
    by_fit = np.zeros((6, 4))
    by_fit[:3, 2:] = cross(u) @ frame.across.T / np.linalg.norm(direction)  # of a turn: u x du
    by_fit[3:, :2], by_fit[3:, 2:] = frame.across.T, along * frame.across.T
    covariance = by_fit @ fit.covariance @ by_fit.T
    covariance[3:, 3:] += np.outer(u, u) * (gap_sigma_mm**2 + float(u @ shared[3:, 3:] @ u))
    point = frame.middle_mm + frame.across.T @ fit.solution[:2] + along * direction
    return GuideAxis(point, u, (covariance + covariance.T) / 2, at_mouth=gap_mm is not None)


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v))


def _check_agreement(residual: Array, covariance: Array, own: Array, labels: Sequence[str]) -> None:
    """Refuse points that lie where the others' axis is not."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-6 * np.diag(own)))
    stray = np.abs(residual / spread).reshape(-1, 2).max(axis=1)
    worst = int(np.argmax(stray))
    if stray[worst] > STRAY:
        away = float(np.hypot(*residual.reshape(-1, 2)[worst]))
        raise CalibrationError(
            f"{labels[worst]}: lies {away:.2f} mm off the axis that the pictures have in common,"
            f" {stray[worst]:.0f} times what play and tubes explain; is the guide over another tube there?"
        )


def _check_known(setup: GuideSetup, play_sigma_mm: float) -> None:
    """Refuse to pretend."""
    if setup.turn_sigma_deg > LARGEST_TURN_DEG:
        length = 10 * math.ceil(math.sqrt(2) * play_sigma_mm / math.radians(LARGEST_TURN_DEG / 2) / 10)
        raise CalibrationError(
            f"the guide's direction is known to {setup.turn_sigma_deg:.1f} deg only, from points"
            f" {setup.depth_mm:.0f} mm apart along it; push something straight at least {length} mm"
            f" into the tube (--inserted-mm), or add pictures with the guide over a tube {length} mm nearer or further"
        )
    if setup.shift_sigma_mm > LARGEST_SHIFT_MM:
        raise CalibrationError(
            f"the guide's place is known to {setup.shift_sigma_mm:.1f} mm only; add pictures over other tubes,"
            " zoomed in, with a calibrated camera"
        )
