from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import least_squares

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.mag.distance import Distances, bisquare, foot_points, gauss_newton, score_rows
from mavcal.calib.mag.moments import Moments
from mavcal.calib.mag.samples import Cloud
from mavcal.calib.mag.shape import Ellipsoid, six_numbers, symmetric

SHAPE = np.array([[550.0, 30.0, -20.0], [30.0, 450.0, 25.0], [-20.0, 25.0, 500.0]])


def fitted(samples: Any, *, debias: bool) -> tuple[Ellipsoid, float, float]:
    """Ellipsoid, sum of squared distances and variance, in the unit of the samples."""
    centre, scale = samples.mean(axis=0), float(np.linalg.norm(samples.std(axis=0)))
    scaled = (samples - centre) / scale
    start, noise = Moments.empty(np.zeros(3), 1.0).added(scaled).ellipsoid()
    found = gauss_newton(Distances(Cloud(scaled, np.zeros(3), 1.0)), start, noise**2, debias=debias)
    squares = float(found.last.residuals @ found.last.residuals)
    return found.ellipsoid.moved(centre, scale), squares * scale**2, found.noise_variance * scale**2


def test_foot_point_of_a_point_far_outside() -> None:
    """METHODS 3.1: (700, 200, 300) is 102.2309879655 off along (.8540154345, .4880242998, .1802496058)."""
    axes, frame = np.linalg.eigh(SHAPE)
    point = np.array([[700.0, 200.0, 300.0]]) - [120.0, -85.0, 210.0]
    t, w = foot_points(frame.T @ point.T, axes)
    length = np.linalg.norm(w)
    np.testing.assert_allclose(t * length, 102.2309879655, atol=1e-9)
    np.testing.assert_allclose((frame @ w)[:, 0] / length, [0.8540154345, 0.4880242998, 0.1802496058], atol=1e-10)


@given(arrays(np.float64, (5, 3), elements=st.floats(-30.0, 30.0)))
def test_a_foot_point_lies_on_the_ellipsoid_and_the_way_there_is_normal(points: Any) -> None:
    axes = np.array([3.0, 4.0, 6.0])
    # Nearer to the middle than (a^2 - c^2)/a = 4.5 of 6 the nearest point is no longer unique.
    outside = points[np.linalg.norm(points / axes, axis=1) > 0.8]
    if not len(outside):
        return
    t, w = foot_points(outside.T, axes)
    feet = (axes**2)[:, None] * w
    np.testing.assert_allclose(((feet.T / axes) ** 2).sum(axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(outside.T - feet, t * w, atol=1e-9)


def test_maximum_likelihood_of_twelve_points(twelve_points: Any) -> None:
    found, squares, variance = fitted(twelve_points, debias=False)
    np.testing.assert_allclose(found.offset, [120.21501, -84.61668, 210.19949], atol=2e-5)
    expected = [551.44302, 450.52481, 499.68104, 30.74370, -17.84263, 25.34086]
    np.testing.assert_allclose(six_numbers(found.shape), expected, atol=2e-5)
    assert squares == pytest.approx(6.164854150, abs=1e-7)
    assert variance == pytest.approx(2.054952, abs=1e-5)


def test_debiased_fit_of_twelve_points(twelve_points: Any) -> None:
    found, _, _ = fitted(twelve_points, debias=True)
    np.testing.assert_allclose(found.offset, [120.21501, -84.61666, 210.19948], atol=2e-5)
    expected = [551.43792, 450.52142, 499.67676, 30.74321, -17.84229, 25.34038]
    np.testing.assert_allclose(six_numbers(found.shape), expected, atol=5e-5)


def test_a_second_route_finds_the_same_ellipsoid(compass: Any, rng: np.random.Generator) -> None:
    """scipy's Levenberg-Marquardt over centre, shape and one foot direction a sample, which shares no formula."""
    samples = compass.read(compass.everywhere(rng, 25), rng, noise=1.0)

    def errors(parameters: Any) -> Any:
        b, six, directions = parameters[:3], parameters[3:9], parameters[9:].reshape(-1, 3)
        units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        return (samples - b - units @ symmetric(six)).ravel()

    start = np.concatenate([samples.mean(axis=0), [50.0, 50.0, 50.0, 0.0, 0.0, 0.0]])
    directions = (samples - samples.mean(axis=0)) / 50.0
    other = least_squares(errors, np.concatenate([start, directions.ravel()]), xtol=1e-14, ftol=1e-14, gtol=1e-12)
    found, squares, _ = fitted(samples, debias=False)
    np.testing.assert_allclose(found.offset, other.x[:3], atol=2e-5)
    np.testing.assert_allclose(six_numbers(found.shape), other.x[3:9], atol=2e-5)
    assert squares == pytest.approx(2.0 * other.cost, rel=1e-8)


def test_derivatives_equal_differences(compass: Any, rng: np.random.Generator) -> None:
    samples = compass.read(compass.everywhere(rng, 6), rng, noise=2.0) / 50.0
    truth = Ellipsoid(compass.truth.offset / 50.0, compass.truth.shape / 50.0)
    rows = score_rows(samples, truth)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        up, down = (
            Distances(Cloud(samples, np.zeros(3), 1.0)).at(truth.stepped(s), 0.0, None).residuals for s in (step, -step)
        )
        np.testing.assert_allclose(rows[k], (down - up) / 2e-6, atol=1e-7)


def test_distances_of_noise_are_biased_by_the_curvature() -> None:
    """On a sphere of radius 490 and at 10 of noise: s^2/R = 0.2041; measured 0.1960 by METHODS 3.1."""
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    samples = directions + 10.0 / 490.0 * rng.normal(size=directions.shape)
    sphere = Ellipsoid(np.zeros(3), np.eye(3))
    plain = Distances(Cloud(samples, np.zeros(3), 1.0)).at(sphere, 0.0, None).residuals.mean() * 490.0
    corrected = (
        Distances(Cloud(samples, np.zeros(3), 1.0)).at(sphere, (10.0 / 490.0) ** 2, None).residuals.mean() * 490.0
    )
    assert plain == pytest.approx(0.204, abs=0.08)
    assert abs(corrected) < 0.08
    assert plain > 0.12


def test_bisquare_is_one_inside_and_nothing_outside() -> None:
    weights, loss = bisquare(np.array([0.0, 1.0, 4.0, 5.0, 50.0]), 1.0)
    assert weights[0] == 1.0
    assert 0.9 < weights[1] < 1.0
    assert 0.0 < weights[2] < 0.1
    np.testing.assert_array_equal(weights[3:], 0.0)
    np.testing.assert_allclose(loss[3:], 4.685**2 / 3.0)


def test_a_start_that_cannot_settle_is_refused(rng: np.random.Generator) -> None:
    line = np.column_stack([np.linspace(-1.0, 1.0, 50), 1e-4 * rng.normal(size=(50, 2))])
    with pytest.raises(UndeterminedError):
        gauss_newton(Distances(Cloud(line, np.zeros(3), 1.0)), Ellipsoid(np.zeros(3), np.eye(3)), 1e-6)
