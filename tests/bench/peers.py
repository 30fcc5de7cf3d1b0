"""What OpenCV offers for finding tube ends. Each is told the rims' radius and the pitch in the picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

if TYPE_CHECKING:
    from tests.bench.pictures import Take

__all__ = ["Peer", "peers_for"]

PATTERNS = {6: [(4, 9), (3, 7), (3, 5)], 4: [(9, 7), (7, 5), (5, 4)]}
"""Grids to look for where the picture shows more than one, by the lattice's symmetry."""
SIZES = 0.7, 1.25
"""Radii that are let pass, in rim radii: lit bore walls make bores look smaller."""


class Peer(Protocol):
    """Centres, (n, 2) px, of what it finds in a picture."""

    def __call__(self, picture: np.ndarray) -> np.ndarray: ...


def peers_for(take: Take) -> dict[str, Peer]:
    """All that this OpenCV has, set up for a take."""
    radius, pitch = take.radius_px, take.pitch_px
    peers: dict[str, Peer] = {
        "findCirclesGrid": _grid(take),
        "SimpleBlobDetector": _blobs(radius, pitch),
        "HoughCircles, gradient": _hough(radius, pitch, cv2.HOUGH_GRADIENT, 1.0, 120.0, 14.0),
        "HoughCircles, alt": _hough(radius, pitch, cv2.HOUGH_GRADIENT_ALT, 1.5, 200.0, 0.7),
    }
    if hasattr(cv2, "ximgproc"):
        peers["EdgeDrawing (contrib)"] = _edge_drawing(radius)
    return peers


def _blob_detector(radius: float, pitch: float) -> cv2.SimpleBlobDetector:
    p = cv2.SimpleBlobDetector.Params()
    p.minThreshold, p.maxThreshold, p.thresholdStep = 10.0, 220.0, 10.0
    p.minArea, p.maxArea = (np.pi * (s * radius) ** 2 for s in SIZES)
    p.minDistBetweenBlobs = 0.5 * pitch
    p.minConvexity, p.minInertiaRatio = 0.85, 0.3
    return cv2.SimpleBlobDetector.create(p)


def _blobs(radius: float, pitch: float) -> Peer:
    detector = _blob_detector(radius, pitch)
    return lambda picture: _pairs([k.pt for k in detector.detect(picture)])


def _grid(take: Take) -> Peer:
    detector = _blob_detector(take.radius_px, take.pitch_px)
    symmetry = take.lattice.arrangement.symmetry
    kind = cv2.CALIB_CB_SYMMETRIC_GRID if symmetry == 4 else cv2.CALIB_CB_ASYMMETRIC_GRID

    def find(picture: np.ndarray, pattern: tuple[int, int]) -> np.ndarray:
        found, centers = cv2.findCirclesGrid(picture, pattern, flags=kind, blobDetector=detector)
        return centers.reshape(-1, 2) if found else _pairs([])

    wanted = [take.pattern] if take.pattern else PATTERNS[symmetry]
    best = max(wanted, key=lambda pattern: len(find(take.pictures[0], pattern)))
    return lambda picture: find(picture, best)


def _hough(radius: float, pitch: float, kind: int, dp: float, edge: float, votes: float) -> Peer:
    low, high = round(SIZES[0] * radius), round(SIZES[1] * radius)

    def find(picture: np.ndarray) -> np.ndarray:
        smooth = cv2.GaussianBlur(picture, (7, 7), 1.5)
        circles = cv2.HoughCircles(
            smooth, kind, dp, 0.6 * pitch, param1=edge, param2=votes, minRadius=low, maxRadius=high
        )
        return _pairs([]) if circles is None else circles.reshape(-1, circles.shape[-1])[:, :2]

    return find


def _edge_drawing(radius: float) -> Peer:
    drawing = cv2.ximgproc.createEdgeDrawing()
    params = cv2.ximgproc.EdgeDrawing.Params()
    params.EdgeDetectionOperator, params.GradientThresholdValue = 1, 36  # SOBEL, as OpenCV's own example has it
    params.PFmode = False
    drawing.setParams(params)

    def find(picture: np.ndarray) -> np.ndarray:
        drawing.detectEdges(picture)
        found = drawing.detectEllipses()
        if found is None:
            return _pairs([])
        x, y, r, a, b, _ = found.reshape(-1, 6).T
        size = np.maximum(r, (a + b) / 2)
        fits = (size > SIZES[0] * radius) & (size < SIZES[1] * radius)
        return _apart(np.column_stack([x, y])[fits], 0.5 * radius)

    return find


def _apart(points: np.ndarray, distance: float) -> np.ndarray:
    """One of each group of points closer than that: the mean of those about its first."""
    left, out = points, []
    while len(left):
        near = np.linalg.norm(left - left[0], axis=1) < distance
        out.append(left[near].mean(axis=0))
        left = left[~near]
    return _pairs(out)


def _pairs(points: list) -> np.ndarray:
    return np.array(points, float).reshape(-1, 2)
