"""Pictures of what is no tubesheet, as a camera sees it: aslant, blurred, unevenly lit, noisy."""

import math

import cv2
import numpy as np

SIZE_PX = (320, 240)
EXTENT = 1200
DARK, BRIGHT = 30.0, 200.0


def _grid():
    return np.mgrid[:EXTENT, :EXTENT]


def chessboard(side):
    """Squares, dark and bright in turn, over all of the picture."""
    y, x = _grid() // side
    return np.where((x + y) % 2, BRIGHT, DARK)


def board(side, columns, rows):
    """A chessboard on white paper."""
    paper = np.full((EXTENT, EXTENT), 225.0)
    top, left = (EXTENT - rows * side) // 2, (EXTENT - columns * side) // 2
    paper[top : top + rows * side, left : left + columns * side] = chessboard(side)[: rows * side, : columns * side]
    return paper


def squares(pitch, side, *, staggered=0.0):
    """Dark squares on a grid of their own, each row moved on by a part of the pitch."""
    y, x = _grid().astype(np.float64)
    return np.where(((x + staggered * pitch * (y // pitch)) % pitch < side) & (y % pitch < side), DARK, BRIGHT)


def bricks(width, height, mortar=4, *, dark=True):
    """A wall of bricks."""
    y, x = _grid()
    joint = ((x + y // height % 2 * (width // 2)) % width < mortar) | (y % height < mortar)
    return np.where(joint, BRIGHT, DARK + 40) if dark else np.where(joint, DARK, BRIGHT)


def grid_lines(pitch):
    """Dark lines both ways."""
    y, x = _grid()
    return np.where((x % pitch < 0.3 * pitch) | (y % pitch < 0.3 * pitch), DARK, BRIGHT)


def rings(pitch):
    """Concentric rings."""
    y, x = _grid() - EXTENT / 2
    return np.where(np.hypot(x, y) % pitch < pitch / 2, DARK, BRIGHT)


def dots(pitch, radius, *, triangular, corners=None):
    """Discs on a lattice of tubes, or diamonds (`corners` 4) in their places."""
    paper = np.full((EXTENT, EXTENT), BRIGHT, np.uint8)
    turns = 2 * math.pi * np.arange(corners or 48) / (corners or 48)
    outline = radius * np.column_stack([np.cos(turns), np.sin(turns)])
    for row in range(int(1.3 * EXTENT / pitch)):
        for column in range(-row, int(EXTENT / pitch) + 1):
            across = (column + row / 2, row * math.sqrt(0.75)) if triangular else (column, row)
            cv2.fillPoly(paper, [np.rint(16 * (pitch * np.array(across) + outline)).astype(np.int32)], DARK, 16, 4)
    return paper.astype(np.float64)


def writing(size):
    """Lines of letters and figures."""
    paper, rng = np.full((EXTENT, EXTENT), 230, np.uint8), np.random.default_rng(1)
    for y in range(size, EXTENT, round(1.5 * size)):
        line = "".join(rng.choice(list("abcdefghkmnopqrstwxyzABCDEFGH0123456789    "), 2 * EXTENT // size))
        cv2.putText(paper, line, (0, y), cv2.FONT_HERSHEY_SIMPLEX, size / 30, 20, max(1, size // 12), cv2.LINE_AA)
    return paper.astype(np.float64)


def photographed(pattern, tilt_deg=0.0, *, azimuth_deg=30.0, roll_deg=20.0, seed=0):
    """Take a picture of a pattern, (h, w) uint8."""
    w, h = SIZE_PX
    f, middle = 1.4 * w, np.array([w / 2, h / 2])
    a = math.radians(azimuth_deg)
    tilt = cv2.Rodrigues(np.array([math.cos(a), math.sin(a), 0.0]) * math.radians(tilt_deg))[0]
    turn = tilt @ cv2.Rodrigues(np.array([0.0, 0.0, math.radians(roll_deg)]))[0]
    lens = np.array([[f, 0, middle[0]], [0, f, middle[1]], [0, 0, 1]])
    to_middle = np.array([[1.0, 0, -EXTENT / 2], [0, 1, -EXTENT / 2], [0, 0, 1]])
    homography = lens @ np.column_stack([turn[:, 0], turn[:, 1], [0, 0, f]]) @ to_middle
    seen = cv2.warpPerspective(pattern, homography, SIZE_PX, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    y, x = np.mgrid[:h, :w]
    light = 0.7 + 0.3 * np.exp(-((x - 0.6 * w) ** 2 + (y - 0.4 * h) ** 2) / (0.4 * w) ** 2)
    noise = np.random.default_rng(seed).normal(0, 3, seen.shape)
    return np.clip(cv2.GaussianBlur(seen, (0, 0), 0.8) * light + noise, 0, 255).astype(np.uint8)
