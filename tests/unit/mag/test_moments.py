from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.mag.moments import Moments, adjusted_least_squares, corrections
from mavcal.calib.mag.samples import Cloud
from mavcal.calib.mag.shape import Ellipsoid, six_numbers


def test_exact_samples_give_the_exact_ellipsoid(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 40), rng, noise=0.0)
    found, noise = Moments.empty(samples.mean(axis=0), 50.0).added(samples).ellipsoid()
    np.testing.assert_allclose(found.offset, compass.truth.offset, atol=1e-8)
    np.testing.assert_allclose(found.shape, compass.truth.shape, atol=1e-8)
    assert noise < 1e-5


def test_the_algebraic_fit_of_twelve_points(twelve_points: Any) -> None:
    """Without the correction for noise it is the smallest eigenvector of the ten terms (METHODS)."""
    cloud = Cloud.of(twelve_points)
    theta = np.linalg.eigh(corrections(Moments.of(cloud).gram)[0])[1][:, 0]
    quadratic = np.diag(theta[:3]) + 0.5 * (np.ones((3, 3)) - np.eye(3)) * theta[[[0, 3, 4], [3, 0, 5], [4, 5, 0]]]
    offset = -0.5 * np.linalg.solve(quadratic, theta[6:9])
    values, vectors = np.linalg.eigh(quadratic / (offset @ quadratic @ offset - theta[9]))
    found = Ellipsoid(offset, (vectors / np.sqrt(values)) @ vectors.T).moved(cloud.centre, cloud.scale)
    np.testing.assert_allclose(found.offset, [120.18582, -84.61328, 210.17085], atol=6e-6)
    expected = [551.41066, 450.54855, 499.71978, 30.77567, -17.90751, 25.38172]
    np.testing.assert_allclose(six_numbers(found.shape), expected, atol=6e-6)


def test_one_call_gives_the_first_fit(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 5000), rng)
    found, noise = adjusted_least_squares(samples)
    whole, same = Moments.empty(samples.mean(axis=0), 50.0).added(samples).ellipsoid()
    np.testing.assert_allclose(found.offset, whole.offset, atol=1e-8)
    np.testing.assert_allclose(found.shape, whole.shape, atol=1e-8)
    assert noise == pytest.approx(same)
    with pytest.raises(UndeterminedError, match="too few"):
        adjusted_least_squares(samples[:9])
    with pytest.raises(UndeterminedError, match="plane"):
        adjusted_least_squares(samples * [1.0, 1.0, 0.0])


def test_the_noise_comes_out_and_does_not_bias(compass: Any, rng: np.random.Generator) -> None:
    """At 6 % of noise the plain algebraic fit is off by 15 standard deviations; the adjusted one is not."""
    samples = compass.read(compass.everywhere(rng, 40_000), rng, noise=3.0)
    found, noise = Moments.empty(samples.mean(axis=0), 50.0).added(samples).ellipsoid()
    assert noise == pytest.approx(3.0, rel=0.02)
    np.testing.assert_allclose(found.offset, compass.truth.offset, atol=0.13)
    np.testing.assert_allclose(found.shape, compass.truth.shape, atol=0.17)


def test_the_order_and_the_cuts_do_not_matter(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 20_000), rng)
    empty = Moments.empty(samples.mean(axis=0), 50.0)
    whole = empty.added(samples)
    parts = empty.added(samples[15_000:]).merged(empty.added(samples[:137])).merged(empty.added(samples[137:15_000]))
    np.testing.assert_allclose(parts.gram, whole.gram, rtol=1e-10, atol=1e-9)
    assert parts.count == len(samples)


def test_corrected_moments_are_unbiased() -> None:
    """E t_k(x + e) = x^k to the fourth order, on a case with a closed form: x = 1, noise variance 0.25."""
    rng = np.random.default_rng(1)
    noisy = 1.0 + 0.5 * rng.normal(size=(400_000, 3))
    found = Moments.empty(np.zeros(3), 1.0).added(noisy)
    k0, k1, k2 = corrections(found.gram / found.count)
    corrected = k0 + 0.25 * k1 + 0.25**2 * k2
    np.testing.assert_allclose(corrected, np.ones((10, 10)), atol=0.03)


def test_different_centres_are_not_merged() -> None:
    with pytest.raises(InvalidInputError, match="merged"):
        Moments.empty(np.zeros(3), 1.0).merged(Moments.empty(np.ones(3), 1.0))
    with pytest.raises(InvalidInputError, match="scale"):
        Moments.empty(np.zeros(3), 0.0)


def test_a_hyperboloid_is_refused(rng: np.random.Generator) -> None:
    u = rng.normal(size=(200, 2))
    x, y = u.T
    samples = np.column_stack([x, y, np.sqrt(1.0 + x * x + y * y)])
    with pytest.raises(UndeterminedError, match="ellipsoid"):
        Moments.empty(np.zeros(3), 1.0).added(samples).ellipsoid()
