from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter

from mavcal.calib.stats.correlated import _random_walk, coloured_covariance, long_run_variance
from tests.examples import examples


def test_white_noise_keeps_its_variance():
    rng = np.random.default_rng(1)
    ratios = [long_run_variance(rng.normal(size=200)) for _ in range(200)]
    assert np.mean(ratios) == pytest.approx(1.05, abs=0.05)


@pytest.mark.parametrize("phi", [0.5, 0.8, 0.9])
def test_an_autoregression_of_known_long_run_variance(phi):
    rng = np.random.default_rng(2)
    x = lfilter([1.0], [1.0, -phi], rng.normal(size=20_000))
    assert long_run_variance(x) == pytest.approx(1.0 / (1.0 - phi) ** 2, rel=0.15)


def test_means_of_filtered_noise_scatter_as_said():
    rng = np.random.default_rng(3)
    b, a = butter(2, 20.0 / 125.0)
    squares = []
    for _ in range(300):
        x = lfilter(b, a, rng.normal(size=1200))[200:]
        squares.append(x.mean() ** 2 * len(x) / long_run_variance(x))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.25)


def test_drift_between_blocks_counts_although_no_order_sees_it():
    rng = np.random.default_rng(4)
    x = rng.normal(size=4096) + 2.0 * np.sin(2 * np.pi * np.arange(4096) / 4096)
    assert long_run_variance(x) > 100.0


def test_a_constant_series_has_none_and_a_short_one_its_variance():
    assert long_run_variance(np.full(100, 3.0)) == 0.0
    assert long_run_variance(np.array([1.0, 2.0, 3.0])) == pytest.approx(1.0)


def test_no_series_is_worth_less_than_one_sample():
    x = np.repeat([0.0, 1.0], 500)
    assert long_run_variance(x) <= len(x) * x.var(ddof=1) * (1 + 1e-12)


def regression(rng: np.random.Generator, walk: float, blocks: int = 48, per_block: int = 20):
    """Error of a straight line's slope, in its own standard deviations, under white noise and a random walk."""
    n = blocks * per_block
    t = np.arange(n) / n
    X = np.column_stack([np.ones(n), np.sin(3.0 * t)])
    e = rng.normal(size=(n, 1)) + walk * np.cumsum(rng.normal(size=(n, 1)), axis=0) / np.sqrt(n)

    def means(a):
        return a.reshape(blocks, per_block, -1).mean(axis=1)

    gram = X.T @ X
    slope = np.linalg.solve(gram, X.T @ e)[1, 0]
    found = coloured_covariance(means(X), means(e), np.full(blocks, 20.0), means(t[:, None])[:, 0], gram=gram)
    return slope / np.sqrt(found.covariances[0, 1, 1]), found


@pytest.mark.parametrize(("walk", "least", "most"), [(0.0, 0.4, 1.3), (3.0, 0.5, 1.8), (30.0, 0.6, 1.6)])
def test_the_covariance_of_least_squares_holds_under_a_random_walk(walk, least, most):
    rng = np.random.default_rng(5)
    normalised = [regression(rng, walk)[0] for _ in range(200)]
    assert least < np.mean(np.square(normalised)) < most


def warm_ups(walk: float, seeds: int, *, ratios=(1.0, 1.0, 1.0)) -> np.ndarray:
    """Errors of cubics in their own sd, three axes a warm-up one way, under white noise and walks."""
    rng = np.random.default_rng(11)
    blocks, fine, samples = 64, 20, 700.0
    time = np.linspace(0.0, 700.0, blocks * fine)
    warmth = 75.0 - 53.0 * np.exp(-time / 300.0)
    x = (warmth - warmth.mean()) / (0.5 * np.ptp(warmth))
    powers = x[:, None] ** np.arange(4)
    design = powers.reshape(blocks, fine, 4).mean(axis=1)
    gram = powers.T @ powers * (blocks * samples / len(powers))
    middles = time.reshape(blocks, fine).mean(axis=1)
    steps = walk * np.array(ratios) * np.sqrt(700.0 / len(time))
    errors = []
    for _ in range(seeds):
        wander = np.cumsum(rng.normal(size=(len(time), 3)) * steps, axis=0).reshape(blocks, fine, 3).mean(axis=1)
        y = wander + rng.normal(size=(blocks, 3)) / np.sqrt(samples)
        found = coloured_covariance(design, y, np.full(blocks, samples), middles, gram=gram)
        sd = np.sqrt(np.einsum("kpp->kp", found.covariances))
        errors.append(np.linalg.lstsq(design, y, rcond=None)[0].T[:, 1:] / sd[:, 1:])
    return np.array(errors)


@pytest.mark.sampled
@pytest.mark.parametrize(("walk", "ratios"), [(0.005, (1.0, 1.0, 1.0)), (0.006, (0.7, 1.0, 1.4))])
def test_the_worst_walk_hides_in_no_drift_of_a_warm_up(walk, ratios):
    """The axes of a sensor tell each other: alone, one in forty of such drifts was off by more than 4.5 sd."""
    errors = warm_ups(walk, 500, ratios=ratios)
    assert np.mean(np.abs(errors).max(axis=2) > 4.5) < 0.01
    assert np.mean(errors**2) < 1.6


def test_white_noise_is_not_taken_for_a_walk_three_times_over():
    assert 0.3 < np.mean(warm_ups(0.0, 300) ** 2) < 1.2


def test_an_axis_that_reads_nothing_has_no_say():
    rng = np.random.default_rng(12)
    design = np.column_stack([np.ones(40), np.linspace(-1.0, 1.0, 40)])
    y = np.column_stack([rng.normal(size=40), np.full(40, 0.3), np.full(40, 0.3)])
    counts, time, gram = np.full(40, 10.0), np.arange(40.0), 10.0 * design.T @ design
    alone = coloured_covariance(design, y[:, :1], counts, time, gram=gram)
    beside = coloured_covariance(design, y, counts, time, gram=gram)
    np.testing.assert_allclose(beside.covariances[0], alone.covariances[0])


def test_what_white_error_bars_would_miss_is_reported():
    found = regression(np.random.default_rng(6), walk=30.0)[1]
    assert found.whiteness[0] < 1e-3
    assert found.excess[0] > 2.0  # on top of blocks whose scatter is already the walk's
    calm = regression(np.random.default_rng(6), walk=0.0)[1]
    assert calm.whiteness[0] > 0.5


def test_with_few_rows_the_textbook_standard_error_stands():
    t = np.array([25.0, 35.0, 45.0, 55.0, 65.0, 55.0, 45.0]) - 25.0
    y = np.array([400.0, 411.0, 419.0, 431.0, 440.0, 429.0, 420.0])
    X = np.column_stack([np.ones(7), t])
    found = coloured_covariance(X, y[:, None], np.ones(7), np.arange(7.0), gram=X.T @ X)
    assert np.sqrt(found.covariances[0, 1, 1]) == pytest.approx(0.026830, abs=1e-6)


def test_block_means_of_a_random_walk_scatter_like_its_kernel():
    rng = np.random.default_rng(7)
    walks = np.cumsum(rng.normal(size=(20_000, 120)), axis=1) / np.sqrt(120)
    means = walks.reshape(20_000, 6, 20).mean(axis=2)
    kernel = _random_walk((np.arange(6) + 0.5) / 6.0)
    scale = 5.0 / 6.0  # the kernel's time runs from the first middle to the last one
    steps = np.diff(np.eye(6), axis=0)  # a constant is absorbed by every fit
    assert steps @ kernel @ steps.T * scale == pytest.approx(steps @ np.cov(means.T) @ steps.T, abs=0.006)


@given(seed=st.integers(0, 1000), scale=st.floats(1e-6, 1e6), shift=st.floats(-100.0, 100.0))
@settings(max_examples=examples(15), deadline=None)
def test_the_long_run_variance_has_the_square_of_the_unit(seed, scale, shift):
    x = lfilter([1.0], [1.0, -0.7], np.random.default_rng(seed).normal(size=300))
    assert long_run_variance(scale * (x + shift)) == pytest.approx(scale**2 * long_run_variance(x), rel=1e-6)
    assert long_run_variance(x[::-1]) == pytest.approx(long_run_variance(x), rel=1e-9)  # time may run either way


@pytest.mark.parametrize(("n", "known"), [(15, False), (16, True)])
def test_sixteen_samples_are_needed_to_tell_correlation(n, known):
    x = np.cumsum(np.random.default_rng(8).normal(size=n))
    assert bool(long_run_variance(x) > 1.01 * x.var(ddof=1)) is known


def test_an_alternating_series_is_not_worth_more_than_its_samples():
    x = np.where(np.arange(200) % 2, 1.0, -1.0) + 0.1 * np.random.default_rng(9).normal(size=200)
    assert long_run_variance(x) == pytest.approx(x.var(ddof=1))


def test_drift_between_blocks_needs_eight_samples_in_each():
    """Blocks of noise about levels of their own: sixteen of them, of seven or of eight samples."""
    rng = np.random.default_rng(10)
    levels = rng.permutation(np.linspace(-3.0, 3.0, 16))
    factors = []
    for each in (7, 8):
        x = np.repeat(levels, each) + rng.normal(size=16 * each)
        factors.append(long_run_variance(x) / x.var(ddof=1) / each)
    assert factors[1] == pytest.approx(1.0, abs=0.2)  # the scatter of the levels, each worth one sample


@given(seed=st.integers(0, 500), scale=st.floats(1e-3, 1e3))
@settings(max_examples=10, deadline=None)
def test_the_covariance_of_least_squares_has_the_square_of_the_unit(seed, scale):
    rng = np.random.default_rng(seed)
    design = np.column_stack([np.ones(30), np.linspace(-1.0, 1.0, 30)])
    y, counts, t = rng.normal(size=(30, 2)), np.full(30, 10.0), np.arange(30.0)
    gram = 10.0 * design.T @ design
    one, other = (coloured_covariance(design, k * y, counts, t, gram=gram) for k in (1.0, scale))
    assert other.covariances == pytest.approx(scale**2 * one.covariances, rel=1e-6)
    assert other.whiteness == pytest.approx(one.whiteness)
    later = coloured_covariance(design, y, counts, 1e3 + 60.0 * t, gram=gram)
    assert later.covariances == pytest.approx(one.covariances, rel=1e-6)  # the clock does not matter


@pytest.mark.parametrize(("rows", "coloured"), [(13, False), (14, True)])
def test_twelve_residuals_are_needed_to_tell_colour(rows, coloured):
    walk = np.cumsum(np.random.default_rng(11).normal(size=(rows, 1)), axis=0)
    design = np.column_stack([np.ones(rows), np.linspace(-1.0, 1.0, rows)])
    found = coloured_covariance(design, walk, np.ones(rows), np.arange(float(rows)), gram=design.T @ design)
    assert bool(found.excess[0] != 1.0) is coloured
