"""Orthogonal-distance fit of an ellipsoid: debiased Gauss-Newton on normal equations (METHODS 3.1).

A sample p off the ellipsoid with half axes a (in its eigenframe) has the foot point ``x_i = a_i^2 p_i/(t + a_i^2)``.
The number t makes x lie on the ellipsoid; ``w = x/a^2`` is along the normal, the distance is ``d = t |w|``. Noise
pushes the mean of d out by ``v H`` (v its variance, H the mean curvature), which is subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import NotConvergedError, UndeterminedError
from mavcal.calib.mag.samples import CHUNK, Array, Cloud
from mavcal.calib.mag.shape import COLUMNS, N_PARAMETERS, ROWS, SYMMETRIC_BASIS, Ellipsoid, MagModel, six_numbers

TUKEY = 4.685
"""Tuning constant of the bisquare weight in standard deviations: 95 % efficiency on normal noise."""
MAX_STEPS = 60
ALL_SIDES = "turn the vehicle so that every side points up and down once"
LARGE = 50_000
"""Number of samples above which the iteration stops within 3 % of a standard deviation: one pass after a good start."""

_FOOT_STEPS = 40
_EXACTLY = 1e-7  # of a half axis squared, the last step to a foot point: what is left is its square, times the flatness
_ROUGHLY = 1e-4  # the same where thousands of samples average it out: 1e-6 standard deviations of a sample are left
_ONES = np.ones(3)
_MAY_RISE = 1.001  # of the cost in one step: the bias that is subtracted is not part of it
_ROUNDING = 1e-24  # of a squared distance
_LONGEST_STEP = 0.3  # of the smallest radius, a step: beyond it the linearisation says nothing


@dataclass(frozen=True, eq=False)
class Pass:
    """Normal equations and sums of one pass over the samples; parameters as in :mod:`calib.mag.shape`."""

    information: Array
    """Sum of ``w J^T J``, (9, 9)."""
    gradient: Array
    """Sum of ``w J^T r``, (9,)."""
    cost: float
    """Sum of the losses of the residuals, in the unit of the samples squared."""
    residuals: Array
    """Debiased distances, (N,), positive outside; divided by their relative noise if the samples differ in it."""


def foot_points(points: Array, axes: Array, accuracy: float = 1e-7) -> tuple[Array, Array]:
    """Multiplier t (N,) and ``w = x / axes^2`` (3, N) of `points` (3, N) in the eigenframe of an ellipsoid.

    Newton on ``g(t)^-1/2 - 1`` with ``g = sum (a_i p_i/(t + a_i^2))^2``: exact in one step on a sphere. The first step,
    from t = 0, is two sums over squares. It ends with a step below `accuracy` of the largest half axis squared; the
    remaining error is of the order of its square.
    """
    squares = (axes**2)[:, None]
    terms = points * points
    f2, slope = np.stack([axes**-2.0, axes**-4.0]) @ terms
    t = np.sqrt(f2)
    t -= 1.0
    t *= f2
    t /= np.maximum(slope, 1e-300)
    lowest = -squares.min() * (1.0 - 1e-12)
    np.maximum(t, 0.5 * lowest, out=t)
    enough = accuracy * float(squares.max())
    scaled = squares * terms
    inverse = np.empty_like(points)
    for _ in range(_FOOT_STEPS):
        np.reciprocal(np.add(t, squares, out=inverse), out=inverse)
        np.multiply(np.multiply(scaled, inverse, out=terms), inverse, out=terms)
        g = _ONES @ terms
        terms *= inverse
        step = np.sqrt(g)
        step -= 1.0
        step *= g
        step /= np.maximum(_ONES @ terms, 1e-300)
        if float(t.min()) + float(step.min()) < lowest:
            step = np.maximum(step, lowest - t)
        t += step
        if max(float(step.max()), -float(step.min())) <= enough:
            break
    np.add(t, squares, out=inverse)
    return t, np.divide(points, inverse, out=inverse)


@dataclass(frozen=True, eq=False)
class Distances:
    """The residuals of a cloud of samples, in its scaled coordinates, with their normal equations."""

    cloud: Cloud

    def __len__(self) -> int:
        return len(self.cloud)

    def at(self, ellipsoid: Ellipsoid, noise_variance: float, tukey_scale: float | None) -> Pass:
        """One pass; `noise_variance` corrects the bias of the distance, `tukey_scale` sets robust weights."""
        axes, frame = np.linalg.eigh(ellipsoid.shape)
        total = np.zeros((N_PARAMETERS + 1, N_PARAMETERS + 1))
        cost = 0.0
        residuals = np.empty(len(self))
        rows = np.empty((N_PARAMETERS + 1, min(CHUNK, len(self))))
        accuracy = _ROUGHLY if len(self) >= LARGE else _EXACTLY
        for start in range(0, len(self), CHUNK):
            points = frame.T @ self.cloud.rows(start)
            points -= (frame.T @ ellipsoid.offset)[:, None]
            block = rows[:, : points.shape[1]]
            _fill_rows(block, *foot_points(points, axes, accuracy), axes, noise_variance)
            self._weigh(block, start)
            residuals[start : start + CHUNK] = block[9]
            if tukey_scale is None:
                total += block @ block.T
            else:
                weight, loss = bisquare(block[9], tukey_scale)
                cost += float(loss.sum())
                total += (block * weight) @ block.T
        to_frame = _parameters_in_frame(frame)
        if tukey_scale is None:
            cost = float(total[9, 9])
        return Pass(to_frame.T @ total[:9, :9] @ to_frame, to_frame.T @ total[:9, 9], cost, residuals)

    def scores(self, ellipsoid: Ellipsoid, count: int) -> Array:
        """Derivatives (9, n) of the residuals of the first `count` samples by the nine parameters."""
        axes, frame = np.linalg.eigh(ellipsoid.shape)
        found = np.empty((N_PARAMETERS, min(count, len(self))))
        back = _parameters_in_frame(frame).T
        rows = np.empty((N_PARAMETERS + 1, min(CHUNK, len(self))))
        for start in range(0, found.shape[1], CHUNK):
            points = frame.T @ self.cloud.rows(start)[:, : found.shape[1] - start]
            points -= (frame.T @ ellipsoid.offset)[:, None]
            block = rows[:, : points.shape[1]]
            _fill_rows(block, *foot_points(points, axes, _ROUGHLY), axes, 0.0)
            self._weigh(block, start)
            np.matmul(back, block[:N_PARAMETERS], out=found[:, start : start + block.shape[1]])
        return found

    def _weigh(self, block: Array, start: int) -> None:
        """Divide derivatives and distances by the relative noise of their samples."""
        if self.cloud.precision is not None:
            block *= self.cloud.precision[start : start + block.shape[1]]


def _fill_rows(block: Array, t: Array, w: Array, axes: Array, noise_variance: float) -> None:
    """Derivatives of the distance by the nine parameters, in the eigenframe, and the debiased distance below them.

    `t` and `w` are those of :func:`foot_points`; `w` is overwritten.
    """
    normal = np.square(w, out=block[:3])
    length = np.sqrt(_ONES @ normal)
    np.divide(w, length, out=normal)
    unit = np.multiply(axes[:, None], w, out=w)
    np.multiply(normal, unit, out=block[3:6])
    for k in (3, 4, 5):
        i, j = ROWS[k], COLUMNS[k]
        np.multiply(normal[i], unit[j], out=block[3 + k])
        block[3 + k] += normal[j] * unit[i]
    np.multiply(t, length, out=block[9])
    if noise_variance > 0.0:
        inverse = axes**-2.0
        curvature = inverse @ np.square(normal, out=unit)
        np.subtract(inverse.sum(), curvature, out=curvature)
        curvature *= 0.5 * noise_variance
        curvature /= length
        block[9] -= curvature


def bisquare(residuals: Array, scale: float) -> tuple[Array, Array]:
    """Tukey's weights ``(1 - (r/c)^2)^2`` within ``c = 4.685 scale``, and the loss of every residual."""
    c2 = (TUKEY * scale) ** 2
    inside = np.clip(1.0 - residuals * residuals / c2, 0.0, 1.0)
    return inside * inside, c2 / 3.0 * (1.0 - inside**3)


def _parameters_in_frame(frame: Array) -> Array:
    """(9, 9): parameters of the sensor frame -> those of the eigenframe, ``b' = V^T b`` and ``S' = V^T S V``."""
    result = np.zeros((N_PARAMETERS, N_PARAMETERS))
    result[:3, :3] = frame.T
    for k, direction in enumerate(SYMMETRIC_BASIS):
        result[3:, 3 + k] = six_numbers(frame.T @ direction @ frame)
    return result


@dataclass(frozen=True, eq=False)
class Solution:
    """A converged fit: `last` was computed within a thousandth of an sd of `ellipsoid`."""

    ellipsoid: Ellipsoid
    last: Pass
    noise_variance: float
    prior: Array
    """Information that the prior added, (9, 9)."""


@dataclass(frozen=True)
class ShapeTerms:
    """The free parameters, and the prior on the soft iron."""

    model: MagModel = MagModel.SYMMETRIC
    prior_sd: float | None = None
    """Standard deviation of each relative term of soft iron; None: no prior."""
    cross_sd: float | None = None
    """That of the three cross terms; None: as `prior_sd`."""


def shape_prior(ellipsoid: Ellipsoid, sd: float | None, cross_sd: float | None = None) -> Array:
    """Curvature (9, 9) of the prior ``S/r - I ~ N(0, sd^2)`` on each of the six numbers, r the mean diagonal.

    `cross_sd` is that of the three cross terms; None: `sd` as well.
    """
    prior = np.zeros((N_PARAMETERS, N_PARAMETERS))
    if sd is not None:
        radius = np.trace(ellipsoid.shape) / 3.0
        prior[3:6, 3:6] = (np.eye(3) - 1.0 / 3.0) / (radius * sd) ** 2
        prior[6:, 6:] = np.eye(3) / (radius * (sd if cross_sd is None else cross_sd)) ** 2
    return prior


def gauss_newton(
    distances: Distances,
    start: Ellipsoid,
    noise_variance: float,
    *,
    terms: ShapeTerms = ShapeTerms(),
    debias: bool = True,
    tukey_scale: float | None = None,
    first: Pass | None = None,
) -> Solution:
    """Minimise the distances from `start`; the noise variance is re-estimated on the way.

    Each step solves ``(F + v P) dx = J^T W (d - v H) - v P x``; a step that raises the cost is halved. It ends when the
    next step is predicted to be below 1e-7 sd (0.03 sd for :data:`LARGE` samples). `start` must have the form of
    ``terms.model``. `first` is the pass at `start` with `noise_variance`, if it was made before.

    Raises
    ------
    UndeterminedError
        If the iteration diverges to a degenerate ellipsoid or does not converge.
    """
    ellipsoid, variance = start, noise_variance
    origin, step = start, np.zeros(N_PARAMETERS)
    lowest, lowest_belief = np.inf, 0.0  # data and prior apart: the variance that weighs them is re-estimated
    free = terms.model.basis
    tolerance = 0.03 if len(distances) >= LARGE else 1e-7
    for _ in range(MAX_STEPS):
        found, first = first or distances.at(ellipsoid, variance if debias else 0.0, tukey_scale), None
        prior = shape_prior(ellipsoid, terms.prior_sd, terms.cross_sd)
        state = np.concatenate([ellipsoid.offset, six_numbers(ellipsoid.shape)])
        belief = float(state @ prior @ state)
        allowed = (lowest + variance * lowest_belief) * _MAY_RISE + len(distances) * _ROUNDING
        if found.cost + variance * belief > allowed:
            step = 0.5 * step
            ellipsoid = origin.stepped(step)
            continue
        origin, lowest, lowest_belief = ellipsoid, found.cost, belief
        variance = max(_residual_variance(found, tukey_scale, terms.model.size), _ROUNDING)
        normal = found.information + variance * prior
        step = free @ _solve(free.T @ normal @ free, free.T @ (found.gradient - variance * prior @ state))
        in_sd = float(np.sqrt(max(float(step @ normal @ step), 0.0) / variance))
        longest = max(float(np.abs(step).max()), 1e-30)
        step = step * min(1.0, _LONGEST_STEP * float(ellipsoid.radii[0]) / longest)
        ellipsoid = _checked(ellipsoid.stepped(step))
        if in_sd * _contraction(ellipsoid, step, variance) < tolerance:
            return Solution(ellipsoid, found, variance, prior)
    raise NotConvergedError(
        f"the magnetometer samples settle on no ellipsoid within {MAX_STEPS} steps",
        remedy=ALL_SIDES,
    )


def score_rows(samples: Array, ellipsoid: Ellipsoid) -> Array:
    """Derivatives (9, N) of the distances of `samples` (N, 3) by the nine parameters."""
    return Distances(Cloud(samples, np.zeros(3), 1.0)).scores(ellipsoid, len(samples))


def _residual_variance(found: Pass, tukey_scale: float | None, size: int) -> float:
    if tukey_scale is not None:
        return tukey_scale**2
    return float(found.residuals @ found.residuals) / max(len(found.residuals) - size, 1)


def _contraction(ellipsoid: Ellipsoid, step: Array, variance: float) -> float:
    """Factor by which the next step will be shorter: residual times curvature, and the step's own second order."""
    smallest = float(ellipsoid.radii[0])
    return min(1.0, 3.0 * (float(np.sqrt(variance)) + float(np.abs(step).max())) / smallest)


def _solve(normal: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(normal, right))
    except np.linalg.LinAlgError as error:
        raise UndeterminedError(
            "the magnetometer samples leave a parameter of the ellipsoid open",
            remedy=ALL_SIDES,
        ) from error


def _checked(ellipsoid: Ellipsoid) -> Ellipsoid:
    radii = ellipsoid.radii
    if not (np.isfinite(radii).all() and radii[0] > 1e-3 and radii[2] < 1e3):
        raise UndeterminedError(
            "the magnetometer samples fit a degenerate ellipsoid only: they cover too small a part of it",
            remedy=ALL_SIDES,
        )
    return ellipsoid
