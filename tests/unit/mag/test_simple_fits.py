"""Sphere, ellipsoid along the axes, minimum and maximum: the specified methods with their digits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.simple_fits import (
    fit_ellipsoid_axis,
    fit_minmax,
    fit_sphere,
    half_range,
    normal_equations,
    offset_and_radii,
    solve_coefficients,
    solve_sphere,
)

CENTRE = np.array([10.0, -20.0, 30.0])
DIRECTIONS = np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.8, 0.0], [0.0, 0.6, 0.8]]])
NINE = np.vstack([DIRECTIONS, [[0.8, 0.0, -0.6]]])


def sphere_samples(rng: np.random.Generator, count: int, noise: float) -> Any:
    u = rng.normal(size=(count, 3))
    return CENTRE + 50.0 * u / np.linalg.norm(u, axis=1, keepdims=True) + noise * rng.normal(size=(count, 3))


def test_sphere_vector() -> None:
    """METHODS S1: c +- 50 e_i and two oblique points give offset (10, -20, 30) and radius 50."""
    samples = CENTRE + 50.0 * DIRECTIONS
    offset, radius = solve_sphere(samples)
    np.testing.assert_allclose(offset, CENTRE, atol=1e-12)
    assert radius == pytest.approx(50.0)
    fit = fit_sphere(samples)
    np.testing.assert_allclose(fit.model.offset, CENTRE, atol=1e-12)
    np.testing.assert_allclose(fit.model.matrix, np.eye(3), atol=1e-12)
    assert fit.native["radius"] == pytest.approx(50.0)


@pytest.mark.long
def test_axis_ellipsoid_vector() -> None:
    """METHODS S1, every intermediate number; uncentred, as printed there."""
    samples = CENTRE + NINE * [60.0, 50.0, 40.0]
    normal, right = normal_equations(samples)
    np.testing.assert_allclose(right, [13380, 8300, 13380, 174, -110, 278], rtol=1e-12)
    np.testing.assert_allclose(normal[0], [46103952, 5822000, 9749904, 515448, -179960, 323864], rtol=1e-12)
    factor = [6789.9891016113, 5005.4768735210, 6209.6733036759, 86.3834365516, 56.2054640034, 7.5602608059]
    np.testing.assert_allclose(np.diag(np.linalg.cholesky(normal)), factor, rtol=1e-9)
    coefficients = solve_coefficients(normal, right)
    expected = [0.0011123471, 0.0016017798, 0.0025027809, -0.022246941, 0.0640711902, -0.1501668521]
    np.testing.assert_allclose(coefficients, expected, atol=5e-11)
    offset, radii = offset_and_radii(coefficients)
    np.testing.assert_allclose(offset, CENTRE, atol=1e-8)
    np.testing.assert_allclose(radii, [60.0, 50.0, 40.0], atol=1e-8)


def test_axis_ellipsoid_fit_of_the_vector() -> None:
    fit = fit_ellipsoid_axis(CENTRE + NINE * [60.0, 50.0, 40.0])
    np.testing.assert_allclose(fit.native["offset"], CENTRE, atol=1e-9)
    np.testing.assert_allclose(fit.native["sensitivities"], [1.0, 1.2, 1.5], atol=1e-10)
    np.testing.assert_allclose(fit.native["axis_radii"], [60.0, 50.0, 40.0], atol=1e-9)


@pytest.mark.parametrize("centre", [(70.0, 0.0, 0.0), (60.0, 0.0, 0.0), (1e4, -1e4, 1e4)])
def test_axis_ellipsoid_anywhere(centre: tuple[float, float, float]) -> None:
    """Outside of the origin, through the origin (where the form "= 1" breaks down uncentred), and far away."""
    fit = fit_ellipsoid_axis(np.array(centre) + NINE * [60.0, 50.0, 40.0])
    np.testing.assert_allclose(fit.native["offset"], centre, atol=1e-6)
    np.testing.assert_allclose(fit.native["axis_radii"], [60.0, 50.0, 40.0], atol=1e-6)


def test_negative_coefficients_are_an_ellipsoid_too() -> None:
    """METHODS S1: centre (70, 0, 0) gives a, b, c < 0 with a = -0.000769."""
    coefficients = solve_coefficients(*normal_equations(np.array([70.0, 0.0, 0.0]) + NINE * [60.0, 50.0, 40.0]))
    assert coefficients[0] == pytest.approx(-0.000769, abs=1e-6)
    offset, radii = offset_and_radii(coefficients)
    np.testing.assert_allclose(offset, [70.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(radii, [60.0, 50.0, 40.0], atol=1e-6)


def test_minmax_vector() -> None:
    """METHODS S5."""
    rows = np.array([[300, -120, 60], [-180, 310, 40], [60, 80, -400], [40, 100, 420]], dtype=np.float64)
    offset, half = half_range(rows)
    np.testing.assert_array_equal(offset, [60.0, 95.0, 10.0])
    np.testing.assert_array_equal(half, [240.0, 215.0, 410.0])
    native = fit_minmax(CENTRE + NINE * [60.0, 50.0, 40.0]).native
    np.testing.assert_allclose(native["offset"], CENTRE)
    np.testing.assert_allclose(native["half_range"], [60.0, 50.0, 40.0])


@pytest.mark.parametrize("fit", [fit_sphere, fit_ellipsoid_axis])
def test_stated_uncertainty_holds(fit: Any) -> None:
    """95 % intervals of the offset on a sphere, over 150 runs."""
    rng, held = np.random.default_rng(8), 0
    for _ in range(150):
        found = fit(sphere_samples(rng, 200, 0.5))
        held += int(np.count_nonzero(np.abs(found.model.offset - CENTRE) < 1.96 * found.sd[:3]))
    assert held / 450 == pytest.approx(0.95, abs=2.5 * math.sqrt(0.95 * 0.05 / 450))


def test_minmax_states_at_least_its_error() -> None:
    rng, held = np.random.default_rng(9), 0
    for _ in range(60):
        found = fit_minmax(sphere_samples(rng, 500, 0.5))
        held += int(np.count_nonzero(np.abs(found.model.offset - CENTRE) < 1.96 * found.sd[:3]))
    assert held / 180 > 0.9


def test_axis_radii_uncertainty_holds() -> None:
    rng, held = np.random.default_rng(10), 0
    truth = np.cbrt(60.0 * 50.0 * 40.0) / np.array([60.0, 50.0, 40.0])
    for _ in range(150):
        u = rng.normal(size=(300, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        found = fit_ellipsoid_axis(CENTRE + u * [60.0, 50.0, 40.0] + 0.3 * rng.normal(size=u.shape))
        held += int(np.count_nonzero(np.abs(np.diag(found.model.matrix) - truth) < 1.96 * found.sd[[3, 7, 11]]))
    assert held / 450 == pytest.approx(0.95, abs=3.0 * math.sqrt(0.95 * 0.05 / 450))


def test_soft_iron_that_a_simple_form_leaves_in_is_not_hidden(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 3000), rng, noise=0.05)
    sphere, axis = fit_sphere(samples, noise_sd=0.05), fit_ellipsoid_axis(samples, noise_sd=0.05)
    for fit in (sphere, axis):
        assert fit.quality["residual_rms"] > 0.5
        assert any("times the noise" in w for w in fit.warnings)
    assert any("cross terms" in w for w in axis.warnings)


@pytest.mark.parametrize("fit", [fit_sphere, fit_ellipsoid_axis, fit_minmax])
class TestHostileInput:
    def test_not_finite(self, fit: Any) -> None:
        with pytest.raises(InvalidInputError, match="finite"):
            fit([[1.0, 2.0, math.inf]] * 20)

    def test_wrong_shape(self, fit: Any) -> None:
        with pytest.raises(InvalidInputError, match="shape"):
            fit([[1.0, 2.0]] * 20)

    @pytest.mark.parametrize(
        ("samples", "word"),
        [
            (np.ones((40, 3)), "same"),
            (np.eye(3), "too few"),
            (np.random.default_rng(1).normal(size=(40, 3)) * [1.0, 1.0, 1e-4], "one plane"),
            (np.random.default_rng(1).normal(size=(40, 3)) * [1.0, 1e-4, 1e-4], "line"),
            (np.empty((0, 3)), "too few"),
        ],
    )
    def test_refused(self, fit: Any, samples: Any, word: str) -> None:
        found = fit(samples, instance=1, unit="counts")
        assert found.status == FitStatus.REFUSED
        assert word in found.message
        assert (found.instance, found.unit) == (1, "counts")

    def test_a_cloud_is_no_shell(self, fit: Any) -> None:
        assert fit(np.random.default_rng(2).normal(size=(200, 3))).status == FitStatus.REFUSED


def test_a_dead_axis_is_named() -> None:
    rng = np.random.default_rng(3)
    samples = sphere_samples(rng, 50, 0.1)
    samples[:, 1] = 4.0
    fit = fit_minmax(samples)
    assert fit.status == FitStatus.REFUSED
    assert "axis y" in fit.message


def test_no_ellipsoid_is_no_solution() -> None:
    with pytest.raises(UndeterminedError):
        offset_and_radii(np.array([1.0, 1.0, -1.0, 0.0, 0.0, 0.0]))
    with pytest.raises(UndeterminedError):
        solve_coefficients(np.zeros((6, 6)), np.zeros(6))
