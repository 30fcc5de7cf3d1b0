"""From a zoom position to a prior on the focal length."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import PchipInterpolator

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["SONY_25X", "ZoomTable", "focal_prior"]

AT_POINT, BETWEEN_PER_GAP = 0.01, 0.04
"""One sigma of ln f at a point of the table; and half way between two, per ln of their ratio.

The first is what copies of one lens differ by. The second covers what leaving out one point after another of Sony's
table shows: interpolated across the doubled gap it is missed by up to 0.043 of that gap.
"""


class ZoomTable:
    """Zoom ratio by position; between its points monotone in the logarithm (Fritsch-Carlson cubics).

    Parameters
    ----------
    points
        (position, ratio), both growing, at least two. Beyond the last position there is digital zoom.

    Raises
    ------
    ValueError
        They are none of that.
    """

    def __init__(self, points: Sequence[tuple[float, float]]) -> None:
        table = np.array(points, np.float64).reshape(-1, 2)
        if len(table) < 2 or (np.diff(table, axis=0) <= 0).any() or (table[:, 1] <= 0).any():
            raise ValueError("must have at least two points, positions and ratios above 0 both growing")
        self._positions, self._log_ratios = table[:, 0], np.log(table[:, 1])
        self._curve = PchipInterpolator(self._positions, self._log_ratios)

    @property
    def last_position(self) -> int:
        """Where the optical zoom ends."""
        return int(self._positions[-1])

    def ratio(self, position: float) -> tuple[float, float]:
        """Zoom ratio and its relative sigma; raises ValueError where the table does not reach."""
        p = self._positions
        if not p[0] <= position <= p[-1]:
            raise ValueError(f"zoom position {position:g} is beyond the table ({p[0]:g} to {p[-1]:g}): digital zoom?")
        k = min(int(np.searchsorted(p, position, "right")), len(p) - 1)
        between = (position - p[k - 1]) / (p[k] - p[k - 1])
        gap = self._log_ratios[k] - self._log_ratios[k - 1]
        return float(np.exp(self._curve(position))), float(
            np.hypot(AT_POINT, BETWEEN_PER_GAP * gap * 4 * between * (1 - between))
        )


SONY_25X = ZoomTable(
    [
        (0x0000, 1), (0x1781, 2), (0x213B, 3), (0x2752, 4), (0x2BB3, 5), (0x2F03, 6), (0x315D, 7), (0x3364, 8),
        (0x34FF, 9), (0x362C, 10), (0x386A, 12), (0x3AFA, 15), (0x3CCB, 18), (0x3DF8, 20), (0x4000, 25),
    ]
)  # fmt: skip
"""Sony's 25x block cameras, from their technical manual."""


def focal_prior(position: float, wide_focal_length_mm: float, table: ZoomTable = SONY_25X) -> tuple[float, float]:
    """Focal length at a zoom position, and its sigma, mm: ``f ~ f_wide * ratio``. A prior, never truth.

    It holds for the lens type, not for the copy, and knows nothing of focus: 1 % at the table's points, up to 3 %
    between them. Raises ValueError where the table does not reach, as with digital zoom.
    """
    ratio, relative = table.ratio(position)
    return wide_focal_length_mm * ratio, wide_focal_length_mm * ratio * relative
