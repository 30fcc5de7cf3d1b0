"""What a picture's rims themselves said: the evidence that a calibration is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from service.vision.refinement import Refined

__all__ = ["View"]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Measured centres of one picture, before pose, lens and neighbours drew them anywhere; nothing is copied.

    Attributes
    ----------
    row, column
        (n,) int64 lattice index of the places looked at.
    measured
        (n,) whether a rim was seen there, whatever the pose made of it.
    center_px
        (n, 2) measured centres, without what all edges were found to have in common; lines of the picture, which may be
        a field.
    covariance_px
        (n, 3) xx, xy, yy of the centres.
    light_px
        (n, 2) what uneven light may shift a centre by, see `Rims.light_px`.
    bias_covariance
        (4, 4) of shift x, y (px), depth (mm) and light: what remains unknown of what the edges have in common.
    parity
        0 or 1 where the picture was the top or the bottom field, None for a frame.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    measured: NDArray[np.bool_]
    center_px: NDArray[np.float64]
    covariance_px: NDArray[np.float64]
    light_px: NDArray[np.float64]
    bias_covariance: NDArray[np.float64]
    parity: int | None

    @classmethod
    def of(cls, refined: Refined) -> View:
        """What a refined pose rests on."""
        return cls(
            row=refined.sites.row,
            column=refined.sites.column,
            measured=refined.measured,
            center_px=refined.rims.center_px,
            covariance_px=refined.rims.covariance_px,
            light_px=refined.rims.light_px,
            bias_covariance=refined.common.bias.covariance,
            parity=refined.parity,
        )
