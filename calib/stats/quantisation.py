"""Estimates from truncated and rounded samples.

A vehicle's streams are integers: 1 mG, 1 mrad/s, 1 mgauss. C++ truncates toward zero, so the bin around zero is twice
as wide as the others (FLIGHT_CONTROLLERS 2.1). With noise below about half a bin the mean of many samples is biased.
The bias is up to ``(q/pi) exp(-2 pi^2 s^2/q^2)`` (METHODS 0), and no averaging helps. The likelihood of the *intervals*
has no such bias: a sample only states that the value lay within its bin.

With ``delta = beta/sigma`` and ``tau = 1/sigma`` the log-likelihood of a Gaussian linear model with interval data is
concave (Burridge 1981). Newton's method therefore finds its maximum from anywhere.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Channel, Rounding
from mavcal.calib.stats.correlated import long_run_variance

COARSE = 0.75
"""Noise below this many quanta biases the plain mean (5e-6 quanta of bias at 0.75, 2e-3 at 0.5)."""
_SMALLEST_NOISE = 0.02  # quanta; less noise than this is not believed of any sensor
_LOG_SQRT_2PI = 0.5 * np.log(2.0 * np.pi)
_ITERATIONS = 60
_GRID_SAMPLES = 100  # numbers from which on repeats tell a grid
_GRID_REPEATS = 4  # times that a level occurs, on average, where numbers were rounded


@dataclass(frozen=True, eq=False)
class QuantisedMean:
    """Mean of a channel's samples, shape (k,), in the channel's unit.

    `covariance` (k, k) is that of the mean, serial correlation included. `sd` (k,) is the noise of one sample, nan for
    a `constant` axis. All samples of such an axis are in one bin, its mean is the middle, and every value in the bin is
    equally likely. `n_effective` is the effective number of independent samples on the worst axis. `influence` (N, k)
    is each sample's influence, whose mean scatters like the estimate; `bin_variance` (k,) is the variance left by one
    or two bins.
    """

    mean: Array
    covariance: Array
    n: int
    n_effective: float
    sd: Array
    constant: tuple[bool, ...]
    influence: Array
    bin_variance: Array

    def variance_along(self, direction: Array) -> float:
        """Variance of the mean's component along the unit vector `direction` (k,), serial correlation included."""
        return long_run_variance(self.influence @ direction) / self.n + float(direction**2 @ self.bin_variance)


@dataclass(frozen=True, eq=False)
class IntervalFit:
    """Coefficients (p,), their influence per sample (N, p) whose sum scatters as they do, and the noise of a sample.

    `at_limit`: the data show no noise; `sigma` is then the lower limit, not an estimate.
    """

    coefficients: Array
    influence: Array
    sigma: float
    at_limit: bool


def with_apparent_quantum(channel: Channel) -> Channel:
    """`channel` with its apparent quantum, if none is stated and its values lie on a grid.

    Values rounded by another program would otherwise look noiseless.
    """
    if channel.quantum > 0.0 or len(channel) < _GRID_SAMPLES:
        return channel
    steps = []
    for column in channel.values.T:
        levels = np.unique(column)
        if not 1 < len(levels) <= len(column) / _GRID_REPEATS:
            continue
        gaps = np.diff(levels)
        multiples = gaps / gaps.min()
        if np.abs(multiples - np.round(multiples)).max() < 0.01:
            steps.append(float(gaps.min()))
    return dataclasses.replace(channel, quantum=max(steps), rounding=Rounding.NEAREST) if steps else channel


def half_widths(channel: Channel) -> Array:
    """Half the width of the bin of every sample, shape of ``channel.values``; zero without quantisation."""
    half = np.full(channel.values.shape, 0.5 * channel.quantum)
    if channel.zero_bin is not None and channel.rounding == Rounding.TOWARD_ZERO:
        half[channel.zero_bin] = channel.quantum
    return half


def mean_of(channel: Channel, *, frame: Array | None = None) -> QuantisedMean:
    """Mean of the samples of `channel`, by the likelihood of their intervals where the bins are coarse.

    Parameters
    ----------
    channel
        At least two finite samples.
    frame : shape (k, k) or None
        Orthonormal columns along which noise is taken as independent when its serial correlation is found: for a
        hand-held accelerometer one column along gravity, so that sway across does not count as noise along. None:
        the sensor's axes.

    Raises
    ------
    InvalidInputError
        If there are fewer than two samples, or one is not finite.
    """
    values = channel.values
    if len(values) < 2 or not np.isfinite(values).all():
        raise InvalidInputError(
            f"a mean of {channel.sensor} needs two finite samples or more; {len(values)} were given, "
            f"{int((~np.isfinite(values)).sum())} numbers of them not finite"
        )
    half = half_widths(channel)
    axes = [_axis_mean(values[:, i], half[:, i], channel.quantum) for i in range(values.shape[1])]
    influence = np.column_stack([a.influence for a in axes])
    basis = np.eye(values.shape[1]) if frame is None else np.asarray(frame, dtype=np.float64)
    long_run = np.array([long_run_variance(column) for column in (influence @ basis).T])
    bin_variance = np.array([a.bin_variance for a in axes])
    covariance = (basis * (long_run / len(values))) @ basis.T + np.diag(bin_variance)
    sampled = influence.var(axis=0, ddof=1) / len(values) + bin_variance
    worth = np.divide(sampled, np.diag(covariance), out=np.ones(len(axes)), where=np.diag(covariance) > 0)
    return QuantisedMean(
        mean=np.array([a.mean for a in axes]),
        covariance=covariance,
        n=len(values),
        n_effective=float(len(values) * min(1.0, worth.min())),
        sd=np.array([a.sd for a in axes]),
        constant=tuple(a.constant for a in axes),
        influence=influence,
        bin_variance=bin_variance,
    )


def interval_regression(
    design: Array, values: Array, half: Array, *, smallest: float, weights: NDArray[Any] | None = None
) -> IntervalFit:
    """Least squares for data that are known to lie in ``values -+ half``: the Gaussian interval likelihood.

    Parameters
    ----------
    design : shape (N, p)
        Regressors, of full rank and moderate condition.
    values, half : shape (N,)
        Middles of the bins and half their widths, all positive.
    weights : shape (N,) or None
        Number of samples that each row represents; None: one.
    smallest : float
        Lower limit of the noise; the likelihood of noiseless data has no maximum.
    """
    scale = 2.0 * float(np.min(half))
    lower, upper = (values - half) / scale, (values + half) / scale
    limit = scale / smallest
    X = np.asarray(design, dtype=np.float64)
    w = np.ones(len(X)) if weights is None else np.asarray(weights, dtype=np.float64)
    theta = _maximum(X, lower, upper, w, _start(X, values / scale, w, limit), limit)
    return _interval_fit(X, lower, upper, w, theta, scale=scale, limit=limit)


def impute(values: Array, half: Array, expected: Array, sigma: float) -> tuple[Array, Array]:
    """Expectation and variance of each number given its bin ``values -+ half`` and the model N(expected, sigma^2).

    ``(mean - expected)/sigma^2`` is the score of a sample for its expectation, ``(1 - variance/sigma^2)/sigma^2`` its
    information.
    """
    a, b = (values - half - expected) / sigma, (values + half - expected) / sigma
    log_mass = _log_mass(a, b)
    ra, rb = np.exp(_log_density(a) - log_mass), np.exp(_log_density(b) - log_mass)
    mean = np.clip(expected + sigma * (ra - rb), values - half, values + half)
    variance = sigma**2 * np.clip(1.0 + a * ra - b * rb - (ra - rb) ** 2, 0.0, 1.0)
    return np.asarray(mean), np.asarray(variance)


@dataclass(frozen=True, eq=False)
class _AxisMean:
    mean: float
    influence: Array  # per sample, in the unit: its mean scatters as the estimate does
    bin_variance: float
    sd: float
    constant: bool


def _axis_mean(values: Array, half: Array, quantum: float) -> _AxisMean:
    sd = float(values.std(ddof=1))
    if values.min() == values.max() and quantum <= 0.0:
        return _AxisMean(float(values[0]), np.zeros(len(values)), 0.0, 0.0, constant=True)
    plain = _AxisMean(float(values.mean()), values - values.mean(), 0.0, sd, constant=False)
    if quantum <= 0.0:
        return plain
    wide = bool((half > 0.75 * quantum).any())
    if sd > COARSE * quantum and not wide:
        return plain
    low, high = float((values - half).max()), float((values + half).min())
    if high - low > 0.25 * quantum:  # one point explains every sample
        width = high - low
        return _AxisMean(0.5 * (low + high), np.zeros(len(values)), width**2 / 12.0, np.nan, constant=True)
    grain = 1e-6 * quantum  # undone calibrations leave rounding errors on equal bins
    rounded = np.round(values / grain) * grain
    bins, which, counts = np.unique(rounded + 1j * half, return_inverse=True, return_counts=True)
    if len(bins) == 2:
        return _two_bins(values, bins, quantum)
    fit = interval_regression(
        np.ones((len(bins), 1)), bins.real, bins.imag, weights=counts, smallest=_SMALLEST_NOISE * quantum
    )
    influence = fit.influence[which, 0] * len(values)
    return _AxisMean(float(fit.coefficients[0]), influence, 0.0, fit.sigma, constant=False)


def _two_bins(values: Array, bins: NDArray[np.complex128], quantum: float) -> _AxisMean:
    """Mean from two neighbouring bins, which determine only ``(edge - mu)/sigma``; averaged over the possible sigma.

    Every sigma from zero to one quantum is equally likely if it leaves the bins beyond these two empty. This makes mu
    about uniform over its possible range.
    """
    (lower_value, upper_value), (lower_half, upper_half) = bins.real, bins.imag
    edge = 0.5 * (lower_value + lower_half + upper_value - upper_half)
    in_upper = values > 0.5 * (lower_value + upper_value)
    n = len(values)
    share = (float(in_upper.sum()) + 0.5) / (n + 1.0)
    worth = n * share * (1.0 - share) / long_run_variance(in_upper.astype(np.float64))
    sigma = quantum * np.linspace(_SMALLEST_NOISE, 1.0, 50)
    z = scipy.special.ndtri(share)
    mu = edge + sigma * z
    below = scipy.special.ndtr((lower_value - lower_half - mu) / sigma)
    beyond = below + scipy.special.ndtr((mu - upper_value - upper_half) / sigma)
    weight = np.exp(worth * np.log1p(-np.minimum(beyond, 1.0 - 1e-12)))
    weight /= weight.sum()
    density = np.exp(_log_density(np.array(z)))
    variance = (sigma / density) ** 2 * share * (1.0 - share) / worth
    mean = float(weight @ mu)
    total = float(weight @ (variance + mu**2)) - mean**2
    return _AxisMean(mean, np.zeros(n), total, float(weight @ sigma), constant=False)


def _maximum(X: Array, lower: Array, upper: Array, w: Array, theta: Array, limit: float) -> Array:
    """Newton's method with halved steps from `theta`, ``tau`` kept between zero and `limit`."""
    level, gradient, hessian, _ = _likelihood(X, lower, upper, w, theta)
    for _ in range(_ITERATIONS):
        step = _newton_step(gradient, hessian, held=theta[-1] >= limit and gradient[-1] > 0.0)
        if theta[-1] + step[-1] > limit or theta[-1] + step[-1] <= 0.0:
            target = limit if step[-1] > 0.0 else 0.1 * theta[-1]
            step *= (target - theta[-1]) / step[-1]
        trial, new = theta + step, _likelihood(X, lower, upper, w, theta + step)
        while new[0] < level and np.abs(step).max() > 1e-9:
            step *= 0.5
            trial, new = theta + step, _likelihood(X, lower, upper, w, theta + step)
        gain = new[0] - level
        if gain < 0.0:
            break
        theta, (level, gradient, hessian, _) = trial, new
        if gain < 1e-9:
            break
    return theta


def _start(X: Array, values: Array, w: Array, limit: float) -> Array:
    beta = np.linalg.solve((X.T * w) @ X, (X.T * w) @ values)
    residual = values - X @ beta
    sigma = np.sqrt(max(float(w @ residual**2) / w.sum() - 1.0 / 12.0, 0.04))
    tau = min(1.0 / sigma, limit)
    return np.append(beta * tau, tau)


def _likelihood(X: Array, lower: Array, upper: Array, w: Array, theta: Array) -> tuple[float, Array, Array, Array]:
    """Log-likelihood, gradient, Hessian and scores of single samples (N, p+1) in ``(delta, tau)``."""
    centre = X @ theta[:-1]
    a, b = theta[-1] * lower - centre, theta[-1] * upper - centre
    log_mass = _log_mass(a, b)
    ra, rb = np.exp(_log_density(a) - log_mass), np.exp(_log_density(b) - log_mass)
    scores = np.column_stack([X * (ra - rb)[:, None], upper * rb - lower * ra])
    va, vb = np.column_stack([-X, lower]), np.column_stack([-X, upper])
    aa, bb, ab = w * (a * ra - ra**2), w * (-b * rb - rb**2), w * ra * rb
    hessian = (va.T * aa) @ va + (vb.T * bb) @ vb + (va.T * ab) @ vb + (vb.T * ab) @ va
    return float(w @ log_mass), w @ scores, hessian, scores


def _newton_step(gradient: Array, hessian: Array, *, held: bool) -> Array:
    free = len(gradient) - int(held)
    step = np.zeros(len(gradient))
    ridge = 1e-12 * np.trace(hessian[:free, :free]) * np.eye(free)
    step[:free] = -np.linalg.solve(hessian[:free, :free] + ridge, gradient[:free])
    return step


def _interval_fit(
    X: Array, lower: Array, upper: Array, w: Array, theta: Array, *, scale: float, limit: float
) -> IntervalFit:
    _, _, hessian, scores = _likelihood(X, lower, upper, w, theta)
    tau, beta = theta[-1], theta[:-1] / theta[-1]
    at_limit = bool(tau >= limit * (1.0 - 1e-9))
    p = len(beta) if at_limit else len(beta) + 1
    jacobian = np.column_stack([np.eye(len(beta)) / tau, -beta / tau])[:, :p]
    bread = np.linalg.inv(-hessian[:p, :p] - 1e-12 * np.trace(hessian[:p, :p]) * np.eye(p))
    influence = scores[:, :p] @ bread @ jacobian.T
    return IntervalFit(scale * beta, scale * influence, scale / tau, at_limit)


def _log_density(x: Array) -> Array:
    density: Array = -0.5 * x**2 - _LOG_SQRT_2PI
    return density


def _log_mass(a: Array, b: Array) -> Array:
    """``log(Phi(b) - Phi(a))`` for ``a < b``, exact far in either tail."""
    flip = a > 0.0
    low, high = np.where(flip, -b, a), np.where(flip, -a, b)
    top = scipy.special.log_ndtr(high)
    return np.asarray(top + np.log1p(-np.exp(np.minimum(scipy.special.log_ndtr(low) - top, -1e-300))))
