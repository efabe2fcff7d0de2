from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import norm

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Channel, Rounding, Sensor, Stage
from mavcal.calib.stats.quantisation import half_widths, impute, interval_regression, mean_of, with_apparent_quantum


def truncated(x: np.ndarray, quantum: float = 1.0) -> Channel:
    """What a stream of integers makes of `x` (N, k): truncated toward zero, carried at the middle of the bin."""
    x = np.asarray(x, dtype=float)
    x = x[:, None] if x.ndim == 1 else x
    k = np.trunc(x / quantum)
    return Channel(
        Sensor.GYRO,
        0,
        np.arange(len(x)) * 0.02,
        (k + 0.5 * np.sign(k)) * quantum,
        "rad/s",
        Stage.RAW,
        "test",
        quantum=quantum,
        rounding=Rounding.TOWARD_ZERO,
        zero_bin=k == 0,
    )


def rounded(x: np.ndarray) -> Channel:
    x = np.asarray(x, dtype=float)[:, None]
    return Channel(
        Sensor.GYRO,
        0,
        np.arange(len(x)) * 1.0,
        np.round(x),
        "1",
        Stage.RAW,
        "test",
        quantum=1.0,
        rounding=Rounding.NEAREST,
    )


def test_bins_are_two_quanta_wide_around_zero():
    channel = truncated(np.array([-1.2, -0.7, 0.4, 1.9]))
    assert channel.values[:, 0].tolist() == [-1.5, 0.0, 0.0, 1.5]
    assert half_widths(channel)[:, 0].tolist() == [0.5, 1.0, 1.0, 0.5]


def test_without_quantisation_it_is_the_mean():
    rng = np.random.default_rng(1)
    x = rng.normal(size=(5000, 3)) * [1.0, 2.0, 3.0] + [5.0, -1.0, 0.0]
    channel = dataclasses.replace(truncated(x), values=x, quantum=0.0, zero_bin=None, rounding=Rounding.NONE)
    result = mean_of(channel)
    assert result.mean == pytest.approx(x.mean(axis=0), abs=1e-12)
    assert np.sqrt(np.diag(result.covariance)) == pytest.approx(x.std(axis=0, ddof=1) / np.sqrt(5000), rel=0.15)
    assert result.constant == (False, False, False)


@pytest.mark.parametrize(("mu", "quiet"), [(0.1, 0.5), (0.1, 0.8), (0.7, 0.5), (0.7, 0.8), (3.3, 0.3), (3.3, 0.5)])
def test_no_bias_where_the_plain_mean_has_one(mu, quiet):
    rng = np.random.default_rng(7)
    n = 20_000
    channel = truncated(mu + quiet * rng.normal(size=n))
    result = mean_of(channel)
    sd = float(np.sqrt(result.covariance[0, 0]))
    assert abs(result.mean[0] - mu) < 4.0 * sd
    assert sd < 0.02
    if mu == 0.7:
        assert abs(channel.values.mean() - mu) > 8.0 * sd  # the zero bin pulls the plain mean by a fifth of a quantum


@pytest.mark.parametrize("s", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("centre", [0.0, 3.5])
def test_the_stated_sd_holds(s, centre):
    rng = np.random.default_rng(8)
    z = []
    for _ in range(150):
        mu = centre + rng.uniform(-1.0, 1.0)
        result = mean_of(truncated(mu + s * rng.normal(size=120)))
        z.append((result.mean[0] - mu) / np.sqrt(result.covariance[0, 0]))
    assert 0.1 < np.mean(np.square(z)) < 1.7
    assert np.max(np.abs(z)) < 5.0


@pytest.mark.parametrize(("value", "width", "middle"), [(0.0004, 2.0, 0.0), (1.2, 1.0, 1.5), (-4.4, 1.0, -4.5)])
def test_one_bin_says_that_the_number_is_in_it_and_no_more(value, width, middle):
    result = mean_of(truncated(np.full(400, value)))
    assert result.mean[0] == middle
    assert result.covariance[0, 0] == pytest.approx(width**2 / 12.0)
    assert result.constant == (True,)
    assert np.isnan(result.sd[0])
    assert result.n_effective == 400


def test_two_bins_tell_the_edge_between_them():
    x = np.where(np.arange(1000) % 2, 3.4, 2.6)
    result = mean_of(truncated(x))
    assert result.mean[0] == pytest.approx(3.0, abs=0.01)
    lopsided = mean_of(truncated(np.where(np.arange(1000) % 100, 3.4, 2.6)))
    assert 3.0 < lopsided.mean[0] < 3.6
    assert np.sqrt(lopsided.covariance[0, 0]) > 0.05  # the noise is not known, so neither is the distance from the edge


def test_rounding_to_nearest_has_plain_bins():
    rng = np.random.default_rng(9)
    result = mean_of(rounded(0.3 + 0.4 * rng.normal(size=5000)))
    assert result.mean[0] == pytest.approx(0.3, abs=0.03)


def test_correlated_samples_are_worth_less():
    rng = np.random.default_rng(10)
    x = np.convolve(rng.normal(size=4003), np.ones(4) / 2.0, mode="valid")
    result = mean_of(truncated(5.3 + 2.0 * x))
    assert result.n_effective == pytest.approx(1000, rel=0.35)


def test_noise_across_a_frame_does_not_count_along_it():
    rng = np.random.default_rng(11)
    direction = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    across = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    sway = np.sin(np.linspace(0.0, 6.0, 600))
    x = 5.0 * direction + sway[:, None] * across + 0.01 * rng.normal(size=(600, 3))
    channel = dataclasses.replace(truncated(x), values=x, quantum=0.0, zero_bin=None, rounding=Rounding.NONE)
    frame = np.column_stack([direction, across, [0.0, 0.0, 1.0]])
    result = mean_of(channel, frame=frame)
    assert np.sqrt(direction @ result.covariance @ direction) < 0.001
    assert np.sqrt(across @ result.covariance @ across) > 0.1


@given(shift=st.integers(2, 50), seed=st.integers(0, 1000))
def test_a_shift_by_whole_quanta_shifts_the_mean(shift, seed):
    rng = np.random.default_rng(seed)
    x = 2.5 + 0.4 * rng.normal(size=80)
    x = x[x > 1.0]
    assert mean_of(truncated(x + shift)).mean - shift == pytest.approx(mean_of(truncated(x)).mean, abs=1e-6)


@given(scale=st.floats(1e-4, 1e4), seed=st.integers(0, 1000))
def test_another_unit_scales_the_answer(scale, seed):
    x = 0.4 + 0.6 * np.random.default_rng(seed).normal(size=60)
    one, other = mean_of(truncated(x)), mean_of(truncated(x * scale, quantum=scale))
    assert other.mean == pytest.approx(one.mean * scale, rel=1e-5, abs=1e-9 * scale)
    assert other.covariance == pytest.approx(one.covariance * scale**2, rel=1e-3)


def test_the_mirror_image_has_the_mirrored_mean():
    x = 0.8 + 0.5 * np.random.default_rng(12).normal(size=300)
    assert mean_of(truncated(-x)).mean == pytest.approx(-mean_of(truncated(x)).mean, abs=1e-9)


def test_interval_regression_is_the_maximum_that_scipy_finds():
    rng = np.random.default_rng(13)
    x = np.linspace(-1.0, 1.0, 300)
    channel = truncated(0.3 + 1.1 * x + 0.35 * rng.normal(size=300))
    y, half = channel.values[:, 0], half_widths(channel)[:, 0]
    X = np.column_stack([np.ones(300), x])
    fit = interval_regression(X, y, half, smallest=0.02)

    def cost(p):
        mu, s = X @ p[:2], np.exp(p[2])
        return -np.log(np.maximum(norm.cdf((y + half - mu) / s) - norm.cdf((y - half - mu) / s), 1e-300)).sum()

    best = minimize(
        cost, [0.3, 1.1, np.log(0.4)], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000}
    )
    assert fit.coefficients == pytest.approx(best.x[:2], abs=1e-5)
    assert fit.sigma == pytest.approx(np.exp(best.x[2]), rel=1e-4)
    assert not fit.at_limit


def test_weights_are_repetitions():
    values, half = np.array([0.5, 1.5, 2.5]), np.full(3, 0.5)
    counts = np.array([3, 10, 4])
    one = interval_regression(np.ones((3, 1)), values, half, weights=counts, smallest=0.02)
    all_rows = interval_regression(np.ones((17, 1)), np.repeat(values, counts), np.full(17, 0.5), smallest=0.02)
    assert one.coefficients == pytest.approx(all_rows.coefficients, abs=1e-9)
    assert one.sigma == pytest.approx(all_rows.sigma, rel=1e-7)


def test_noiseless_data_stop_at_the_least_noise():
    x = np.linspace(0.0, 20.0, 400)
    fit = interval_regression(np.column_stack([np.ones(400), x]), np.floor(x) + 0.5, np.full(400, 0.5), smallest=0.02)
    assert fit.at_limit
    assert fit.coefficients == pytest.approx([0.0, 1.0], abs=0.05)


def test_imputed_numbers_are_the_conditional_expectation_and_variance():
    value, half, expected, sigma = 1.5, 0.5, 0.9, 0.4
    mass = quad(lambda u: norm.pdf(u, expected, sigma), 1.0, 2.0)[0]
    mean = quad(lambda u: u * norm.pdf(u, expected, sigma), 1.0, 2.0)[0] / mass
    variance = quad(lambda u: (u - mean) ** 2 * norm.pdf(u, expected, sigma), 1.0, 2.0)[0] / mass
    found = impute(np.array([value]), np.array([half]), np.array([expected]), sigma)
    assert found[0][0] == pytest.approx(mean, abs=1e-12)
    assert found[1][0] == pytest.approx(variance, abs=1e-12)


def test_imputing_far_from_the_bin_stays_in_the_bin():
    mean, variance = impute(np.array([0.5, 0.5]), np.array([0.5, 0.5]), np.array([1e3, -1e3]), 0.1)
    assert mean == pytest.approx([1.0, 0.0], abs=1e-4)
    assert (variance >= 0.0).all()


@pytest.mark.parametrize("values", [np.zeros((0, 3)), np.zeros((1, 3)), np.array([[1.0], [np.nan], [2.0]])])
def test_too_few_or_not_finite_samples_are_an_input_error(values):
    channel = Channel(Sensor.GYRO, 0, np.arange(len(values)) * 1.0, values, "rad/s", Stage.RAW, "test")
    with pytest.raises(InvalidInputError, match="two finite samples"):
        mean_of(channel)


@pytest.mark.parametrize(("noise", "bias"), [(0.2, 0.1445), (0.3, 0.0539), (0.4, 0.0135), (0.5, 0.0023)])
def test_the_bias_of_the_plain_mean_and_what_is_left_of_it(noise, bias):
    """The largest bias of a mean of rounded samples, (1/pi) exp(-2 pi^2 s^2/q^2) quanta, beside ours."""
    k = np.arange(-3, 4)
    places = np.linspace(0.0, 0.5, 101)
    chance = norm.cdf((k + 0.5 - places[:, None]) / noise) - norm.cdf((k - 0.5 - places[:, None]) / noise)
    assert np.abs(chance @ k - places).max() == pytest.approx(bias, abs=6e-4)  # the first harmonic alone
    worst = float(places[np.argmax(np.abs(chance @ k - places))])
    rng = np.random.default_rng(14)
    errors = [mean_of(rounded(worst + noise * rng.normal(size=4000))).mean[0] - worst for _ in range(20)]
    assert abs(np.mean(errors)) < 0.5 * bias + 3.0 * np.std(errors) / np.sqrt(20)
    anywhere = rng.uniform(0.0, 1.0, 40)
    ours = [mean_of(rounded(place + noise * rng.normal(size=1000))) for place in anywhere]
    z = [(m.mean[0] - place) / np.sqrt(m.covariance[0, 0]) for m, place in zip(ours, anywhere, strict=True)]
    assert np.mean(np.square(z)) < 2.0


def test_numbers_that_another_program_rounded_show_their_quantum():
    x = 9.0 + 3.0 * np.random.default_rng(40).normal(size=(2000, 3))
    smooth = dataclasses.replace(truncated(x), quantum=0.0, values=x)
    assert with_apparent_quantum(smooth).quantum == 0.0
    rounded = dataclasses.replace(smooth, values=np.round(x / 0.25) * 0.25)
    assert with_apparent_quantum(rounded).quantum == pytest.approx(0.25)
    stated = dataclasses.replace(rounded, quantum=0.5)
    assert with_apparent_quantum(stated) is stated
    constant = dataclasses.replace(smooth, values=np.ones((2000, 3)))
    assert with_apparent_quantum(constant).quantum == 0.0


@pytest.mark.parametrize(("n", "found"), [(99, 0.0), (100, 0.25)])
def test_a_grid_is_told_from_a_hundred_numbers_on(n, found):
    x = np.round(np.random.default_rng(41).normal(size=(n, 3)) / 0.25) * 0.25
    smooth = dataclasses.replace(truncated(x), quantum=0.0, values=x, rounding=Rounding.NONE, zero_bin=None)
    shown = with_apparent_quantum(smooth)
    assert shown.quantum == found
    assert shown.rounding == (Rounding.NEAREST if found else Rounding.NONE)


@pytest.mark.parametrize(("levels", "found"), [(50, 1.0), (51, 0.0)])
def test_numbers_must_repeat_four_times_each_to_show_a_grid(levels, found):
    x = np.resize(np.arange(float(levels)), 200)[:, None]
    smooth = dataclasses.replace(truncated(x), quantum=0.0, values=x, rounding=Rounding.NONE, zero_bin=None)
    assert with_apparent_quantum(smooth).quantum == found


def test_levels_that_are_no_multiples_of_one_step_are_no_grid():
    x = np.resize([0.0, 1.0, 2.4, 3.4], 200)[:, None]
    smooth = dataclasses.replace(truncated(x), quantum=0.0, values=x, rounding=Rounding.NONE, zero_bin=None)
    assert with_apparent_quantum(smooth).quantum == 0.0
    gaps = np.where(x > 2.0, x + 1.6, x)  # 0, 1, 4, 5: steps are missing, the grid is whole
    assert with_apparent_quantum(dataclasses.replace(smooth, values=gaps)).quantum == pytest.approx(1.0)


def test_the_coarsest_axis_is_the_quantum_of_all():
    x = np.column_stack([np.resize(np.arange(5.0) * step, 200) for step in (0.1, 0.4, 0.2)])
    smooth = dataclasses.replace(truncated(x), quantum=0.0, values=x, rounding=Rounding.NONE, zero_bin=None)
    assert with_apparent_quantum(smooth).quantum == pytest.approx(0.4)


def test_only_truncation_widens_the_bin_around_zero():
    channel = truncated(np.array([-0.4, 0.4, 1.4]))
    assert half_widths(dataclasses.replace(channel, rounding=Rounding.NEAREST))[:, 0].tolist() == [0.5, 0.5, 0.5]
    assert half_widths(dataclasses.replace(channel, quantum=0.0))[:, 0].tolist() == [0.0, 0.0, 0.0]


def test_the_variance_along_an_axis_is_that_of_the_mean():
    rng = np.random.default_rng(42)
    x = rng.normal(size=(500, 3)) @ np.array([[1.0, 0.3, 0.0], [0.0, 2.0, -0.5], [0.0, 0.0, 0.5]])
    channel = dataclasses.replace(truncated(x), values=x, quantum=0.0, zero_bin=None, rounding=Rounding.NONE)
    result = mean_of(channel)
    for axis in np.eye(3):
        assert result.variance_along(axis) == pytest.approx(axis @ result.covariance @ axis)
    oblique = np.array([0.6, 0.0, 0.8])
    assert result.variance_along(oblique) == pytest.approx((x @ oblique).var(ddof=1) / 500, rel=0.3)
    assert result.variance_along(-oblique) == pytest.approx(result.variance_along(oblique))


def test_a_bin_that_no_noise_leaves_counts_along_its_own_axis():
    x = np.column_stack([np.full(200, 3.2), 5.0 * np.random.default_rng(43).normal(size=200)])
    result = mean_of(truncated(x))
    assert result.constant == (True, False)
    assert result.variance_along(np.array([1.0, 0.0])) == pytest.approx(1.0 / 12.0)
    assert result.variance_along(np.array([0.0, 1.0])) == pytest.approx(result.covariance[1, 1])


def test_the_influence_of_samples_scatters_as_the_coefficients_do():
    rng = np.random.default_rng(44)
    x = np.linspace(-1.0, 1.0, 200)
    X = np.column_stack([np.ones(200), x])
    z = []
    for _ in range(60):
        channel = truncated(5.3 + 0.8 * x + 0.4 * rng.normal(size=200))
        fit = interval_regression(X, channel.values[:, 0], half_widths(channel)[:, 0], smallest=0.02)
        z.append((fit.coefficients - (5.3, 0.8)) / np.sqrt((fit.influence**2).sum(axis=0)))
    assert 0.7 < np.mean(np.square(z)) < 1.35
