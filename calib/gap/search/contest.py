"""Gain of each hypothesis beside the effects that the model already has.

The gain of columns is their Schur complement in the weighted Gram matrix, that of an effect on the noise its deviance.
The chance of such a gain without the effect is multiplied by the number of shapes that were tried (GAP 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc
from scipy.stats import binom

from mavcal.calib.gap.effects.base import EffectShape, MeanEffect, NoiseEffect
from mavcal.calib.gap.model.bands import combined
from mavcal.calib.gap.model.hypotheses import Hypothesis, columns_of
from mavcal.calib.gap.model.joint import Model, Term, with_residual
from mavcal.calib.gap.model.noise_fit import AxisFit, axes_of, axis_fit, densities_of, extra_rows
from mavcal.calib.gap.model.refinement import misfit, refined
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.added_noise import (
    AddedNoise,
    drift_exceeds_lines,
    exceeds_flight_differences,
    is_on_loud_instances,
    tone_exceeds_lines,
)
from mavcal.calib.gap.search.column_cache import ColumnCache
from mavcal.calib.gap.search.evidence import (
    price_of_fixed,
    price_of_kind,
    price_of_noise,
    price_of_repetition,
    price_of_search,
)
from mavcal.calib.gap.search.filtered_noise import evidence_of_filters, filter_evidence
from mavcal.calib.gap.search.projection import Gain, Projection
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_STEPS = 10
"""Evaluations in the search for a shape. Chosen, not measured: it bounds the time; the final fit goes on from there."""
_STEPS_FIXED = 25
"""Evaluations in the search for a shape that is the only parameter. Chosen, not measured: golden sections of so many
reach 1e-5 of the interval."""


@dataclass(frozen=True, eq=False)
class ContestScore:
    """Score of a hypothesis beside a model.

    `gain` is twice the gain of log-likelihood, `p` the chance of it without the effect, corrected for the grid. `delta`
    is the gain less its price (:mod:`calib.gap.search.evidence`), and `beta` the amplitudes.
    """

    hypothesis: Hypothesis
    theta: float
    gain: float
    df: int
    grid: int
    p: float
    delta: float
    beta: Array
    sure: bool = True
    """Whether the shape is the optimum, not only the best on a grid."""

    @property
    def price(self) -> float:
        """Price of its degrees of freedom and of the search, in twice the log-likelihood."""
        return self.gain - self.delta


def tail_probability(gain: float, df: int, grid: int) -> float:
    """Chance that the best of `grid` values has that gain without an effect."""
    return 1.0 if df == 0 or gain <= 0.0 else min(1.0, grid * float(chdtrc(df, gain)))


def one_sided_tail_probability(gain: float, df: int, grid: int) -> float:
    """The same probability for `df` non-negative amplitudes: each is zero half of the time (chi-bar squared)."""
    if gain <= 0.0:
        return 1.0
    weights = binom.pmf(np.arange(1, df + 1), df, 0.5)
    return min(1.0, grid * float(weights @ chdtrc(np.arange(1, df + 1), gain)))


def refinable(score: ContestScore) -> bool:
    """Whether a fit of the shape, or a fit without linearisation, could gain more."""
    effect = score.hypothesis.effect
    return isinstance(effect, MeanEffect) and (
        (effect.shape is not None and score.gain > prices.REFINEMENT_GAIN)
        or (effect.exact is not None and score.gain > prices.EXACT_FIT_GAIN)
    )


class Contest:
    """Scores of hypotheses against models of one setting; `columns` keeps transformed columns while they fit in memory.

    `pace` says when the search for effects has to end.
    """

    def __init__(
        self,
        hypotheses: Sequence[Hypothesis],
        budget: int = 40_000_000,
        thresholds: GainThresholds | None = None,
        columns: ColumnCache | None = None,
        pace: GapPace | None = None,
    ) -> None:
        self.hypotheses = tuple(hypotheses)
        self.thresholds = thresholds or GainThresholds()
        self.pace = pace or GapPace()
        self.columns = ColumnCache(budget) if columns is None else columns

    def restricted_to(self, hypotheses: Sequence[Hypothesis]) -> Contest:
        """A contest of other hypotheses on the same setting, with the same cache of columns."""
        return Contest(hypotheses, thresholds=self.thresholds, columns=self.columns, pace=self.pace)

    def without_thresholds(self) -> Contest:
        """The same contest without minimum gains."""
        return Contest(self.hypotheses, columns=self.columns, pace=self.pace)

    def score(self, hypothesis: Hypothesis, beside: Projection, *, refine: bool = True) -> ContestScore:
        """Score of `hypothesis` at its best shape; without `refine` at the best shape of its grid."""
        effect = hypothesis.effect
        if isinstance(effect, NoiseEffect):
            return noise_score(hypothesis, beside.model)
        if effect.shape is None:
            gain = beside.gain(self.columns.of(hypothesis, math.nan, beside.model.setting))
            found = free_score(hypothesis, math.nan, _exact(hypothesis, gain, beside) if refine else gain, 1)
        else:
            found = self._shape_score(hypothesis, effect.shape, beside, refine=refine)
        return found if refine else replace(found, sure=not refinable(found))

    def scores(self, hypotheses: Sequence[Hypothesis], beside: Projection) -> list[ContestScore]:
        """Scores on the grids. A score that is not `sure` has to be refined before it counts.

        Refinement can only raise the gain of a free amplitude; the grid gain of a fixed one is an upper bound.
        Hypotheses for which no time is left are omitted.
        """
        found = []
        for hypothesis in hypotheses:
            if self.pace.ends():
                break
            found.append(self.score(hypothesis, beside, refine=False))
        return found

    def refined_scores(self, scores: Sequence[ContestScore], beside: Projection, least: float) -> list[ContestScore]:
        """The scores, refined where their `delta` may exceed `least`."""
        found = []
        for score in scores:
            known = score.sure or score.delta < least or self.pace.ends()
            found.append(score if known else self.score(score.hypothesis, beside))
        return found

    def _shape_score(
        self, hypothesis: Hypothesis, shape: EffectShape, beside: Projection, *, refine: bool
    ) -> ContestScore:
        """Score of an effect on the mean with a shape: the best of its grid, refined where it gains enough."""
        effect = hypothesis.effect
        assert isinstance(effect, MeanEffect)
        trace, view = most_sensitive_series(hypothesis, beside.model)
        setting = beside.model.setting
        own = trace if shape.screen is not None else setting.views[view].whole.any_trace
        grid = np.asarray(shape.grid(own))
        tried = grid if shape.screen is None else shape.screen(trace, residual_on_grid(beside.model, view, trace))
        if effect.fixed:
            return self._fixed_score(hypothesis, tried, beside, refine=refine)
        gains = beside.free_gains([self.columns.of(hypothesis, float(theta), setting) for theta in tried])
        if not gains:
            return free_score(hypothesis, math.nan, Gain(0.0, 0, np.zeros(0), 0.0), 1)
        best = int(np.argmax(gains))
        theta = float(tried[best])
        if refine and gains[best] > prices.REFINEMENT_GAIN:
            theta = self._refined(hypothesis, theta, grid, beside)
        found = beside.gain(self.columns.of(hypothesis, theta, setting))
        score = free_score(hypothesis, theta, found, len(grid))
        return score if tone_exceeds_lines(hypothesis, found.beta, beside.model) else replace(score, p=1.0)

    def _fixed_score(self, hypothesis: Hypothesis, grid: Array, beside: Projection, *, refine: bool) -> ContestScore:
        """Score of an effect that is only a shape; without `refine` the gain of a free amplitude, an upper bound."""
        columns = [self.columns.of(hypothesis, float(theta), beside.model.setting) for theta in grid]
        gains = beside.free_and_fixed_gains(columns)
        free, best = float(gains[:, 0].max()), int(np.argmax(gains[:, 1]))
        if not refine and free > prices.REFINEMENT_GAIN:
            return fixed_score(hypothesis, float(grid[0]), free)
        if free <= prices.REFINEMENT_GAIN:
            return fixed_score(hypothesis, float(grid[best]), float(gains[best, 1]))
        theta = self._refined(hypothesis, float(grid[best]), grid, beside)
        setting = beside.model.setting
        gain = beside.fixed_gain(columns_of(hypothesis, theta, setting.views, setting.frames))
        return fixed_score(hypothesis, theta, gain + filter_evidence(hypothesis, theta, beside.model))

    def _refined(self, hypothesis: Hypothesis, theta: float, grid: Array, beside: Projection) -> float:
        """The best shape between the neighbours of `theta` on the grid."""
        i = int(np.argmin(np.abs(grid - theta)))
        low, high = float(grid[max(i - 1, 0)]), float(grid[min(i + 1, len(grid) - 1)])
        effect = hypothesis.effect
        assert isinstance(effect, MeanEffect)

        def loss(value: float) -> float:
            columns = columns_of(hypothesis, value, beside.model.setting.views, beside.model.setting.frames)
            return -(beside.fixed_gain(columns) if effect.fixed else beside.free_gains([columns])[0])

        if high <= low:
            return theta
        options = {"maxiter": _STEPS_FIXED if effect.fixed else _STEPS, "xatol": 1e-6 * (high - low)}
        found = minimize_scalar(loss, bounds=(low, high), method="bounded", options=options)
        return float(found.x) if found.fun < loss(theta) else theta


def _exact(hypothesis: Hypothesis, found: Gain, beside: Projection) -> Gain:
    """`found` without linearisation, for an effect that is nonlinear in its amplitudes and gains enough."""
    effect = hypothesis.effect
    if not isinstance(effect, MeanEffect) or effect.exact is None or found.gain <= prices.EXACT_FIT_GAIN:
        return found
    gain, beta = exact_gain(hypothesis, found.beta, beside)
    return replace(found, gain=gain, beta=beta, evidence=gain - found.price)


def exact_gain(hypothesis: Hypothesis, beta: Array, beside: Projection) -> tuple[float, Array]:
    """Gain and amplitudes of an effect beside a model, without linearisation."""
    bare = beside.model
    rest = tuple(t for i, t in enumerate(bare.terms) if i not in beside.omit)
    terms = (*rest, Term(hypothesis, beta, math.nan))
    model, _ = refined(with_residual(replace(bare, terms=terms)))
    return beside.misfit_without_omitted - misfit(model), model.terms[-1].beta


def free_score(hypothesis: Hypothesis, theta: float, found: Gain, grid: int) -> ContestScore:
    """Score of an effect on the mean with free amplitudes."""
    hidden = hypothesis.effect.hidden if found.df else 0
    price = price_of_search(grid, found.gain) + hidden * price_of_fixed(found.gain)
    price += price_of_kind(hypothesis.effect) + hypothesis.handicap
    price += price_of_repetition(hypothesis.again) if hypothesis.effect.jumps else 0.0
    p = tail_probability(found.gain, found.df + hidden, grid)
    return ContestScore(hypothesis, theta, found.gain, found.df + hidden, grid, p, found.evidence - price, found.beta)


def fixed_score(hypothesis: Hypothesis, theta: float, gain: float) -> ContestScore:
    """Score of an effect on the mean that has only a shape."""
    delta = gain - price_of_fixed(gain) - hypothesis.handicap
    return ContestScore(
        hypothesis,
        theta,
        gain,
        1,
        prices.FIXED_SHAPE_SIDES,
        tail_probability(gain, 1, prices.FIXED_SHAPE_SIDES),
        delta,
        np.ones(1),
    )


def noise_score(hypothesis: Hypothesis, model: Model) -> ContestScore:
    """Score of an effect on the noise, with its amplitudes and those of the model fitted together."""
    effect = hypothesis.effect
    assert isinstance(effect, NoiseEffect)
    thetas, grid = [math.nan], 1
    if effect.shape is not None:
        trace, view = most_sensitive_series(hypothesis, model)
        tried, screen = effect.shape.grid(trace), effect.shape.screen
        grid = len(tried)
        thetas = [
            float(theta) for theta in (tried if screen is None else screen(trace, residual_on_grid(model, view, trace)))
        ]
    fits = noise_fits(model, effect.sensor)
    scores = [_noise_gain(hypothesis, theta, model, fits) for theta in thetas]
    best = max(range(len(thetas)), key=lambda i: scores[i][0])
    gain, values, price = scores[best]
    gain = max(gain - evidence_of_filters(model, effect.sensor), 0.0)
    df = len(effect.parameters)
    added = AddedNoise(hypothesis, thetas[best], values)
    own = is_on_loud_instances(added, model) if hypothesis.loud is None else hypothesis.loud
    believed = gain > 0.0 and exceeds_flight_differences(added, model) and drift_exceeds_lines(added, model) and own
    p = one_sided_tail_probability(gain, df, grid) if believed else 1.0
    price += price_of_search(grid, gain) + price_of_kind(effect) + hypothesis.handicap
    return ContestScore(hypothesis, thetas[best], gain, df, grid, p, gain - price, values)


@remembered(6)
def noise_fits(model: Model, sensor: Sensor) -> tuple[AxisFit, ...]:
    """Noise fits of the three axes of a sensor."""
    return tuple(axis_fit(model, axes_of(model.setting, sensor, c)) for c in range(3))


@remembered(32)
def unchanged_deviance(fit: AxisFit) -> float:
    """``-2 log L`` of an axis without an added density."""
    return fit.fitted()[1]


def _noise_gain(
    hypothesis: Hypothesis, theta: float, model: Model, fits: Sequence[AxisFit]
) -> tuple[float, Array, float]:
    """Gain, amplitudes and price of added noise at one shape."""
    by_view = {
        v: densities_of(hypothesis, view, theta)
        for v, view in enumerate(model.setting.views)
        if hypothesis.touches(view)
    }
    effect = hypothesis.effect
    assert isinstance(effect, NoiseEffect)
    gain, values, known = 0.0, [], []
    for fit in fits:
        rows = extra_rows(model, fit, by_view)
        if not fit.may_gain(rows):
            values.append(np.zeros(len(rows)))
            known.append(fit.information_of(rows))
            continue
        without = unchanged_deviance(fit)
        amplitudes, level, information = fit.fitted(rows)
        known.append(_marginal(information)[len(fit.names) :])
        gain += max(without - level, 0.0)
        added = amplitudes[len(fit.names) :]
        values.append(added)
        if effect.variance is not None and without - level > prices.ENVELOPE_GAIN:
            for a in fit.axes:
                if a // 3 in by_view:
                    view = model.setting.views[a // 3]
                    instance = max(
                        (i for i in view.weights if i in hypothesis.instances), key=lambda i: view.weights[i]
                    )
                    envelope = effect.variance(view.traces[instance])
                    gain += envelope_gain(model, a, envelope, added @ by_view[a // 3])
    by_density = zip(np.array(values).T, np.array(known).T, strict=True)
    return gain, np.array(values).T, sum(price_of_noise(a, i) for a, i in by_density)


def _marginal(information: Array) -> Array:
    """Information of each amplitude when the others are unknown too."""
    variance = np.diag(np.linalg.pinv(information, rcond=1e-12, hermitian=True))
    return np.asarray(1.0 / np.maximum(variance, np.finfo(float).tiny))


def envelope_gain(model: Model, axis: int, envelope: Array, density: Array) -> float:
    """Twice the log-likelihood by which added noise that follows `envelope` (N,), of mean one, beats stationary noise.

    Only bins count in which the added `density` (n,) is a good part of the power. There the residual's power should
    follow the envelope in that proportion.
    """
    v, c = divmod(axis, 3)
    power = model.noise[axis].power + density
    part = density / power
    band = part > max(0.5 * float(part.max()), 1e-3)
    view = model.setting.views[v]
    series = view.whitened(np.where(band, view.spectra(model.residual[v])[c] / np.sqrt(power), 0.0))
    width = float(band.sum()) / view.n
    added = float(part[band].mean()) if band.any() else 0.0
    if added == 0.0:
        return 0.0
    expected = np.maximum((1.0 - added) + added * envelope[view.keep], 1e-3)
    expected /= expected.mean()
    squares = series**2
    squares /= max(float(squares.mean()), 1e-300)
    return width * float((squares * (1.0 - 1.0 / expected) - np.log(expected)).sum())


def most_sensitive_series(hypothesis: Hypothesis, model: Model) -> tuple[Trace, int]:
    """The trace and the index of the series in which a hypothesis shows most; among equals, the one with most residual.

    The effect may have occurred in one block only. The lower band of a series represents both.
    """
    found = [
        (abs(weight), v, i)
        for v, view in enumerate(model.setting.views)
        if hypothesis.touches(view)
        for i, weight in view.weights.items()
        if i in hypothesis.instances and not (view.first and hypothesis.touches(model.setting.views[v - 1]))
    ]
    most = max(weight for weight, _, _ in found)
    alike = [(v, i) for weight, v, i in found if weight == most]
    v, i = alike[0] if len(alike) == 1 else max(alike, key=lambda one: _weighted_power(model, one[0]))
    view = model.setting.views[v]
    whole = hypothesis.fast or isinstance(hypothesis.effect, NoiseEffect)
    return (view.whole if whole else view).traces[i], v


def _weighted_power(model: Model, v: int) -> float:
    """Largest weighted mean square of the residual of a series, over axes and bands."""
    views = model.setting.views
    bands = [v, v + 1] if v + 1 < len(views) and views[v + 1].first else [v]
    return max(float((model.weight[a] * model.y[a] ** 2).mean()) for b in bands for a in range(3 * b, 3 * b + 3))


@remembered(8)
def residual_on_grid(model: Model, v: int, trace: Trace) -> Array:
    """The residual of a series on the grid of `trace`, zero where rows are not kept; both bands at its own rate."""
    view, left = model.setting.views[v], model.residual[v]
    full = np.zeros((len(trace.t), 3))
    if view.fine is None or len(trace.t) == len(view.keep):
        full[view.keep] = left
        return full
    views = model.setting.views
    upper = model.residual[v + 1] if v + 1 < len(views) and views[v + 1].first else None
    lower, rest = np.zeros((len(view.keep), 3)), np.zeros_like(full)
    lower[view.keep] = left
    if upper is not None:
        rest[view.fine.keep] = upper
    return combined(lower, rest)
