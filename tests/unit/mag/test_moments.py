from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calib.errors import InvalidInputError, UndeterminedError
from calib.mag.moments import Moments


def test_exact_samples_give_the_exact_ellipsoid(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 40), rng, noise=0.0)
    found, noise = Moments.empty(samples.mean(axis=0), 50.0).added(samples).ellipsoid()
    np.testing.assert_allclose(found.offset, compass.truth.offset, atol=1e-8)
    np.testing.assert_allclose(found.shape, compass.truth.shape, atol=1e-8)
    assert noise < 1e-5


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
    from calib.mag.moments import _CORRECTION

    k0, k1, k2 = (_CORRECTION @ (found.gram / found.count).ravel()).reshape(3, 10, 10)
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
