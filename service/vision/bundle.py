"""Bundle adjustment over pictures of one sheet: camera, poses, and every tube's own offset from its nominal place.

Real tube ends stand a little off their nominal places, and each errs alike in every picture. Its offset (X, Y, Z) is an
unknown with the lattice's scatter for a prior: without it the covariance would shrink with every picture more of the
same tubes. The offsets, of which there are many, are eliminated tube by tube (Schur complement); poses and camera
remain. What light and lens do beyond the model is an unknown too, common to all pictures: a smooth field over the
picture, which the camera's centre and bend would take up unseen, and the light's own slope. An apparent depth of all
rims moves each pose along its normal, and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from service.vision.keyframes import Keyframe
    from service.vision.lattice import Lattice

    Array: TypeAlias = NDArray[np.float64]

__all__ = ["BENDS", "COMMON", "POSE", "Bundle", "Range", "Solution", "Spread", "State"]

POSE = 6
COMMON = 14
"""Unknowns that all pictures share beside the camera: the light's part, and a smooth field over the picture.

The field: polynomials of second order along x, then along y, and one of third order, radial as a lens bends.
"""
BENDS = np.array([2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 13])
"""The field's coefficients, but for the polynomials' constants."""
SMOOTH_PX = 0.02
"""One sigma of them over half the picture, as far as the pictures do not tell another."""
LEAST_SCATTER_MM = 1e-3


@dataclass(frozen=True, slots=True)
class Range:
    """A known distance of the camera's centre from the sheet, along its normal: the mean over `frames`."""

    distance_mm: float
    sigma_mm: float
    frames: tuple[int, ...] = (0,)


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """The pictures' data in rows, sorted by picture.

    Attributes
    ----------
    start
        (F + 1,) where each picture's rows begin.
    tube
        (N,) number of each row's tube.
    sheet_mm, center_px, covariance_px
        (N, 2), (N, 2), (N, 3), as in `Keyframe`.
    shared_px
        (N, 2, COMMON) how far each of what all pictures share moves a centre.
    tubes
        How many there are.
    scatter_mm
        (3,) one sigma of their offsets.
    common_sigma
        (COMMON,) priors of what all pictures share.
    """

    start: NDArray[np.int64]
    tube: NDArray[np.int64]
    sheet_mm: NDArray[np.float64]
    center_px: NDArray[np.float64]
    covariance_px: NDArray[np.float64]
    shared_px: NDArray[np.float64]
    tubes: int
    scatter_mm: NDArray[np.float64]
    common_sigma: NDArray[np.float64]

    @property
    def frames(self) -> int:
        """How many pictures."""
        return len(self.start) - 1

    @classmethod
    def of(cls, keyframes: Sequence[Keyframe], lattice: Lattice) -> Bundle:
        """Put pictures together."""
        index = np.concatenate(
            [np.column_stack([np.full(len(k), k.series), k.row, k.column]) for k in keyframes], dtype=np.int64
        )
        found, tube = np.unique(index, axis=0, return_inverse=True)
        scatter = np.array([lattice.scatter_mm, lattice.scatter_mm, lattice.height_scatter_mm])
        light = np.median([k.light_variance for k in keyframes])
        shift = np.median([k.shift_variance_px2 for k in keyframes], axis=0)
        smooth = [SMOOTH_PX] * 5
        return cls(
            start=np.cumsum([0, *(len(k) for k in keyframes)]),
            tube=tube.reshape(-1).astype(np.int64),
            sheet_mm=np.concatenate([k.sheet_mm for k in keyframes]),
            center_px=np.concatenate([k.center_px for k in keyframes]),
            covariance_px=np.concatenate([k.covariance_px for k in keyframes]),
            shared_px=np.concatenate([_shared(k) for k in keyframes]),
            tubes=len(found),
            scatter_mm=np.maximum(scatter, LEAST_SCATTER_MM),
            common_sigma=np.array([light**0.5, shift[0] ** 0.5, *smooth, shift[1] ** 0.5, *smooth, SMOOTH_PX]),
        )


def _shared(k: Keyframe) -> Array:
    """How far each of what all pictures share moves the centres, (n, 2, COMMON)."""
    at = 2 * k.center_px / np.array(k.camera.image_size_px) - 1
    x, y = at.T
    field = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    out = np.zeros((len(k), 2, COMMON))
    out[:, :, 0], out[:, 0, 1:7], out[:, 1, 7:13] = k.light_px, field, field
    out[:, :, 13] = at * np.sum(at**2, axis=1, keepdims=True)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Where a solution stands: PARAMETERS of the camera (10,), poses (F, 3, 3) and (F, 3), and the common unknowns."""

    values: NDArray[np.float64]
    rotation: NDArray[np.float64]
    translation_mm: NDArray[np.float64]
    common: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """How large errors are, and how far each datum is believed.

    Attributes
    ----------
    weight, tube_weight
        (N,) and (J,) Tukey weights of centres and of tubes.
    noise
        (F,) what each picture's centre noise is taken times.
    scatter
        (2,) what the tubes' scatter in the plane and in height is taken times.
    bend
        What the smooth field's coefficients are taken times.
    """

    weight: NDArray[np.float64]
    tube_weight: NDArray[np.float64]
    noise: NDArray[np.float64]
    scatter: NDArray[np.float64]
    bend: float = 1.0

    @classmethod
    def as_stated(cls, bundle: Bundle) -> Spread:
        """Everything as large as stated, and believed."""
        return cls(np.ones(len(bundle.tube)), np.ones(bundle.tubes), np.ones(bundle.frames), np.ones(2))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A solved bundle.

    Attributes
    ----------
    state
        The answer.
    names
        The camera's k parameters that were estimated.
    covariance
        (P, P) of six a picture (small turn, rad, and shift, mm, about `pivot_mm`), of `names`, and of the common
        unknowns.
    pivot_mm
        (F, 3) middle of each picture's tubes in the camera frame.
    cost
        Robust chi-square with priors, under `spread`.
    spread
        What it was solved with.
    offset_mm
        (J, 3) each tube's offset.
    residual_px
        (N, 2) measured minus predicted from nominal places.
    converged
        Whether the solution stood still at the end.
    """

    state: State
    names: tuple[str, ...]
    covariance: NDArray[np.float64]
    pivot_mm: NDArray[np.float64]
    cost: float
    spread: Spread
    offset_mm: NDArray[np.float64]
    residual_px: NDArray[np.float64]
    converged: bool

    @property
    def camera_covariance(self) -> Array:
        """(k, k) of `names`."""
        a = POSE * len(self.pivot_mm)
        return self.covariance[a : a + len(self.names), a : a + len(self.names)]
