"""Solve a bundle: Levenberg's way down, robust, with noise and scatter estimated from what is left."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import cv2
import numpy as np

from service.vision.bundle import BENDS, COMMON, POSE, Solution, Spread, State
from service.vision.compiled import compiled
from service.vision.equations import LOST, Equations, assemble, tube_variances
from service.vision.pose import PARAMETERS, TUKEY, camera_with, linearise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from service.vision.bundle import Bundle, Range
    from service.vision.camera import Camera
    from service.vision.pose import Prior

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["Work", "solve"]

ROUNDS = 3
"""How often noise and scatter are estimated from what is left, and the solution repeated."""
ITERATIONS = 12
STILL = 1e-2
"""A solution whose chi-square falls by less stands still."""
PRIOR_COUNT, BEND_COUNT = 40.0, 4.0
"""How many residuals, or coefficients, what is stated of their size counts for against what the pictures show."""
LEAST_WEIGHT = 1e-3


def solve(
    bundle: Bundle,
    camera: Camera,
    prior: Prior,
    state: State,
    known_range: Range | None = None,
    spread: Spread | None = None,
) -> Solution:
    """Solve for camera, poses and tubes.

    Parameters
    ----------
    camera
        Picture, pixels and lens model; its values stand in `state`.
    prior
        The camera's parameters to be estimated, and what is known of them.
    state
        Where to start.
    spread
        Noise and scatter, where they are to be taken as given; else they are estimated.
    """
    work = Work(bundle, camera, prior, known_range)
    given = spread is not None
    spread = spread or Spread.as_stated(bundle)
    for _ in range(1 if given else ROUNDS):
        state, spread, converged = work.minimise(state, spread)
        if not given:
            spread = work.spread_of(state, spread)
    return work.solution(state, spread, converged=converged)


class Work:
    """One bundle with its priors, and arrays that are used again and again."""

    def __init__(self, bundle: Bundle, camera: Camera, prior: Prior, known_range: Range | None) -> None:
        self.bundle, self.camera, self.prior, self.range = bundle, camera, prior, known_range
        self.free = np.array([PARAMETERS.index(n) for n in prior.names], np.int64)
        self.size = POSE * bundle.frames + len(self.free) + COMMON
        n = len(bundle.tube)
        self.px, self.J, self.place = np.empty((n, 2)), np.empty((n, 2, 16)), np.empty((n, 2, 3))
        k = len(self.free)
        self._known = np.linalg.inv(prior.covariance) if k else np.zeros((0, 0))
        counts = np.diff(bundle.start)
        self.middle = np.add.reduceat(bundle.sheet_mm, bundle.start[:-1]) / counts[:, None]

    # -- one state ---------------------------------------------------------------------------------------------------

    def pivots(self, state: State) -> Array:
        """Middle of each picture's tubes in the camera frame, (F, 3)."""
        return np.asarray(np.einsum("fij,fj->fi", state.rotation[:, :, :2], self.middle) + state.translation_mm)

    def project(self, state: State) -> None:
        """Predict all centres under a state, with their derivatives."""
        v = camera_with(self.camera, state.values).vector()
        _project(
            v, state.values[0], state.values[1], state.rotation, state.translation_mm, self.pivots(state),
            self.bundle.start, self.bundle.sheet_mm, self.px, self.J, self.place,
        )  # fmt: skip

    def residual(self, state: State) -> Array:
        """Measured minus predicted, (N, 2) px, under the state last projected."""
        return np.asarray(self.bundle.center_px - self.px - self.bundle.shared_px @ state.common)

    def known(self, spread: Spread) -> Array:
        """Information on camera and common unknowns that does not come from the pictures."""
        k, sigma = len(self.free), self.bundle.common_sigma.copy()
        sigma[BENDS] *= spread.bend
        out = np.diag(np.concatenate([np.zeros(k), sigma**-2.0]))
        out[:k, :k] = self._known
        return out

    def equations(self, state: State, spread: Spread) -> Equations:
        """Normal equations with the tubes eliminated, about the state last projected."""
        b, m = self.bundle, self.size
        H, g = np.zeros((m, m)), np.zeros(m)
        Y, y = np.zeros((3 * b.tubes, m)), np.zeros(3 * b.tubes)
        root = np.empty((b.tubes, 3, 3))
        tube_information = spread.tube_weight[:, None] / (b.scatter_mm * spread.scatter[[0, 0, 1]]) ** 2
        cost = assemble(
            b.start, b.tube, self.residual(state), self.J, self.place, b.shared_px, b.covariance_px, spread.weight,
            spread.noise, tube_information, self.free, H, g, Y, y, root,
        )  # fmt: skip
        c = POSE * b.frames
        off = np.concatenate([state.values[self.free] - self.prior.mean, state.common])
        known = self.known(spread)
        H[c:, c:] += known
        g[c:] -= known @ off
        prior_chi2 = float(off @ known @ off)
        if self.range is not None:
            prior_chi2 += self._hold_distance(state, self.range, H, g)
        return Equations(H, g, Y, y, root, cost - float(y @ y) + prior_chi2, prior_chi2)

    def _hold_distance(self, state: State, known: Range, H: Array, g: Array) -> float:
        """Add a known distance; gives its chi-square."""
        frames = list(known.frames)
        normal, pivot = state.rotation[frames, :, 2], self.pivots(state)[frames]
        row = np.zeros(len(g))
        for i, f in enumerate(frames):
            row[POSE * f : POSE * f + 3] = np.cross(normal[i], pivot[i]) / len(frames)
            row[POSE * f + 3 : POSE * f + 6] = normal[i] / len(frames)
        distance = float(np.mean(np.sum(normal * state.translation_mm[frames], axis=1)))
        off, information = known.distance_mm - distance, known.sigma_mm**-2
        H += information * np.outer(row, row)
        g += information * off * row
        return information * off * off

    def moved(self, state: State, step: Array) -> State:
        """The state after a step."""
        f, k = self.bundle.frames, len(self.free)
        values, poses = state.values.copy(), step[: POSE * f].reshape(f, POSE)
        values[self.free] += step[POSE * f : POSE * f + k]
        values[0] = max(values[0], 0.3 * state.values[0])
        rotation, pivot = np.empty_like(state.rotation), self.pivots(state)
        translation = np.empty_like(state.translation_mm)
        for i in range(f):
            turn = _turn(poses[i, :3])
            rotation[i] = turn @ state.rotation[i]
            translation[i] = turn @ (state.translation_mm[i] - pivot[i]) + pivot[i] + poses[i, 3:]
        return State(values, rotation, translation, state.common + step[POSE * f + k :])

    # -- the solution ------------------------------------------------------------------------------------------------

    def minimise(self, state: State, spread: Spread) -> tuple[State, Spread, bool]:
        """Go down to the robust minimum, with noise and scatter as they are; Levenberg's damping where need be."""
        self.project(state)
        equations, damping = self.equations(state, spread), 0.0
        for _ in range(ITERATIONS):
            for _ in range(10):
                trial = self.moved(state, equations.step(damping))
                self.project(trial)
                tried = self.equations(trial, spread)
                if tried.cost <= equations.cost * (1 + 1e-9):
                    break
                damping = max(10 * damping, 1e-6)
            else:
                self.project(state)
                return state, self.weighed(state, spread, equations), True
            gained = equations.cost - tried.cost
            state, damping = trial, 0.1 * damping if damping > 1e-7 else 0.0
            if gained < STILL:
                return state, self.weighed(state, spread, tried), True
            spread = self.weighed(state, spread, tried)
            equations = self.equations(state, spread)
        return state, spread, False

    def weighed(self, state: State, spread: Spread, equations: Equations) -> Spread:
        """Tukey's weights of centres and of tubes."""
        m2, tube_m2 = self.distances(state, spread, equations)
        weight, tube_weight = _tukey(m2), np.maximum(_tukey(tube_m2), LEAST_WEIGHT)
        return replace(spread, weight=weight, tube_weight=tube_weight)

    def distances(self, state: State, spread: Spread, equations: Equations) -> tuple[Array, Array]:
        """Mahalanobis distances squared of the centres from where their tubes are, and of the tubes from nominal."""
        b, offset = self.bundle, equations.offsets()
        left = self.residual(state) - np.einsum("nij,nj->ni", self.place, offset[b.tube])
        noise2 = np.repeat(spread.noise**2, np.diff(b.start))
        xx, xy, yy = b.covariance_px.T
        m2 = (yy * left[:, 0] ** 2 - 2 * xy * left[:, 0] * left[:, 1] + xx * left[:, 1] ** 2) / (xx * yy - xy * xy)
        sigma = b.scatter_mm * spread.scatter[[0, 0, 1]]
        return np.nan_to_num(m2 / noise2, nan=LOST), np.sum((offset / sigma) ** 2, axis=1)

    def spread_of(self, state: State, spread: Spread) -> Spread:
        """Noise and scatter, from what is left at the minimum and from the freedom that the fit took."""
        b = self.bundle
        equations = self.equations(state, spread)
        covariance = equations.covariance()
        m2, _ = self.distances(state, spread, equations)
        offset, left_of_prior = equations.offsets(), self._freedom(spread, equations, covariance)
        sigma = b.scatter_mm * spread.scatter[[0, 0, 1]]
        ours = spread.tube_weight > LEAST_WEIGHT
        seen, freedom = (offset[ours] / sigma) ** 2, 1 - left_of_prior[ours]
        ratios = [
            (seen[:, c].sum() + PRIOR_COUNT) / (freedom[:, c].sum() + PRIOR_COUNT) for c in (slice(0, 2), slice(2, 3))
        ]
        used = spread.weight > 0
        free = 2.0 * used.sum() - self.size - float(freedom.sum())
        share = max(free, 0.0) / (2.0 * used.sum())
        noise = spread.noise.copy()
        for f in range(b.frames):
            rows = slice(b.start[f], b.start[f + 1])
            mine = m2[rows][used[rows]]
            noise[f] *= math.sqrt((mine.sum() + PRIOR_COUNT) / (2.0 * len(mine) * share + PRIOR_COUNT))
        return replace(
            spread, noise=noise, scatter=spread.scatter * np.sqrt(ratios), bend=self._bend(state, spread, covariance)
        )

    def _bend(self, state: State, spread: Spread, covariance: Array) -> float:
        """How large the smooth field is."""
        sigma = self.bundle.common_sigma[BENDS]
        left_of_prior = np.diag(covariance)[-COMMON:][BENDS] / (sigma * spread.bend) ** 2
        seen = float(np.sum((state.common[BENDS] / sigma) ** 2))
        return math.sqrt((seen + BEND_COUNT) / (float(np.sum(1 - left_of_prior)) + BEND_COUNT))

    def _freedom(self, spread: Spread, equations: Equations, covariance: Array) -> Array:
        """Part of each tube offset's prior variance that remains after the fit, (J, 3)."""
        posterior = tube_variances(equations.Y, equations.root, covariance)
        sigma = self.bundle.scatter_mm * spread.scatter[[0, 0, 1]]
        return np.asarray(np.minimum(posterior / sigma**2, 1.0))

    def solution(self, state: State, spread: Spread, *, converged: bool) -> Solution:
        """Put the answer together; what was not set aside counts in full for the covariance."""
        self.project(state)
        equations = self.equations(state, spread)
        m2, tube_m2 = self.distances(state, spread, equations)
        cost = _tukey_cost(m2) + _tukey_cost(tube_m2) + equations.prior_chi2
        whole = replace(
            spread,
            weight=(spread.weight > 0).astype(np.float64),
            tube_weight=np.where(spread.tube_weight > LEAST_WEIGHT, 1.0, LEAST_WEIGHT),
        )
        return Solution(
            state=state,
            names=self.prior.names,
            covariance=self.equations(state, whole).covariance(),
            pivot_mm=self.pivots(state),
            cost=cost,
            spread=spread,
            offset_mm=equations.offsets(),
            residual_px=self.residual(state),
            converged=converged,
        )


def _tukey(m2: Array) -> Array:
    return np.asarray(np.maximum(1.0 - m2 / TUKEY**2, 0.0) ** 2)


def _tukey_cost(m2: Array) -> float:
    return float(np.sum(1.0 - np.maximum(1.0 - m2 / TUKEY**2, 0.0) ** 3)) * TUKEY**2 / 3


def _turn(w: Array) -> Array:
    return np.asarray(cv2.Rodrigues(w)[0], np.float64)


@compiled
def _project(
    v: Array, f_mm: float, sx: float, R: Array, t: Array, pivot: Array, start: NDArray[np.int64], sheet: Array,
    px: Array, J: Array, place: Array,
) -> None:  # fmt: skip
    """`pose.linearise` over all pictures."""
    for f in range(start.shape[0] - 1):
        a, b = start[f], start[f + 1]
        linearise(v, f_mm, sx, R[f], t[f], pivot[f], sheet[a:b], 16, px[a:b], J[a:b], place[a:b])
