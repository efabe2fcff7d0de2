from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from mavcal.calib.imu.integrate import Moves, integrate

MATRIX = np.array([[1.02, 0.03, -0.01], [0.02, 0.97, 0.04], [-0.03, 0.01, 1.01]])
OFFSET = np.array([0.05, -0.02, 0.1])
SPANS = np.array([[1.003, 3.5], [5.0, 5.7], [10.0, 20.0]])


@pytest.fixture
def series():
    rng = np.random.default_rng(1)
    return np.arange(3000) * 0.01, rng.normal(size=(3000, 3))


def moves(series, origin=(0.1, 0.2, 0.3)):
    return Moves.of(*series, SPANS, np.array(origin))


def turned(m, matrix=MATRIX, offset=OFFSET):
    return integrate(m, matrix, offset, np.ones(3))


def test_a_movement_is_the_product_of_the_rotations_of_its_samples(series):
    t, values = series
    edges = np.concatenate([[-np.inf], 0.5 * (t[1:] + t[:-1]), [np.inf]])
    expected = np.eye(3)
    for i in range(len(t)):
        step = min(edges[i + 1], SPANS[1, 1]) - max(edges[i], SPANS[1, 0])
        if step > 0.0:
            x, y, z = MATRIX @ (values[i] - OFFSET) * step
            expected = expm(-np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])) @ expected
    result = turned(moves(series))
    assert result.rotations[1] == pytest.approx(expected, abs=1e-14)
    assert moves(series).durations == pytest.approx([2.497, 0.7, 10.0])


def test_the_sensitivity_is_the_derivative(series):
    m = moves(series)
    result = turned(m)
    for k in range(12):
        h = np.zeros(12)
        h[k] = 1e-6
        ahead, behind = (turned(m, MATRIX + s * h[:9].reshape(3, 3), OFFSET + s * h[9:]).rotations for s in (1.0, -1.0))
        skew = (ahead - behind) / 2e-6 @ np.swapaxes(result.rotations, 1, 2)  # -[psi]x
        psi = np.stack([skew[:, 1, 2], skew[:, 2, 0], skew[:, 0, 1]], axis=1)
        assert result.sensitivity[:, :, k] == pytest.approx(psi, abs=1e-7)


def test_the_origin_does_not_matter(series):
    assert turned(moves(series)).rotations == pytest.approx(turned(moves(series, (0.0, 0.0, 0.0))).rotations, abs=1e-13)


def test_white_noise_walks(series):
    result = integrate(moves(series), np.eye(3), OFFSET, np.full(3, 0.04))
    assert result.noise[1] == pytest.approx(0.04 * 0.7 * np.eye(3), abs=1e-4)


def test_movements_can_be_taken_out_and_thinned(series):
    m = moves(series)
    assert turned(m.take(np.array([0, 2]))).rotations == pytest.approx(turned(m).rotations[[0, 2]])
    smooth = Moves.of(series[0], np.column_stack([np.sin(series[0]), np.cos(series[0]), 0 * series[0]]), SPANS, OFFSET)
    assert smooth.thinned().steps.sum() == pytest.approx(smooth.steps.sum())
    assert turned(smooth.thinned()).rotations == pytest.approx(turned(smooth).rotations, abs=0.03)
