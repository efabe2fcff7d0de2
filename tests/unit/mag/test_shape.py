from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mavcal.calib.mag.shape import Ellipsoid, correction, correction_covariance, six_numbers, symmetric


def test_six_numbers_and_back() -> None:
    six = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_array_equal(symmetric(six), [[1, 4, 5], [4, 2, 6], [5, 6, 3]])
    np.testing.assert_array_equal(six_numbers(symmetric(six)), six)


def test_correction_maps_the_ellipsoid_to_the_sphere(compass: Any, rng: np.random.Generator) -> None:
    exact = compass.read(compass.everywhere(rng, 50), rng, noise=0.0)
    np.testing.assert_allclose(np.linalg.norm(correction(compass.truth, 49.0).apply(exact), axis=1), 49.0)
    relative = correction(compass.truth, None)
    np.testing.assert_allclose(np.linalg.norm(relative.apply(exact), axis=1), compass.truth.mean_radius)
    assert np.linalg.det(relative.matrix) == pytest.approx(1.0)


@pytest.mark.long
@pytest.mark.parametrize("strength", [None, 49.0])
def test_covariance_equals_that_of_many_draws(compass: Any, strength: float | None) -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(9, 9)) * 0.01
    covariance = root @ root.T
    field_sd = 0.0 if strength is None else 0.2
    draws = []
    for step in rng.multivariate_normal(np.zeros(9), covariance, size=20_000):
        known = None if strength is None else strength + field_sd * rng.normal()
        model = correction(compass.truth.stepped(step), known)
        draws.append(np.concatenate([model.offset, model.matrix.ravel()]))
    stated = correction_covariance(compass.truth, covariance, strength, field_sd)
    sample = np.cov(np.array(draws).T)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(sample / scale, stated / scale, atol=0.03)


def test_moving_and_stretching(compass: Any) -> None:
    moved = compass.truth.moved(np.array([1.0, 2.0, 3.0]), 2.0)
    np.testing.assert_allclose(moved.offset, 2.0 * compass.truth.offset + [1.0, 2.0, 3.0])
    np.testing.assert_allclose(moved.radii, 2.0 * compass.truth.radii)
    assert Ellipsoid(np.zeros(3), np.diag([1.0, 2.0, 4.0])).mean_radius == pytest.approx(2.0)
