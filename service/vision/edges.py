"""How the edge of a tube end looks across its rim: the picture's own mean profile, learnt from its clearest tubes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from service.vision.compiled import compiled, median_in_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["GRID", "INNER", "OUTER", "SAMPLES", "EdgeProfile", "profile_of", "start_profile"]

SAMPLES = 12
GRID = np.array([-3.6, -2.9, -2.2, -1.6, -1.1, -0.65, -0.2, 0.25, 0.7, 1.3, 2.0, 2.9])
"""Where a ray is sampled, in edge widths from the edge's place."""
INNER, OUTER = 3, 2
"""Samples at a ray's inner end that lie in the bore, and at its outer end that lie outside."""
WIDTH_LIMITS_PX = (0.5, 4.5)
TOP = int(np.searchsorted(GRID, 1.9))
"""Samples among which an edge's top is looked for: farther out the weld begins."""
CLEAR, CLEAR_RAYS, STILL_CLEAR = 20.0, 0.6, 5.0
"""Strength and share of rays of the tubes that tell the profile; strength of those that must do where they are few."""
LEAST_CLEAR = 4
OVERSHOT = 0.4
"""Part of the shift that a broader edge is found with, which is too much."""
FOOT_WIDTH = 1.07
"""Edge widths between where a profile reaches 16 % and 50 %: a blurred step's is one, but its foot is lit."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeProfile:
    """How the edge of a rim looks in a picture.

    Attributes
    ----------
    position_px
        Where its half height lies, outwards of the nominal rim.
    width_px
        One sigma of the blur that its foot shows.
    template
        (SAMPLES,) mean profile at ``position_px + width_px * GRID``: 0 in the bore, 1 on the tube end.
    learnt
        Whether the picture told it; else it is a guess, wide enough to find the edges with.
    blur_px
        The width that it was told to have, before it was narrowed to what rays can look across.
    """

    position_px: float
    width_px: float
    template: NDArray[np.float64]
    learnt: bool
    blur_px: float

    @property
    def overshot(self) -> float:
        """Part of the shifts that are found with it that is too much."""
        return 0.0 if self.learnt else OVERSHOT

    @property
    def offsets_px(self) -> NDArray[np.float64]:
        """Where rays are sampled, (SAMPLES,) px outwards of the nominal rim."""
        return np.asarray(self.position_px + self.width_px * GRID)

    def narrowed(self, width_px: float) -> EdgeProfile:
        """The same edge, sampled as a narrower one is."""
        template = np.interp(self.position_px + width_px * GRID, self.offsets_px, self.template)
        return replace(self, width_px=width_px, template=template)


def start_profile(width_px: float = 1.2, position_px: float = 0.0) -> EdgeProfile:
    """A blurred step, to begin with."""
    step = np.array([0.5 * (1 + math.erf(x / math.sqrt(2))) for x in GRID])
    return EdgeProfile(position_px, width_px, step, learnt=False, blur_px=width_px)


def profile_of(
    mean: Array, bore: Array, gain: Array, strength: Array, rays: Array, looked: EdgeProfile
) -> EdgeProfile | None:
    """The mean edge of the clearest tubes, placed and scaled anew; None where too few show one.

    Parameters
    ----------
    mean, bore, gain, strength, rays
        Of n tubes, as in `rims.Rims`.
    looked
        Where they were sampled.
    """
    clear = np.flatnonzero((strength > CLEAR) & (rays > CLEAR_RAYS))
    if len(clear) < LEAST_CLEAR:
        clear = np.argsort(-strength)[: max(LEAST_CLEAR, len(strength) // 5)]
        clear = clear[strength[clear] > STILL_CLEAR]
    if len(clear) < LEAST_CLEAR:
        return None
    profile = _median_profile(mean, bore, gain, clear)
    profile -= profile[:INNER].mean()
    top = float(profile[:TOP].max())
    foot, half = _crossing(profile, 0.16 * top), _crossing(profile, 0.5 * top)
    if foot is None or half is None or half <= foot:
        return None
    offsets = looked.offsets_px
    position = float(np.interp(half, np.arange(SAMPLES), offsets))
    width = FOOT_WIDTH * float(position - np.interp(foot, np.arange(SAMPLES), offsets))
    width = min(max(width, WIDTH_LIMITS_PX[0]), WIDTH_LIMITS_PX[1])
    return EdgeProfile(position, width, np.interp(position + width * GRID, offsets, profile / top), True, width)


@compiled
def _median_profile(mean: Array, bore: Array, gain: Array, clear: NDArray[np.int64]) -> Array:
    """Median over tubes of their mean profiles, each from 0 in the bore to 1."""
    profile, work = np.empty(mean.shape[1]), np.empty(clear.shape[0])
    for j in range(mean.shape[1]):
        for k in range(clear.shape[0]):
            i = clear[k]
            work[k] = (mean[i, j] - bore[i]) / gain[i]
        profile[j] = median_in_place(work, clear.shape[0])
    return profile


def _crossing(profile: Array, level: float) -> float | None:
    """Where the profile first rises through `level`, in samples."""
    k = int(np.argmax(profile > level))
    if k == 0:
        return None
    return k - 1 + float((level - profile[k - 1]) / (profile[k] - profile[k - 1]))
