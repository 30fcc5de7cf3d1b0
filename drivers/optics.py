"""The small forward model of the simulated camera: pinhole, pixel grid, Tsai's or OpenCV's lens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Optics"]


@dataclass(frozen=True, slots=True)
class Optics:
    """An exactly known camera. `opencv_distortion`, where given, stands in the place of Tsai's `kappa1_per_mm2`."""

    width_px: int
    height_px: int
    focal_length_mm: float
    pixel_pitch_mm: tuple[float, float]
    principal_point_px: tuple[float, float]
    kappa1_per_mm2: float = 0.0
    opencv_distortion: tuple[float, float, float, float, float] | None = None

    @property
    def matrix(self) -> NDArray[np.float64]:
        """K, (3, 3): px from normalised coordinates."""
        (dx, dy), (cx, cy), f = self.pixel_pitch_mm, self.principal_point_px, self.focal_length_mm
        return np.array([[f / dx, 0, cx], [0, f / dy, cy], [0, 0, 1.0]])

    def project(
        self, rotation: NDArray[np.float64], translation_mm: NDArray[np.float64], sheet_mm: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Picture points (..., 2) px of sheet points (..., 3) mm; NaN behind the camera or beyond the lens's fold."""
        camera = sheet_mm @ rotation.T + translation_mm
        depth = np.where(camera[..., 2] > 0, camera[..., 2], np.nan)
        x, y = self._distort(camera[..., 0] / depth, camera[..., 1] / depth)
        K = self.matrix
        return np.stack([K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]], axis=-1)

    def _distort(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        q = x * x + y * y
        q = np.where(q < self._fold(), q, np.nan)
        if self.opencv_distortion is None:
            s = self._tsai_scale(np.sqrt(q))
            return x * s, y * s
        k1, k2, p1, p2, k3 = self.opencv_distortion
        s = 1 + q * (k1 + q * (k2 + q * k3))
        return x * s + 2 * p1 * x * y + p2 * (q + 2 * x * x), y * s + p1 * (q + 2 * y * y) + 2 * p2 * x * y

    def _tsai_scale(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distorted over undistorted radius: the root of d (1 + k d^2) = r by Newton from d = r, monotone."""
        k = self.kappa1_per_mm2 * self.focal_length_mm**2
        d = r.copy()
        for _ in range(60):
            d -= (d * (1 + k * d * d) - r) / (1 + 3 * k * d * d)
        return np.where(r > 0, d / np.where(r > 0, r, 1), 1.0) + 0 * r

    def _fold(self) -> float:
        """Undistorted radius, squared, beyond which the lens model folds back into the picture."""
        if self.opencv_distortion is None:
            k = self.kappa1_per_mm2 * self.focal_length_mm**2
            return 4 / (27 * -k) if k < 0 else np.inf
        k1, k2, _, _, k3 = self.opencv_distortion
        roots = np.roots(np.trim_zeros(np.array([7 * k3, 5 * k2, 3 * k1, 1.0]), "f"))
        return min((r.real for r in roots if abs(r.imag) < 1e-12 and r.real > 0), default=np.inf)

    def rays(self, *, margin: int = 0) -> NDArray[np.float32]:
        """Undistorted normalised coordinates of every pixel, (height, width, 2), and of so many more all round.

        NaN where nothing is imaged.
        """
        v, u = np.mgrid[-margin : self.height_px + margin, -margin : self.width_px + margin]
        return self.undistort(np.stack([u, v], axis=-1).astype(np.float64)).astype(np.float32)

    def undistort(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Undistorted normalised coordinates of picture points, (..., 2) px; NaN where none is imaged there."""
        K, u, v = self.matrix, points_px[..., 0], points_px[..., 1]
        if self.opencv_distortion is None:
            distorted = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]], axis=-1)
            q = self.kappa1_per_mm2 * self.focal_length_mm**2 * (distorted**2).sum(axis=-1, keepdims=True)
            return distorted * np.where(1 + 3 * q > 0, 1 + q, np.nan)
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
        flat = np.ascontiguousarray(points_px.reshape(-1, 1, 2))
        found = cv2.undistortPoints(flat, K, np.array(self.opencv_distortion), criteria=stop)
        rays = found.reshape(points_px.shape).astype(np.float64)
        x, y = self._distort(rays[..., 0], rays[..., 1])  # the iteration may end on the wrong side of the fold
        off_px = np.hypot(K[0, 0] * x + K[0, 2] - u, K[1, 1] * y + K[1, 2] - v)
        rays[~(off_px < 1e-3)] = np.nan
        return rays

    def to_dict(self) -> dict[str, Any]:
        """The truth file's "camera"."""
        lens: dict[str, Any] = {
            "model": "tsai",
            "kappa1_per_mm2": self.kappa1_per_mm2,
            "formula": "X_u = X_d*(1+kappa1*R_d^2), sensor mm, X_d=(u-cx)*pixel_mm[0]",
        }
        if self.opencv_distortion is not None:
            coefficients = list(self.opencv_distortion)
            lens = {"model": "brown_opencv", "order": "k1,k2,p1,p2,k3", "coeffs": coefficients}
        return {
            "width": self.width_px,
            "height": self.height_px,
            "K": self.matrix.tolist(),
            "focal_mm": self.focal_length_mm,
            "pixel_mm": list(self.pixel_pitch_mm),
            "distortion": lens,
        }
