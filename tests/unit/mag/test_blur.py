from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.blur import deblurred, rates_during
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.mag.shape import correction

WINDOW = 0.1


def spins(rng: np.random.Generator, count: int, speed: float) -> tuple[Any, Any, Any]:
    """Body rates (count, 3) that change slowly, times of a 50 Hz gyro, and attitudes ``n from b`` at 400 Hz."""
    knots = rng.normal(size=(count // 100 + 2, 3))
    knots *= speed / np.linalg.norm(knots, axis=1, keepdims=True)
    fine = np.arange(count * 8) / 400.0
    rates = np.stack([np.interp(fine, np.arange(len(knots)) * 2.0, k) for k in knots.T], axis=1)
    steps = Rotation.from_rotvec(rates / 400.0)
    attitude = [Rotation.identity()]
    for step in steps:
        attitude.append(attitude[-1] * step)
    return fine, rates, Rotation.concatenate(attitude[1:])


@pytest.fixture(scope="module")
def tumbling() -> tuple[Any, Any, Any, Any]:
    """Field directions averaged over 100 ms, 10 a second, their times, and the gyro; up to 4 rad/s."""
    rng = np.random.default_rng(3)
    fine, rates, attitude = spins(rng, 3000, 4.0)
    field = attitude.inv().apply([math.cos(1.1), 0.0, math.sin(1.1)])
    mean = field.reshape(-1, 40, 3).mean(axis=1)
    return mean, fine.reshape(-1, 40)[:, -1] + 1 / 400, fine[::8], rates[::8]


def test_a_steady_turn_shrinks_by_the_sinc() -> None:
    """(w tau)^2/24 at first: 3 rad/s over 100 ms are 0.37 %."""
    t = np.arange(0.0, 2.0, 0.02)
    rates = rates_during([1.0], t, np.tile([0.0, 0.0, 3.0], (100, 1)), WINDOW)
    assert rates.shrinkage()[0] == pytest.approx(0.3**2 / 24, rel=0.01)
    assert rates.shrinkage()[0] == pytest.approx(1.0 - math.sin(0.15) / 0.15, rel=1e-9)
    np.testing.assert_allclose(rates.scatter[0], np.diag([0.0, 0.0, 9.0]) * WINDOW**2 / 12, atol=1e-12)
    np.testing.assert_allclose(rates.turn[0], [0.0, 0.0, 0.3], atol=1e-12)


def test_a_turn_that_swells_and_fades_blurs_by_the_scatter_of_its_angle() -> None:
    """Means by quadrature: a rate of 2 + 2 sin(2 pi 0.7 t) rad/s about an axis across the field."""
    omega = 2 * math.pi * 0.7
    t = np.arange(0.0, 4.0, 0.02)
    gyro = np.outer(2.0 + 2.0 * np.sin(omega * t), [0.0, 0.0, 1.0])
    ends = np.arange(0.5, 3.5, 0.1)
    rates = rates_during(ends, t, gyro, WINDOW)
    fine = ends[:, None] - WINDOW * (np.arange(2000) + 0.5) / 2000
    angle = 2.0 * fine - 2.0 / omega * np.cos(omega * fine)
    length = np.hypot(np.cos(angle).mean(axis=1), np.sin(angle).mean(axis=1))
    np.testing.assert_allclose(rates.shrinkage(), 1.0 - length, atol=5e-6)
    assert (1.0 - length).max() > 6e-3
    late = rates_during(ends + 0.004, t, gyro, WINDOW)
    np.testing.assert_allclose(late.adjusted(0.0, 0.004, np.eye(3)).scatter, rates.scatter, atol=2e-5)


def test_deblurring_is_exact_for_a_steady_turn(compass: Any) -> None:
    """Mean over the window by quadrature, then back."""
    model = correction(compass.truth, None)
    spin, middle = np.array([1.0, -2.0, 2.5]), np.array([0.3, 0.5, math.sqrt(1 - 0.34)])
    moments = np.linspace(-WINDOW / 2, WINDOW / 2, 20_001)
    turned = Rotation.from_rotvec(-moments[:, None] * spin).apply(middle)
    mean = (0.5 * (turned[1:] + turned[:-1])).mean(axis=0)
    t = np.arange(0.0, 2.0, 0.02)
    rates = rates_during([1.0], t, np.tile(spin, (100, 1)), WINDOW)
    read = mean @ compass.truth.shape + compass.truth.offset
    expected = middle @ compass.truth.shape + compass.truth.offset
    assert np.abs(read - expected).max() > 0.1
    np.testing.assert_allclose(deblurred(read[None, :], rates, model)[0], expected, atol=1e-6)


@pytest.mark.long
def test_blur_biases_the_fit_and_deblurring_heals_it(compass: Any, tumbling: Any) -> None:
    u, t, gyro_t, gyro = tumbling
    rng = np.random.default_rng(1)
    samples = compass.read(u, rng, noise=0.03)
    truth = correction(compass.truth, None)
    blurred = fit_ellipsoid(samples)
    healed = fit_ellipsoid_deblurred(samples, rates_during(t, gyro_t, gyro, WINDOW))
    radius = compass.truth.mean_radius
    assert abs(blurred.native["expmfs"] / radius - 1.0) > 2e-3
    assert abs(healed.native["expmfs"] / radius - 1.0) < 1.5e-4
    error = healed.values - np.concatenate([truth.offset, truth.matrix.ravel()])
    assert np.abs(error / healed.sd).max() < 4.5
    assert healed.residual_rms < 0.7 * blurred.residual_rms


def test_too_fast_and_unknown_samples_are_left_out() -> None:
    t = np.arange(0.0, 3.0, 0.02)
    gyro = np.zeros((150, 3))
    gyro[t > 1.5] = [20.0, 0.0, 0.0]
    rates = rates_during([-1.0, 1.0, 2.5, 9.0], t, gyro, WINDOW)
    assert rates.known.tolist() == [False, True, True, False]
    assert rates.sharp().tolist() == [False, True, False, False]


def test_a_gap_of_the_gyro_is_not_known() -> None:
    t = np.concatenate([np.arange(0.0, 1.0, 0.02), np.arange(4.0, 5.0, 0.02)])
    ends = [0.5, 2.5, 4.01, 4.5]  # the third window begins before the gap ends
    assert rates_during(ends, t, np.zeros((100, 3)), WINDOW).known.tolist() == [True, False, False, True]


def test_a_compass_that_does_not_average_is_not_blurred() -> None:
    t = np.arange(0.0, 1.0, 0.02)
    rates = rates_during([0.5], t, np.full((50, 3), 9.0), 0.0)
    assert rates.shrinkage()[0] == 0.0
    assert rates.sharp()[0]


@pytest.mark.long
def test_nothing_sharp_is_a_refusal(compass: Any, tumbling: Any) -> None:
    u, t, gyro_t, gyro = tumbling
    samples = compass.read(u, np.random.default_rng(1))
    fit = fit_ellipsoid_deblurred(samples, rates_during(t, gyro_t, 10.0 * gyro, WINDOW), instance=1)
    assert fit.status == FitStatus.REFUSED
    assert fit.instance == 1


@pytest.mark.parametrize(
    ("gyro_t", "gyro", "window"),
    [
        ([0.0, 1.0], np.zeros((3, 3)), 0.1),
        ([0.0], np.zeros((1, 3)), 0.1),
        ([1.0, 0.0], np.zeros((2, 3)), 0.1),
        ([0.0, 1.0], np.full((2, 3), math.nan), 0.1),
        ([0.0, 1.0], np.zeros((2, 3)), -0.1),
    ],
)
def test_wrong_input_is_an_error(gyro_t: Any, gyro: Any, window: float) -> None:
    with pytest.raises(InvalidInputError):
        rates_during([0.5], gyro_t, gyro, window)


def test_rates_of_other_samples_are_an_error() -> None:
    rates = rates_during([0.5], [0.0, 1.0], np.zeros((2, 3)), 0.1)
    with pytest.raises(InvalidInputError, match="rates of 1"):
        fit_ellipsoid_deblurred(np.ones((5, 3)), rates)
