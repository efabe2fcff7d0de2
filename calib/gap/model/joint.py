"""A model of the gap: effects on the mean and on the noise, fitted together.

The model is linearised: columns of linear effects, and derivatives of the others by their shape and (rotations) by
their parameters. Gauss-Newton steps over all of them reach the joint maximum.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.gap.likelihood import AxisNoise, FrequencyBins, bins_of
from mavcal.calib.gap.model.hypotheses import (
    Binning,
    Hypothesis,
    HypothesisColumns,
    Part,
    add_block,
    columns_in,
    columns_of,
)
from mavcal.calib.gap.model.normal_equations import weighted_gram
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.remembered import remembered

Array = NDArray[np.float64]

_LONGEST = 40_000
"""Samples above which the mean is fitted to averages of consecutive samples. Chosen, not measured: it bounds time and
memory."""


@dataclass(frozen=True, eq=False)
class Setting:
    """The series of a problem and their transforms."""

    views: tuple[View, ...]
    frames: tuple[Binning, ...]
    bins: tuple[FrequencyBins, ...]

    @property
    def axes(self) -> int:
        """Axes over all series; axis ``3 v + c`` is axis c of series v."""
        return 3 * len(self.views)

    @property
    def samples(self) -> int:
        """Count of numbers over all axes."""
        return 3 * sum(view.count for view in self.views)


def setting_of(views: tuple[View, ...]) -> Setting:
    """The setting of series."""
    return Setting(views, tuple(frame_of(view, _LONGEST) for view in views), tuple(bins_of(v.count) for v in views))


def frame_of(view: View, longest: int) -> Binning:
    """Binning to at most about `longest` averages; an upper band is not averaged."""
    return Binning(1 if view.first else max(1, view.n // longest), view.n, view.first)


@dataclass(frozen=True, eq=False)
class Term:
    """An effect on the mean in the model: amplitudes `beta` (p,) and shape `theta` (NaN without one)."""

    hypothesis: Hypothesis
    beta: Array
    theta: float

    @property
    def effect(self) -> MeanEffect:
        """The effect of the catalogue."""
        assert isinstance(self.hypothesis.effect, MeanEffect)
        return self.hypothesis.effect

    @property
    def values(self) -> Array:
        """All estimated values: the amplitudes unless they are fixed, then the shape."""
        free = self.beta[: 0 if self.effect.fixed else None]
        return free if self.effect.shape is None else np.append(free, self.theta)

    def moved(self, step: Array, limits: tuple[float, float]) -> Term:
        """The term after a step of its `values`."""
        new = self.values + step
        if self.effect.shape is None:
            return replace(self, beta=new)
        theta = float(np.clip(new[-1], *limits))
        return replace(self, theta=theta, beta=self.beta if self.effect.fixed else new[:-1])


@dataclass(frozen=True, eq=False)
class NoiseTerm:
    """An effect on the noise in the model; its densities carry its name."""

    hypothesis: Hypothesis
    theta: float

    def name(self, j: int) -> str:
        """Name of its j-th density."""
        effect_id, instances = self.hypothesis.key
        return f"{effect_id}{list(instances)}#{j}"


@dataclass(frozen=True, eq=False)
class Model:
    """Terms, the residual, and the noise.

    `residual` by series (n, 3); `noise` by axis; `y` and `weight` by axis in the averaged bins of the mean.
    """

    setting: Setting
    terms: tuple[Term, ...]
    noise_terms: tuple[NoiseTerm, ...]
    noise: tuple[AxisNoise, ...]
    residual: tuple[Array, ...]
    y: tuple[Array, ...]
    weight: tuple[Array, ...]
    ridge: Ridge | None = None

    @property
    def members(self) -> tuple[Term | NoiseTerm, ...]:
        """All terms."""
        return (*self.terms, *self.noise_terms)

    def wanders_in(self, v: int) -> bool:
        """Whether series `v` contains the reference's attitude error."""
        return self.ridge is not None and any(3 * v + c in self.ridge.columns.parts for c in range(3))

    def periodogram(self, axis: int) -> Array:
        """Sums of squares of the residual's transform in merged bins."""
        v, c = divmod(axis, 3)
        return self.setting.bins[v].total(self.setting.views[v].spectra(self.residual[v])[c] ** 2)


@dataclass(frozen=True, eq=False)
class Ridge:
    """An error of the reference's attitude that wanders: a random process with a known prior.

    Parameters
    ----------
    columns
        Of its amplitudes, transformed: three axes of `modes` cosines each.
    precision
        Inverse prior variances of the amplitudes.
    value
        Present values of the amplitudes, rad.
    span
        First and last time, s; cosine m has m half periods between them.
    """

    columns: HypothesisColumns
    precision: Array
    value: Array
    span: tuple[float, float]

    def rotation(self, t: Array) -> Array:
        """The attitude error at times `t` (n,), rotation vectors (n, 3) in rad."""
        by_axis = self.value.reshape(3, -1)
        return cosines(t, self.span, by_axis.shape[1]).T @ by_axis.T

    def predicted(self, view: View) -> Array:
        """Change of the mean of a series, (n, 3)."""
        by_axis = self.value.reshape(3, -1)
        turn = by_axis @ _cosines_at(view, self.span, by_axis.shape[1])
        x, y, z = _ideal_reading(view)
        return np.stack([turn[1] * z - turn[2] * y, turn[2] * x - turn[0] * z, turn[0] * y - turn[1] * x], axis=1)


@remembered(6)
def _cosines_at(view: View, span: tuple[float, float], modes: int) -> Array:
    """The cosines at the times of a series, kept, since only their amplitudes change from step to step."""
    return cosines(view.t, span, modes)


@remembered(6)
def _ideal_reading(view: View) -> Array:
    """The ideal reading of a series, (3, n), which an attitude error rotates."""
    return np.ascontiguousarray(view.ideal.T)


def cosines(t: Array, span: tuple[float, float], modes: int) -> Array:
    """``cos(pi m s)``, (modes, n), where s runs from 0 to 1 over `span`."""
    s = (t - span[0]) / (span[1] - span[0])
    return np.asarray(np.cos(np.pi * np.arange(modes)[:, None] * s[None, :]))


def starting_model(setting: Setting, noise: tuple[AxisNoise, ...], ridge: Ridge | None = None) -> Model:
    """A model without effects."""
    residual = tuple(view.residual for view in setting.views)
    model = Model(setting, (), (), noise, residual, (), (), ridge)
    return with_noise(with_residual(model), noise)


def with_residual(model: Model) -> Model:
    """The model with its residual computed from its terms."""
    setting = model.setting
    residual: list[Array] = []
    y: list[Array] = []
    for v, view in enumerate(setting.views):
        own = tuple(term for term in model.terms if term.hypothesis.touches(view))
        seen = model.wanders_in(v)
        left, bins = _residual_of(view, setting.frames[v], own, model.ridge if seen else None)
        residual.append(left)
        y += bins
    return replace(model, residual=tuple(residual), y=tuple(y))


@remembered(64)
def _residual_of(
    view: View, frame: Binning, terms: tuple[Term, ...], ridge: Ridge | None
) -> tuple[Array, tuple[Array, ...]]:
    """Residual of a series without terms and ridge, and its bins by axis, kept for the next change of a term."""
    left = view.residual
    for term in terms:
        left = left - predicted(term, view)
    if ridge is not None:
        left = left - ridge.predicted(view)
    if frame.factor == 1 and frame.size == view.n:  # the noise is fitted to the same transform
        return left, tuple(view.spectra(left))
    return left, tuple(frame.bins(np.ascontiguousarray(left.T)))


def with_noise(model: Model, noise: tuple[AxisNoise, ...]) -> Model:
    """The model with another noise."""
    old = model.noise if model.weight else (None,) * len(noise)
    weight = [
        model.weight[a] if old[a] is noise[a] else 1.0 / model.setting.frames[a // 3].power(noise[a].power)
        for a in range(model.setting.axes)
    ]
    return replace(model, noise=noise, weight=tuple(weight))


@remembered(64)
def predicted(term: Term, view: View) -> Array:
    """Change of the mean by `term` in `view`, shape (n, 3)."""
    effect = term.effect
    if effect.exact is not None:
        exact = effect.exact
        beta = term.beta
        return _exact_change(exact, term.hypothesis, beta, view)
    if effect.signals is not None:
        signals = _columns_in(effect.signals, term.hypothesis, term.theta, view)
        return np.asarray(signals.T @ term.beta.reshape(len(signals), 3))
    columns = _columns_in(effect.columns, term.hypothesis, term.theta, view)
    return np.asarray(np.tensordot(term.beta, columns, axes=1))


@remembered(32)
def _columns_in(columns: Callable[[Trace, float], Array], hypothesis: Hypothesis, theta: float, view: View) -> Array:
    """Columns or signals of a hypothesis in `view`, kept, since amplitudes change far more often than shapes."""
    return columns_in(columns, hypothesis, theta, view)


def _exact_change(exact: Callable[[Trace, Array], Array], hypothesis: Hypothesis, beta: Array, view: View) -> Array:
    rows = [
        weight * exact(view.traces[i], beta)[view.keep]
        for i, weight in view.weights.items()
        if i in hypothesis.instances
    ]
    return np.asarray(np.add.reduce(rows))


def limits_of(term: Term, setting: Setting) -> tuple[float, float]:
    """Range of the grid of the term's shape."""
    shape = term.effect.shape
    if shape is None:
        return (-np.inf, np.inf)
    view = next((view for view in setting.views if term.hypothesis.touches(view)), None)
    if view is None:  # nothing of it is in this part of the recording
        return (-np.inf, np.inf)
    grid = shape.grid(view.whole.any_trace)
    return float(grid[0]), float(grid[-1])


@remembered(40)
def jacobian(term: Term, setting: Setting) -> HypothesisColumns:
    """Columns of everything that `term` estimates, at its present values."""
    effect = term.effect
    if effect.shape is None and effect.exact is None:
        found = _columns(term.hypothesis, term.theta, setting)
        return (
            found if found.p else HypothesisColumns(len(term.values), {})
        )  # a block in which its sensor has no samples
    count = len(term.values)
    limits = limits_of(term, setting)
    linear = effect.exact is None and not effect.fixed
    parts: dict[int, Part] = {}
    for v, view in enumerate(setting.views):
        if not term.hypothesis.touches(view):
            continue
        block = [_derivative(term, view, j, limits) for j in range(count - 1 if linear else 0, count)]
        add_block(parts, v, np.asarray(block), setting.frames[v])
    if not linear:
        return HypothesisColumns(count, parts)
    own = _columns(term.hypothesis, term.theta, setting).parts
    return HypothesisColumns(count, {a: _with_row(own.get(a), parts.get(a), count - 1) for a in sorted({*own, *parts})})


def amplitudes(term: Term, setting: Setting) -> HypothesisColumns:
    """Columns of the amplitudes, with zero columns for the shape."""
    if term.effect.shape is None or term.effect.exact is not None or term.effect.fixed:
        return jacobian(term, setting)
    return HypothesisColumns(len(term.values), _columns(term.hypothesis, term.theta, setting).parts)


@remembered(40)
def _columns(hypothesis: Hypothesis, theta: float, setting: Setting) -> HypothesisColumns:
    """Columns of an effect at a shape, kept while only amplitudes change."""
    return columns_of(hypothesis, theta, setting.views, setting.frames)


def _with_row(own: Part | None, last: Part | None, row: int) -> Part:
    """The columns of an axis, followed by the one of number `row`."""
    found = [own] if own is not None else []
    if last is not None:
        found.append(Part(last.index + row, last.X))
    return Part(np.concatenate([p.index for p in found]), np.concatenate([p.X for p in found]))


def _derivative(term: Term, view: View, j: int, limits: tuple[float, float]) -> Array:
    """Central derivative of the prediction by value j."""
    is_shape = term.effect.shape is not None and j == len(term.values) - 1
    span = limits[1] - limits[0] if is_shape else 1.0
    size = max(1e-4 * span, 1e-3 * abs(term.values[j])) if is_shape else 1e-5
    step = np.zeros(len(term.values))
    step[j] = size
    up, down = term.moved(step, limits), term.moved(-step, limits)
    width = up.values[j] - down.values[j]
    if width == 0.0:  # beyond an end of the range that this series allows
        return np.zeros((view.n, 3))
    return np.asarray((predicted(up, view) - predicted(down, view)) / width)


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of stacked hypotheses: Gram matrix, right side, and their rows."""

    gram: Array
    right: Array
    slices: tuple[slice, ...]


def normal_equations(
    blocks: Sequence[HypothesisColumns], y: Sequence[Array], weight: Sequence[Array], ridge: Ridge | None = None
) -> Normal:
    """``X' W X`` and ``X' W y`` over all axes; the ridge's columns come last, with their prior precision."""
    everything = [*blocks, ridge.columns] if ridge else list(blocks)
    slices = slices_of(everything)
    total = slices[-1].stop if slices else 0
    gram, right = np.zeros((total, total)), np.zeros(total)
    for axis in range(len(y)):
        index, X = stacked(blocks, slices[: len(blocks)], axis)
        weighted = X * weight[axis] if len(index) else X
        if len(index):
            gram[index[:, None], index] += weighted @ X.T
            right[index] += weighted @ y[axis]
        if ridge and axis in ridge.columns.parts:
            wave = ridge.columns.parts[axis]
            rows = wave.index + slices[-1].start
            gram[rows[:, None], rows] += weighted_gram(wave, weight[axis])
            right[rows] += wave.X @ (weight[axis] * y[axis])
            if len(index):
                cross = weighted @ wave.X.T
                gram[index[:, None], rows] += cross
                gram[rows[:, None], index] += cross.T
    if ridge:
        rows = np.arange(slices[-1].start, total)
        gram[rows, rows] += ridge.precision
        right[rows] -= ridge.precision * ridge.value
    return Normal(gram, right, tuple(slices))


def slices_of(blocks: Sequence[HypothesisColumns]) -> list[slice]:
    """Rows of each block when they are stacked."""
    ends = np.cumsum([0, *(b.p for b in blocks)])
    return [slice(int(i), int(j)) for i, j in itertools.pairwise(ends)]


def stacked(blocks: Sequence[HypothesisColumns], slices: Sequence[slice], axis: int) -> tuple[NDArray[np.intp], Array]:
    """Indices and columns of all `blocks` on one axis."""
    found = [(b.parts[axis], s.start) for b, s in zip(blocks, slices, strict=True) if axis in b.parts]
    if not found:
        return np.zeros(0, np.intp), np.zeros((0, 0))
    return np.concatenate([part.index + start for part, start in found]), np.concatenate([part.X for part, _ in found])


@dataclass(frozen=True, eq=False)
class Joint:
    """Joint covariance of all values of the mean, and the rows of each term."""

    covariance: Array
    slices: tuple[slice, ...]
    normal: Normal
