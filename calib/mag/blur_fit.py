"""Ellipsoid of a compass that averages while it turns, with the uncertainty of the averaging.

The blur of a window is corrected from the gyro (:mod:`calib.mag.blur`). Parts of it are uncertain, and they alone limit
a nearly noise-free compass:

* how strong it is (the window is only about as long as stated, and the mean of n readings blurs by ``1 - 1/n^2`` of
  what the mean of all would), one factor for all samples;
* how late the compass's time stamps are against the gyro's (a message is stamped when it is sent, and the gyro is
  filtered), one lag for all samples;
* how long and how square the gyro's axes are in those of the compass, one matrix for all samples;
* strength and lag once more for every sample: a reading is up to one message older than its stamp says, and the
  window holds one of its readings more or less.

The first three are estimated with the ellipsoid, under priors; their remaining uncertainty is part of the covariance.
The last makes samples of uneven turns less accurate, by an amount that the residuals show.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.blur import Rates, axes_of_gyro, deblurred
from mavcal.calib.mag.distance import Distances, bisquare, score_rows, shape_prior
from mavcal.calib.mag.ellipsoid import AUTO, ellipsoid_shape, fit_ellipsoid
from mavcal.calib.mag.ellipsoid_result import ShapeFit, ellipsoid_result
from mavcal.calib.mag.result import MagContext, MagFacts
from mavcal.calib.mag.robust import MAD_TO_SD, OUTLIER, robust_sd
from mavcal.calib.mag.samples import Array, Cloud, counted_as, not_repeated, still_stretches
from mavcal.calib.mag.shape import MagModel, correction
from mavcal.calib.mag.shape_fit import SOFT_IRON_SD, Asked

GAIN_SD = 0.03
"""Relative standard deviation of the blur's strength: 1 % for the mean of ten readings, and a window known to 1.5 %,
which enters squared."""

LAG_SD = 0.01
"""Prior of the lag, s. A 20 Hz low-pass of second order delays the gyro by sqrt(2)/(2 pi 20 Hz) = 11 ms. An interval of
20 ms delays the compass by 10 ms on average. The two act in opposite senses."""

SCALE_SD, ASKEW_SD = 0.01, 0.02
"""Priors of a gyro's scale factor, relative (MEMS data sheets say 1 to 3 %), and of the angles between its axes and the
compass's, rad: a sensor is soldered or stuck square to a degree."""

_WINDOW_SD = 2.0 / (10.0 * math.sqrt(12.0))
"""Relative standard deviation of one sample's blur: one of about ten readings more or less changes the window, and blur
is proportional to its square."""

_ROUNDS = 2  # the model that the correction needs is itself better after one, and so is what is known of the blur
_STEPS = np.array([0.1, 0.005, *[0.03] * 9])  # of gain, lag and the nine numbers of the axes, for derivatives
_PRIOR = np.diag(np.array([GAIN_SD, LAG_SD, *np.where(np.eye(3) > 0.0, SCALE_SD, ASKEW_SD).ravel()]) ** -2.0)
_CLIP = 4.0  # standard deviations beyond which a residual does not say how noise depends on the turn
_NOISES = (math.log(1e-4), math.log(1e8))  # variance of the noise over the mean square of the doubt
_DOUBTS = tuple(math.log(c * c) for c in (2.0, 4.0, 8.0))  # what the doubt may be more than it is believed to be
_BETTER = 4.0  # twice the gain of log-likelihood from which on it is
_ALIKE = 0.99  # least precision at which samples count as alike


@dataclass(frozen=True, eq=False)
class _Timing:
    """Estimate of the blur, and its effect on the ellipsoid."""

    state: Array
    """Gain, lag, and the difference of the gyro's axes from the compass's, row by row, (11,)."""
    from_timing: Array
    """Covariance (9, 9) of the ellipsoid's parameters from the uncertainty of the state."""
    precision: Array | None = None
    """Precision of the samples; None: all equal."""
    least_variance: float = 0.0
    """Variance of the residual of a sample with precision one; only where they are not alike."""


def fit_ellipsoid_deblurred(
    samples: ArrayLike,
    rates: Rates,
    *,
    model: str = MagModel.SYMMETRIC,
    robust: bool | None = None,
    prior_sd: float | None = None,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """Fit the ellipsoid to samples corrected for motion blur, without too fast ones and repeats.

    Parameters
    ----------
    samples : shape (N, 3)
        In order of time.
    rates
        Of the same N samples, in any axes: the rotation from gyro to compass axes is estimated from the turning.
    model, robust, prior_sd, **facts
        As for :func:`calib.mag.ellipsoid.fit_ellipsoid`.
    """
    array = np.asarray(samples, dtype=np.float64)
    if len(array) != len(rates.known):
        raise InvalidInputError(f"{len(array)} magnetometer samples, but rates of {len(rates.known)}")
    rows = rates.sharp()
    rows[rows] = not_repeated(array[rows])
    kept, slow = array[rows], rates.take(rows)
    context = MagContext(**facts)
    kept, slow, readings_worth = _still_means(kept, slow, context.quantum)
    if not len(kept) or (slow.window == 0.0 and readings_worth is None):
        return fit_ellipsoid(kept, model=model, robust=robust, prior_sd=prior_sd, **facts)
    prior = SOFT_IRON_SD if model == AUTO and prior_sd is None else prior_sd
    free = np.eye(9) if model == AUTO else MagModel(model).basis
    alone = None if readings_worth is None else np.sqrt(readings_worth)
    sharp, timing = kept, _Timing(np.zeros(len(_STEPS)), np.zeros((9, 9)), alone)

    def asked(*, robust: bool | None = robust) -> Asked:
        return Asked(context, robust, prior_sd, precision=timing.precision, least_variance=timing.least_variance)

    try:
        if slow.window == 0.0:
            return ellipsoid_result(ellipsoid_shape(sharp, model, asked()), sharp, context)
        for k in range(_ROUNDS + 1):
            # Without any noise the blur that is not computed back yet looks like outliers, and may look like too many.
            try:
                shape = ellipsoid_shape(sharp, model, asked(), fall_back=False)
            except UndeterminedError:
                shape = ellipsoid_shape(sharp, model, asked(robust=False), fall_back=False)
            if k == 0:
                slow = slow.turned(axes_of_gyro(correction(shape.ellipsoid, 1.0).apply(kept), slow))
            else:
                timing = _timing(kept, slow, shape, timing, free=free, prior_sd=prior, readings_worth=readings_worth)
            sharp = deblurred(kept, _adjusted(slow, timing.state), correction(shape.ellipsoid, None))
        shape = ellipsoid_shape(sharp, model, asked(), fall_back=False)
    except UndeterminedError:  # the sphere, of the samples as they are
        return fit_ellipsoid(kept, model=model, robust=robust, prior_sd=prior_sd, **facts)
    shape = dataclasses.replace(shape, covariance=shape.covariance + timing.from_timing)
    return ellipsoid_result(shape, sharp, context)


def _still_means(kept: Array, slow: Rates, step: float) -> tuple[Array, Rates, Array | None]:
    """Means over stretches in which the field stayed within its `step`, and the equivalent count of each.

    The unchanged samples and None if it always did.
    """
    if step == 0.0 or len(kept) < 2:
        return kept, slow, None
    starts = still_stretches(kept, step)
    if len(starts) == len(kept):
        return kept, slow, None
    lengths = np.diff(starts, append=len(kept))
    means = np.add.reduceat(kept, starts) / lengths[:, None]
    return means, slow.take(starts + lengths // 2), counted_as(kept, starts, step)


def _timing(
    kept: Array,
    slow: Rates,
    shape: ShapeFit,
    before: _Timing,
    *,
    free: Array,
    prior_sd: float | None,
    readings_worth: Array | None,
) -> _Timing:
    """Estimate of the blur after one step from `before`; `shape` is the fit of `before`."""
    model = correction(shape.ellipsoid, None)

    samples = deblurred(kept, _adjusted(slow, before.state), model)
    by_shape = score_rows(samples, shape.ellipsoid).T  # what a step of the ellipsoid takes from the distances
    normal = by_shape[:, :3]

    by_timing = np.empty((len(kept), len(_STEPS)))
    for k, step in enumerate(np.diag(_STEPS)):
        change = deblurred(kept, _adjusted(slow, before.state + step), model) - samples
        by_timing[:, k] = np.einsum("ij,ij->i", normal, change) / _STEPS[k]
    distances = Distances(Cloud(samples, np.zeros(3), 1.0)).at(shape.ellipsoid, 0.0, None).residuals
    distances = distances - np.average(distances)
    doubt = np.hypot(_WINDOW_SD * by_timing[:, 0], slow.interval / math.sqrt(12.0) * by_timing[:, 1])
    precision, least = _precision(distances, doubt, np.ones(len(kept)) if readings_worth is None else readings_worth)
    weight, variance = _weights(distances * precision, precision, len(free.T))
    variance = max(variance, least) * shape.variance_inflation
    by_free = by_shape @ free
    weighed = by_free * weight[:, None] / variance
    own = weighed.T @ by_free + free.T @ shape_prior(shape.ellipsoid, prior_sd) @ free
    both, lone = weighed.T @ by_timing, (by_timing * weight[:, None]).T @ by_timing / variance
    share = np.linalg.solve(own, both)
    covariance = np.linalg.inv(lone - both.T @ share + _PRIOR)
    pull = by_timing.T @ (weight * distances) / variance - share.T @ (weighed.T @ distances)
    state = before.state - covariance @ (pull + _PRIOR @ before.state)
    spread = free @ share
    from_timing = spread @ covariance @ spread.T
    alike = least == 0.0 and readings_worth is None
    return _Timing(state, from_timing) if alike else _Timing(state, from_timing, precision, least)


def _adjusted(rates: Rates, state: Array) -> Rates:
    return rates.adjusted(float(state[0]), float(state[1]), np.eye(3) + state[2:].reshape(3, 3))


def _precision(distances: Array, doubt: Array, readings_worth: Array) -> tuple[Array, float]:
    """One over the relative noise of every sample, and the variance at precision one (0: blur makes no difference).

    The variance of a sample that is worth n readings is ``v/n + c^2 doubt^2`` with the likeliest v and c; c is at least
    one. Small residuals do not make the blur more certain than it can be.
    """
    squares = doubt**2
    typical = float(np.mean(squares))
    if not typical > 0.0:
        return np.sqrt(readings_worth), 0.0
    # A sample is far off only if neither the common noise nor its own uncertainty explains it.
    clipped = np.maximum(_clipped(distances), np.minimum(distances**2, _CLIP**2 * squares))

    from scipy.optimize import minimize_scalar  # 11 MB that an idle service does without

    def deviance(log_noise: float, log_doubt: float) -> float:
        variances = math.exp(log_noise) * typical / readings_worth + math.exp(log_doubt) * squares
        return float(np.log(variances).sum() + (clipped / variances).sum())

    def likeliest(log_doubt: float) -> tuple[float, float]:
        found = minimize_scalar(lambda x: deviance(x, log_doubt), bounds=_NOISES, method="bounded")
        return float(found.fun), float(found.x)

    least, log_noise = likeliest(0.0)
    factor = 1.0
    for log_doubt in _DOUBTS:
        worse, other = likeliest(log_doubt)
        if worse < least - _BETTER:
            least, log_noise, factor = worse + _BETTER, other, math.exp(log_doubt)
    noise = math.exp(log_noise) * typical
    precision = np.sqrt(noise / (noise / readings_worth + factor * squares))
    alike = bool((precision > _ALIKE * np.sqrt(readings_worth)).all())
    return (np.sqrt(readings_worth), 0.0) if alike else (precision, noise)


def _clipped(distances: Array) -> Array:
    """Squares of `distances`, those of outliers of four standard deviations at most."""
    limit = _CLIP * MAD_TO_SD * float(np.median(np.abs(distances)))
    return np.asarray(np.minimum(distances**2, limit**2))


def _weights(whitened: Array, precision: Array, size: int) -> tuple[Array, float]:
    """Weight of every squared distance (N,), less for outliers, and the variance of one at precision one."""
    sd = robust_sd(whitened, 1e-12)
    weight = np.ones(len(whitened))
    if float(np.abs(whitened).max()) > OUTLIER * sd:
        weight = bisquare(whitened, sd)[0]
    variance = float(weight @ whitened**2) / max(float(weight.sum()) - size, 1.0)
    return weight * precision**2, max(variance, 1e-24)
