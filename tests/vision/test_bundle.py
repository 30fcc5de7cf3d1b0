"""The elimination of the tubes, against the same system written out in full."""

from dataclasses import replace

import numpy as np
import pytest

from service.vision.bundle import COMMON, Bundle, Spread
from service.vision.bundle_solver import Work
from service.vision.cholesky import inverse_factor, inverted, solved
from service.vision.pose import camera_with, prior_of
from service.vision.selfcalibration import starting_camera, starting_state
from tests.vision.installation import LATTICE, UNKNOWN, installation


@pytest.fixture
def positive():
    a = np.random.default_rng(1).standard_normal((9, 6))
    return a.T @ a


def test_the_factorisation_agrees_with_numpy(positive):
    b = np.arange(6.0)
    assert solved(positive.copy(), b) == pytest.approx(np.linalg.solve(positive, b))
    assert inverted(positive.copy()) == pytest.approx(np.linalg.inv(positive))
    three = positive[:3, :3]
    assert inverse_factor(three) == pytest.approx(np.linalg.inv(np.linalg.cholesky(three)))


@pytest.fixture
def work():
    pictures = installation(2, 3)
    camera = starting_camera(pictures, UNKNOWN)
    bundle = Bundle.of(pictures, LATTICE)
    w = Work(bundle, camera, prior_of(UNKNOWN, camera.focal_length_mm), None)
    state = starting_state(pictures, camera, LATTICE)
    w.project(state)
    return w, state


def in_full(work, state, spread):
    """All unknowns in one matrix, tubes too: what is left when they are eliminated, and all solved for."""
    b, k = work.bundle, len(work.free)
    n, c = len(b.tube), 6 * work.bundle.frames
    A = np.zeros((n, 2, work.size + 3 * b.tubes))
    frame = np.repeat(np.arange(b.frames), np.diff(b.start))
    for i in range(n):
        A[i, :, 6 * frame[i] : 6 * frame[i] + 6] = work.J[i, :, :6]
        A[i, :, c : c + k] = work.J[i][:, 6 + work.free]
        A[i, :, c + k : work.size] = b.shared_px[i]
        A[i, :, work.size + 3 * b.tube[i] : work.size + 3 * b.tube[i] + 3] = work.place[i]
    known = work.known(spread)
    xx, xy, yy = b.covariance_px.T
    W = spread.weight[:, None, None] * np.linalg.inv(np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1))
    H = np.einsum("nip,nij,njq->pq", A, W, A)
    H[c : work.size, c : work.size] += known
    H[work.size :, work.size :] += np.diag(np.tile(b.scatter_mm**-2.0, b.tubes))
    g = np.einsum("nip,nij,nj->p", A, W, work.residual(state))
    g[c : work.size] -= known @ np.concatenate([state.values[work.free] - work.prior.mean, state.common])
    return H, g


def test_a_step_and_the_covariance_are_those_of_the_whole_system(work):
    w, state = work
    spread = replace(Spread.as_stated(w.bundle), bend=0.7)
    equations = w.equations(state, spread)
    H, g = in_full(w, state, spread)
    inverse = np.linalg.inv(H)
    scale = np.sqrt(np.diag(inverse)[: w.size])
    assert equations.step(0.0) / scale == pytest.approx((inverse @ g)[: w.size] / scale, rel=1e-4, abs=1e-4)
    expected = inverse[: w.size, : w.size] / np.outer(scale, scale)
    assert equations.covariance() / np.outer(scale, scale) == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_the_prediction_changes_as_its_derivatives_say(work):
    w, state = work
    px, J = w.px.copy(), w.J.copy()
    frame = np.repeat(np.arange(w.bundle.frames), np.diff(w.bundle.start))
    rng = np.random.default_rng(0)
    step = np.zeros(w.size)
    step[: 6 * w.bundle.frames] = (rng.standard_normal((w.bundle.frames, 6)) * [*[1e-6] * 3, *[1e-3] * 3]).ravel()
    step[6 * w.bundle.frames : -COMMON] = 1e-5 * np.where(w.free == 4, 1.0, state.values[w.free])
    after = w.moved(state, step)
    assert camera_with(w.camera, after.values).focal_length_mm != state.values[0]
    w.project(after)
    poses = step[: 6 * w.bundle.frames].reshape(-1, 6)[frame]
    expected = np.einsum("nip,np->ni", J[:, :, :6], poses) + J[:, :, 6 + w.free] @ step[6 * w.bundle.frames : -COMMON]
    assert w.px - px == pytest.approx(expected, abs=2e-4)
