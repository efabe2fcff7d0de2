"""METHODS S1: why the axis-aligned ellipsoid is centred and scaled first, and what its sensitivities do."""

from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.mag.simple_fits import fit_ellipsoid_axis, normal_equations, offset_and_radii, solve_coefficients

CENTRE = np.array([10.0, -20.0, 30.0])
RADII = np.array([60.0, 50.0, 40.0])
NINE = np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.8, 0.0], [0.0, 0.6, 0.8], [0.8, 0.0, -0.6]]])


def everywhere(count: int) -> np.ndarray:
    u = np.random.default_rng(1).normal(size=(count, 3))
    return u / np.linalg.norm(u, axis=1)[:, None]


def test_the_condition_of_the_nine_points_is_squared_by_the_normal_equations() -> None:
    samples = CENTRE + NINE * RADII
    rows = np.column_stack([samples**2, samples])
    assert np.linalg.cond(rows) == pytest.approx(1.08e3, rel=0.01)
    assert np.linalg.cond(normal_equations(samples)[0]) == pytest.approx(1.17e6, rel=0.01)


def test_centring_and_scaling_take_the_condition_to_the_order_of_one() -> None:
    """In mG: offset (120, -85, 210), radius 490; dividing the centred samples by 400 leaves about 4."""
    samples = np.array([120.0, -85.0, 210.0]) + 490.0 * everywhere(1000)
    assert np.linalg.cond(normal_equations(samples)[0]) > 1e6
    centred = (samples - samples.mean(axis=0)) / 400.0
    assert np.linalg.cond(normal_equations(centred)[0]) < 5.0
    assert fit_ellipsoid_axis(samples).condition_number < 60.0
    far = samples + 5.0 * np.array([120.0, -85.0, 210.0]) * 5.0
    assert fit_ellipsoid_axis(far).condition_number < 60.0


def test_row_wise_cholesky_is_the_one_of_the_library() -> None:
    """Cholesky-Banachiewicz by hand, forward and back substitution, as printed in METHODS."""
    N, right = normal_equations(CENTRE + NINE * RADII)
    L = np.zeros((6, 6))
    for i in range(6):
        for j in range(i + 1):
            rest = N[i, j] - L[i, :j] @ L[j, :j]
            L[i, j] = np.sqrt(rest) if i == j else rest / L[j, j]
    z = np.zeros(6)
    for i in range(6):
        z[i] = (right[i] - L[i, :i] @ z[:i]) / L[i, i]
    x = np.zeros(6)
    for i in reversed(range(6)):
        x[i] = (z[i] - L[i + 1 :, i] @ x[i + 1 :]) / L[i, i]
    np.testing.assert_allclose(solve_coefficients(N, right), x, rtol=1e-7)


def test_the_sensitivities_make_a_sphere() -> None:
    """``corrected = diag(1, sqrt(b/a), sqrt(c/a)) (m - o)`` is as long as the first radius."""
    samples = CENTRE + everywhere(300) * RADII
    a, b, c, *_ = coefficients = solve_coefficients(*normal_equations(samples))
    offset, _ = offset_and_radii(coefficients)
    corrected = np.array([1.0, np.sqrt(b / a), np.sqrt(c / a)]) * (samples - offset)
    np.testing.assert_allclose(np.linalg.norm(corrected, axis=1), 60.0, rtol=1e-9)
    fit = fit_ellipsoid_axis(samples)
    np.testing.assert_allclose(fit.native["sensitivities"], [1.0, np.sqrt(b / a), np.sqrt(c / a)], rtol=1e-9)
    ours = fit.model.apply(samples)
    np.testing.assert_allclose(ours / ours[0], corrected / corrected[0], rtol=1e-7)
