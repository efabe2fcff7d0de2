"""The reference's attitude error as a slow process that accelerometer and magnetometer share (GAP 3.5).

With a Gauss-Markov prior only its rms and its correlation time are chosen, by the marginal likelihood. Its cosines cost
the distance from the prior, not one amplitude each.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.affine import rotation_columns
from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.gap.effects.reference_attitude import REFERENCE
from mavcal.calib.gap.likelihood import AxisNoise
from mavcal.calib.gap.model.hypotheses import Binning, Hypothesis, HypothesisColumns, Part, add_block
from mavcal.calib.gap.model.joint import Model, Ridge, Setting, cosines, frame_of, normal_equations, starting_model
from mavcal.calib.gap.model.noise_fit import noise_fitted
from mavcal.calib.gap.model.refinement import misfit, refined
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.schema import ParameterEstimate
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.contest import Contest, tail_probability
from mavcal.calib.gap.search.evidence import price_of_kind
from mavcal.calib.gap.search.selection import ChosenModel, largest_gain, objective, select, total_price
from mavcal.calib.gap.search.terms import without_effect
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_MODES = 100
"""Cosines over the recording that represent the attitude error about one axis. Chosen, not measured: correlation times
of some percent of a recording need as many."""
_SCREENED = 4000
"""Samples of a series in the search for size and time. Chosen, not measured: it bounds the time of a search that is
refined afterwards."""


@dataclass(frozen=True, eq=False)
class WanderFit:
    """A model with a wandering reference, on averages of samples, and its contest.

    `gain` is its advantage; `size_deg` and `time_s` are rms and correlation time of the process. `start` is the model
    without an effect; its noise includes the part of the process above its last cosine.
    """

    chosen: ChosenModel
    contest: Contest
    gain: float
    size_deg: float
    time_s: float
    start: Model


def sees_attitude(view: View) -> bool:
    """Whether a series contains the reference's attitude error."""
    return view.reference_error and view.sensor is not Sensor.GYRO and not view.first


def fit_wander(chosen: ChosenModel, contest: Contest, start: Model, alpha: float) -> WanderFit | None:
    """The better model in which the reference's attitude wanders; None if there is none."""
    setting = start.setting
    if not any(map(sees_attitude, setting.views)) or contest.pace.ends():
        return None
    process, worth = _process_in_place_of_effects(chosen)
    gain, size, time = process.gain, process.size_deg, process.time_s
    tried = len(prices.WANDER_SIZES_DEG) * len(prices.WANDER_TIMES_S)
    price = 2.0 * math.log(tried) + price_of_kind(by_id()[REFERENCE]) + prices.EFFECT_COUNT_PRICE
    if worth < price - prices.WANDER_SLACK:
        return None
    least = max((contest.thresholds.lasting(v.sensor) for v in setting.views if sees_attitude(v)), default=0.0)
    if gain < max(prices.SECOND_ORDER_SHARE * largest_gain(chosen, contest), least):
        return None
    if tail_probability(gain, 2, tried) * (chosen.tests + 1) > alpha:
        return None
    frames = tuple(frame_of(view, _SCREENED) for view in setting.views)
    setting = replace(setting, frames=frames)
    # A wandering bias cannot be separated from a wandering reference.
    candidates = [
        h for h in contest.hypotheses if h.effect.id != REFERENCE and not (h.effect.drifts and _sees_direction(h))
    ]
    contest = Contest(candidates, thresholds=contest.thresholds, pace=contest.pace)
    columns = wander_columns(setting, frames)
    ridge = Ridge(columns, 1.0 / _prior(setting, size, time), np.zeros(columns.p), time_span(setting))
    start = starting_model(setting, with_tail(setting, start.noise, size, time), ridge)
    found = select(start, contest, alpha)
    better = objective(chosen) - (objective(found) + process_cost(found.model) + price)
    return WanderFit(found, contest, better, size, time, start) if better > 0.0 else None


def _process_in_place_of_effects(chosen: ChosenModel) -> tuple[_ProcessFit, float]:
    """The best process, and a lower bound of its advantage before its price; infinite if it replaces drift noise.

    It replaces every drift noise that it could cause, and every effect that it explains better. The part of drifts
    above its last cosine is added later (:func:`with_tail`).
    """
    bare, scores = chosen.model, {s.hypothesis.key: s for s in chosen.scores}
    drifts = [
        t.hypothesis.key for t in bare.noise_terms if t.hypothesis.effect.drifts and _sees_direction(t.hypothesis)
    ]
    for key in drifts:
        bare = without_effect(bare, key)
        scores.pop(key)
    bare = noise_fitted(refined(bare)[0]).model
    process = _Process.about(bare)
    best = process.best(bare)
    worth = math.inf if drifts else best.gain
    for score in sorted(scores.values(), key=lambda s: s.gain):
        if _can_be_replaced(score.hypothesis, bare.setting):
            other = refined(without_effect(bare, score.hypothesis.key))[0]
            found = process.best(other)
            better = found.gain - best.gain + total_price([score]) - (misfit(other) - misfit(bare))
            if better > 0.0:
                bare, best, worth = other, found, worth + better
    return best, worth


def _can_be_replaced(hypothesis: Hypothesis, setting: Setting) -> bool:
    """Whether the process could cause what the hypothesis describes."""
    effect = hypothesis.effect
    steady = isinstance(effect, MeanEffect) and not effect.tonal
    return steady and any(hypothesis.touches(view) for view in setting.views if sees_attitude(view))


def _sees_direction(hypothesis: Hypothesis) -> bool:
    return hypothesis.effect.sensor is not Sensor.GYRO


@dataclass(frozen=True, order=True)
class _ProcessFit:
    """Twice the gain of marginal log-likelihood of a process, its rms (deg) and its correlation time (s)."""

    gain: float
    size_deg: float
    time_s: float


@dataclass(frozen=True, eq=False)
class _Process:
    """Common data of all models with one noise: columns, weights by axis, and the priors.

    `priors`: rms, correlation time, roots (p,) of the prior variances, and :func:`inverse_root` with them.
    """

    frames: tuple[Binning, ...]
    columns: HypothesisColumns
    weight: tuple[Array, ...]
    priors: tuple[tuple[float, float, Array, tuple[Array, float]], ...]

    @classmethod
    def about(cls, model: Model) -> _Process:
        setting = model.setting
        frames = tuple(frame_of(view, _SCREENED) for view in setting.views)
        columns = wander_columns(setting, frames)
        weight = tuple(1.0 / frames[a // 3].power(model.noise[a].power) for a in range(setting.axes))
        normal = normal_equations([columns], [np.zeros_like(w) for w in weight], weight)
        priors = []
        for size, time in itertools.product(map(float, prices.WANDER_SIZES_DEG), prices.WANDER_TIMES_S):
            root = np.sqrt(_prior(setting, size, time))
            priors.append((size, time, root, inverse_root(np.eye(columns.p) + root[:, None] * normal.gram * root)))
        return cls(frames, columns, weight, tuple(priors))

    def best(self, model: Model) -> _ProcessFit:
        """The best rms and correlation time beside a model with that noise."""
        right = np.zeros(self.columns.p)
        for axis, part in self.columns.parts.items():
            v, c = divmod(axis, 3)
            (y,) = self.frames[v].bins(np.ascontiguousarray(model.residual[v][:, c][None]))
            right[part.index] += part.X @ (self.weight[axis] * y)
        return max(_ProcessFit(marginal_gain(half, root * right), size, time) for size, time, root, half in self.priors)


def inverse_root(inner: Array) -> tuple[Array, float]:
    """H (p, p) with ``H' H = A^-1``, and ``log det A``, of a matrix A = I + squares.

    Beside almost no noise these squares are so large that rounding makes some eigenvalues negative.
    """
    try:
        factor = np.linalg.cholesky(inner)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(inner)
        values = np.maximum(values, 1.0)
        return vectors.T / np.sqrt(values)[:, None], float(np.log(values).sum())
    half = solve_triangular(factor, np.eye(len(factor)), lower=True, check_finite=False)
    return half, 2.0 * float(np.log(np.diag(factor)).sum())


def marginal_gain(half: tuple[Array, float], right: Array) -> float:
    """``r' A^-1 r - log det A``, from :func:`inverse_root`."""
    scaled = half[0] @ right
    return float(scaled @ scaled) - half[1]


def with_tail(setting: Setting, noise: Sequence[AxisNoise], size_deg: float, time_s: float) -> tuple[AxisNoise, ...]:
    """The noise with the process above the last of its cosines, averaged over the attitudes of each sensor."""
    first, last = time_span(setting)
    changed = list(noise)
    for v, view in enumerate(setting.views):
        if not sees_attitude(view):
            continue
        omega = view.omega * view.whole.fs
        density = 2.0 * math.radians(size_deg) ** 2 * time_s / (1.0 + (omega * time_s) ** 2)
        power = np.where(omega > np.pi * _MODES / (last - first), density * view.fs, 0.0)
        ideal = view.ideal
        square = (ideal**2).mean(axis=0)
        for c in range(3):
            own = changed[3 * v + c]
            changed[3 * v + c] = replace(own, base=own.base + power * float(square.sum() - square[c]))
    return tuple(changed)


def _prior(setting: Setting, size_deg: float, time_s: float) -> Array:
    """Variances of the amplitudes of the cosines of a Gauss-Markov process, the same on three axes."""
    first, last = time_span(setting)
    omega = np.pi * np.arange(_MODES) / (last - first)
    density = 2.0 * math.radians(size_deg) ** 2 * time_s / (1.0 + (omega * time_s) ** 2)
    variance = density * 2.0 / (last - first)
    variance[0] *= 0.5
    return np.tile(variance, 3)


def time_span(setting: Setting) -> tuple[float, float]:
    """First and last time of all series."""
    return min(float(v.t[0]) for v in setting.views), max(float(v.t[-1]) for v in setting.views)


def wander_columns(setting: Setting, frames: Sequence[Binning]) -> HypothesisColumns:
    """Columns of the amplitudes, axis by axis, over every series that sees the reference's attitude."""
    span = time_span(setting)
    parts: dict[int, Part] = {}
    for v, view in enumerate(setting.views):
        if not sees_attitude(view):
            continue
        turn = np.add.reduce([w * rotation_columns(view.traces[i], math.nan) for i, w in view.weights.items()])
        turn, t = (
            _block_means(turn[:, view.keep], frames[v].factor),
            _block_means(view.t[None, :, None], frames[v].factor),
        )
        t = t[0, :, 0]
        waves = cosines(t, span, _MODES)
        block = turn[:, None] * waves[None, :, :, None]
        add_block(parts, v, block.reshape(3 * _MODES, len(t), 3), Binning(1, len(t)))
    return HypothesisColumns(3 * _MODES, parts)


def _block_means(values: Array, factor: int) -> Array:
    """Means of `values` (p, n, k) over `factor` samples, over which the cosines hardly change."""
    if factor == 1:
        return values
    whole = values.shape[1] // factor * factor
    return np.asarray(values[:, :whole].reshape(len(values), -1, factor, values.shape[2]).mean(axis=2))


def process_cost(model: Model) -> float:
    """The process' part of ``-2 log L``: distance from the prior, and volume (Laplace)."""
    assert model.ridge is not None
    ridge = model.ridge
    normal = normal_equations((), model.y, model.weight, ridge)
    volume = float(np.linalg.slogdet(normal.gram)[1]) - float(np.log(ridge.precision).sum())
    return float(ridge.precision @ ridge.value**2) + volume


def rms_rotation(model: Model) -> tuple[ParameterEstimate, ...]:
    """Rms of the attitude error about each axis, rad."""
    assert model.ridge is not None
    normal = normal_equations((), model.y, model.weight, model.ridge)
    covariance = np.linalg.inv(normal.gram)
    turn = model.ridge.rotation(np.linspace(*model.ridge.span, 400))
    waves = cosines(np.linspace(*model.ridge.span, 400), model.ridge.span, _MODES)
    made = []
    for axis in range(3):
        own = covariance[axis * _MODES : (axis + 1) * _MODES, axis * _MODES : (axis + 1) * _MODES]
        noise = float(np.einsum("mn,mk,kn->n", waves, own, waves).mean())
        size = math.sqrt(float((turn[:, axis] ** 2).mean()))
        se = math.sqrt(noise / max(1, _MODES // 4))
        made.append(ParameterEstimate(f"rotation.{'xyz'[axis]}", size, se, (size - 1.96 * se, size + 1.96 * se), "rad"))
    return tuple(made)
