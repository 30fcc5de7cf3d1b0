"""Lattice indices of blobs with no pose known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.vision.indexing import UNINDEXED, index_blobs
from service.vision.lattice import Arrangement, Lattice
from tests.scenes.rendered import index_share

PITCH_PX = 30.0


def seen(arrangement, *, turn_deg=0.0, tilt=0.0, missing=0.0, false=0.0, jitter_px=0.4, seed=0, half=7):
    """Blobs of a sheet under a turn and a perspective, in any order; their true index, UNINDEXED for false ones."""
    lattice, rng = Lattice(arrangement, 1.0, 0.33, 0.4), np.random.default_rng(seed)
    index = np.stack(np.meshgrid(*[np.arange(-half, half + 1)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    index = index[rng.random(len(index)) >= missing]
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    p = lattice.sheet_points(*index.T) @ np.array([[c, s], [-s, c]])
    p = PITCH_PX * p / (1.0 + tilt * p[:, :1] / half) + rng.normal(0, jitter_px, p.shape)
    low, high = p.min(axis=0), p.max(axis=0)
    odd = rng.uniform(low, high, (int(false * len(p)), 2))
    order = rng.permutation(len(p) + len(odd))
    true = np.concatenate([index, np.full((len(odd), 2), UNINDEXED)])
    return lattice, np.concatenate([p, odd])[order], true[order]


@settings(max_examples=40)
@given(
    arrangement=st.sampled_from(list(Arrangement)),
    turn_deg=st.floats(-180, 180),
    tilt=st.floats(-0.25, 0.25),
    missing=st.floats(0.0, 0.25),
    false=st.floats(0.0, 0.25),
    hint=st.floats(0.8, 1.25),
    seed=st.integers(0, 1000),
)
def test_what_is_indexed_is_indexed_alike(arrangement, turn_deg, tilt, missing, false, hint, seed):
    lattice, points, true = seen(
        arrangement, turn_deg=turn_deg, tilt=tilt, missing=missing, false=false, seed=seed
    )  # fmt: skip
    index, count = index_blobs(points, lattice, hint * PITCH_PX)
    told = index[:, 0] != UNINDEXED
    assert told.sum() == count
    real = told & (true[:, 0] != UNINDEXED)
    assert real.sum() > 0.5 * (true[:, 0] != UNINDEXED).sum()
    assert index_share(index[real], true[real]) > 0.9
    assert len(np.unique(index[told], axis=0)) == count


@pytest.mark.parametrize("arrangement", Arrangement)
def test_a_whole_lattice_is_indexed_wholly(arrangement):
    lattice, points, true = seen(arrangement, turn_deg=17.0)
    index, count = index_blobs(points, lattice, PITCH_PX)
    assert count == len(points)
    assert index_share(index, true) == 1.0


def test_two_islands_are_not_joined_by_guessing():
    lattice, left, _ = seen(Arrangement.SQUARE, half=4)
    _, right, _ = seen(Arrangement.SQUARE, half=3, turn_deg=20.0, seed=1)
    index, count = index_blobs(np.vstack([left, right + np.array([600.0, 0.0])]), lattice, PITCH_PX)
    assert count == len(left)
    assert (index[len(left) :] == UNINDEXED).all()


@pytest.mark.parametrize("count", range(7))
def test_fewer_than_a_star_are_not_indexed(count):
    points = np.random.default_rng(0).uniform(0, 200, (count, 2))
    index, indexed = index_blobs(points, Lattice(Arrangement.TRIANGULAR, 1.0, 0.3, 0.4), PITCH_PX)
    assert indexed == 0
    assert index.shape == (count, 2)
    assert (index == UNINDEXED).all()


@pytest.mark.parametrize(
    "points", [np.zeros((40, 2)), np.column_stack([np.arange(40.0) * 30, np.zeros(40)])], ids=["one place", "one line"]
)
def test_degenerate_blobs_do_no_harm(points):
    index, count = index_blobs(points, Lattice(Arrangement.SQUARE, 1.0, 0.3, 0.4), PITCH_PX)
    assert (index[:, 0] != UNINDEXED).sum() == count


def test_noise_is_hardly_a_lattice():
    points = np.random.default_rng(3).uniform(0, 400, (170, 2))
    _, count = index_blobs(points, Lattice(Arrangement.TRIANGULAR, 1.0, 0.3, 0.4), PITCH_PX)
    assert count < 0.3 * len(points)
