"""Hypotheses: an effect of the catalogue on one instance, or with common parameters on all."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect, NoiseEffect
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.likelihood import fast_length, transform
from mavcal.calib.gap.model.bands import resampled
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.problem import FaultyInstances, Trace
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_REPETITION_MARK = "'"
_REPEATS = 4
"""Times that an effect that can be repeated is looked for. Chosen, not measured: it bounds the time."""
_OTHER_INSTANCE_PRICE = 24.0
"""Price of an effect on an instance other than the faulty one; it decides only between otherwise equal explanations.
Chosen, not measured: odds of exp(12) against the other instance."""
_CANCELS = 1e-9
"""Sum of the weights of a difference. Source: rounding."""
_WAVE = "~wave"
"""Form of an effect that follows the angle of a rotor."""


Key = tuple[str, tuple[int, ...]]
"""What tells hypotheses apart: the effect, in its form and number, and its instances."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An effect on `instances` of its sensor (of every sensor for shared effects).

    `again` counts the earlier occurrences of a repeatable effect. `handicap` is its price, in twice the log-likelihood,
    if another instance is likelier to have the error. `loud`: whether its instances have such noise; None if only their
    residuals can tell.
    """

    effect: CatalogueEffect
    instances: tuple[int, ...]
    again: int = 0
    handicap: float = 0.0
    loud: bool | None = None

    @property
    def key(self) -> tuple[str, tuple[int, ...]]:
        """Identity of the hypothesis."""
        return self.effect.id + self.effect.form + _REPETITION_MARK * self.again, self.instances

    @property
    def before(self) -> tuple[str, tuple[int, ...]] | None:
        """Key of the previous occurrence, which must be in the model first; None for the first."""
        name = self.effect.id + self.effect.form
        return (name + _REPETITION_MARK * (self.again - 1), self.instances) if self.again else None

    def touches(self, view: View) -> bool:
        """Whether it changes that series."""
        own = self.effect.shared or view.sensor is self.effect.sensor
        slow = isinstance(self.effect, MeanEffect) and not self.fast
        return own and not (slow and view.first) and any(i in view.weights for i in self.instances)

    @property
    def fast(self) -> bool:
        """Whether it changes the mean at high frequencies, and is computed at the sensor's own rate."""
        return self.periodic or (self.effect.jumps and not self.effect.form)

    @property
    def periodic(self) -> bool:
        """Whether it is a wave, which drift noise cannot replace."""
        return self.effect.tonal or self.effect.form == _WAVE

    def is_covered_by(self, others: Iterable[Hypothesis]) -> bool:
        """Whether one of `others` is the same effect on the same instances in any form, unless it is repeatable."""
        places = [other.instances for other in others if other.effect.id == self.effect.id]
        return not self.effect.repeatable and self.instances in places

    def is_unobservable_beside(self, others: Iterable[Hypothesis], views: Iterable[View]) -> bool:
        """Whether, beside the same effect on other units, it is visible only in differences of these units.

        Equal errors of all units cancel there, so only their difference is observable. Repeatable effects such as steps
        differ in their times.
        """
        if not isinstance(self.effect, MeanEffect) or self.effect.shared or self.effect.repeatable:
            return False
        alike = [other for other in others if other.effect.id == self.effect.id]
        units = {i for h in (self, *alike) for i in h.instances}
        seen = [view for view in views if any(h.touches(view) for h in (self, *alike))]
        return bool(alike) and all(
            set(view.weights) <= units and abs(sum(view.weights.values())) < _CANCELS for view in seen
        )


@dataclass(frozen=True, eq=False)
class Part:
    """Transformed columns on one axis of one series: those that are not zero there, with their numbers."""

    index: NDArray[np.intp]
    X: Array


@dataclass(frozen=True, eq=False)
class HypothesisColumns:
    """`p` columns over every axis of every series; axis ``3 v + c`` is axis c of series v.

    `groups` numbers the units of their amplitudes; None: all have the same.
    """

    p: int
    parts: Mapping[int, Part] = field(default_factory=dict)
    groups: NDArray[np.intp] | None = None

    @property
    def units(self) -> NDArray[np.intp]:
        """Number of the unit of each amplitude, (p,)."""
        return np.zeros(self.p, np.intp) if self.groups is None else self.groups


def hypotheses_of(
    effects: Iterable[CatalogueEffect], views: Sequence[View], worse: Mapping[Sensor, FaultyInstances] | None = None
) -> tuple[tuple[Hypothesis, ...], tuple[tuple[str, str, str], ...]]:
    """Every hypothesis that can be tested, and (id, reason, need) of the others.

    `worse`: by sensor with two instances, which of them has an error.
    """
    tested: list[Hypothesis] = []
    missing: list[tuple[str, str, str]] = []
    for effect in effects:
        if not isinstance(effect, MeanEffect | NoiseEffect):
            continue
        candidates = _instances(effect, views)
        possible = []
        for instances, traces in candidates:
            lack = [why for trace in traces if (why := effect.missing(trace)) is not None]
            if lack:
                missing.append((effect.id, *lack[0]))
            else:
                possible.append(instances)
        sets: list[tuple[int, ...]] = [p for p in possible if len(p) == 1]
        if (common := _common_instances(possible)) is not None:
            sets = [common] if Trait.OUTSIDE in effect.traits else [*sets, common]
        times = _REPEATS if effect.repeatable else 1
        at_fault, certain = _faulty_instances(effect, worse or {}), _is_certain(effect, worse or {})
        for instances in sets:
            if certain and len(instances) == 1 and instances != at_fault:
                continue
            handicap, loud = _handicap(effect, instances, at_fault), _is_loud(effect, instances, at_fault)
            tested += [Hypothesis(effect, instances, again, handicap, loud) for again in range(times)]
    return tuple(tested), tuple(dict.fromkeys(missing))


def _faulty_instances(effect: CatalogueEffect, worse: Mapping[Sensor, FaultyInstances]) -> tuple[int, ...] | None:
    """The instances with the kind of error that an effect describes; None if undecided."""
    faulty = worse.get(effect.sensor)
    if effect.shared or faulty is None:
        return None
    noise = isinstance(effect, NoiseEffect)
    if effect.tonal or (noise and not effect.drifts):
        return faulty.fast
    return faulty.fast if noise and faulty.slow is None else faulty.slow


def _is_certain(effect: CatalogueEffect, worse: Mapping[Sensor, FaultyInstances]) -> bool:
    """Whether an effect on the mean belongs to the faulty instances whatever the likelihood says."""
    faulty = worse.get(effect.sensor)
    if faulty is None or faulty.slow is None or effect.shared or isinstance(effect, NoiseEffect):
        return False
    return faulty.certain and not effect.tonal


def _handicap(effect: CatalogueEffect, instances: tuple[int, ...], at_fault: tuple[int, ...] | None) -> float:
    """Price of an effect on other instances than the faulty ones.

    Noise of both instances adds up in a difference like that of one; a common change of the mean cancels in it.
    """
    noise = isinstance(effect, NoiseEffect)
    if at_fault is None or instances == at_fault or not (noise or len(instances) == len(at_fault)):
        return 0.0
    return _OTHER_INSTANCE_PRICE


def _is_loud(effect: CatalogueEffect, instances: tuple[int, ...], at_fault: tuple[int, ...] | None) -> bool | None:
    """Whether the instances have such noise; None if their residuals tell.

    A re-estimated trajectory turns with its own gyroscope, whose noise does not show against it.
    """
    if at_fault is None or effect.sensor is not Sensor.GYRO or Trait.BROADBAND not in effect.traits:
        return None
    return instances == at_fault


def _instances(effect: CatalogueEffect, views: Sequence[View]) -> list[tuple[tuple[int, ...], list[Trace]]]:
    """Smallest sets of instances of the effect, with the traces that it changes."""
    if effect.shared:
        traces = [trace for view in views for trace in view.traces.values()]
        everywhere = tuple(sorted({i for view in views for i in view.weights}))
        return [(everywhere, traces)] if traces else []
    own = [view for view in views if view.sensor is effect.sensor]
    found: dict[tuple[int, ...], list[Trace]] = {}
    for view in own:
        for instance, trace in view.traces.items():
            common = trace.against is None and len(trace.instances) > 1
            found.setdefault(trace.instances if common else (instance,), []).append(trace)
    return list(found.items())


def _common_instances(possible: Sequence[tuple[int, ...]]) -> tuple[int, ...] | None:
    everything = tuple(sorted({i for p in possible for i in p}))
    if len(everything) < 2:
        return None
    return everything


@dataclass(frozen=True, eq=False)
class Binning:
    """Transform of a series into bins; a long series is first averaged over `factor` consecutive samples."""

    factor: int
    n: int
    first: int = 0

    def bins(self, series: Array) -> Array:
        """Transform of `series` (..., n), decimated."""
        whole = self.size * self.factor
        if whole < series.shape[-1]:
            series = series[..., :whole]
        if self.factor > 1:
            series = series.reshape(*series.shape[:-1], -1, self.factor).mean(axis=-1)
        return transform(series)[..., self.first :]

    @property
    def size(self) -> int:
        """Number of bins: a length whose transform is fast."""
        return fast_length(self.n // self.factor)

    def power(self, S: Array) -> Array:
        """Power of the averages, aliases included, from the power (n,) of the samples."""
        m = self.size - self.first
        if self.factor == 1:
            return S if m == len(S) else _interpolated(S, m)
        whole = m * self.factor
        full = S if whole == len(S) else _interpolated(S, whole)
        half = 0.5 * np.pi * np.arange(whole) / whole
        gain = np.ones(whole)
        gain[1:] = (np.sin(self.factor * half[1:]) / (self.factor * np.sin(half[1:]))) ** 2
        shaped = full * gain
        total = shaped[:m].copy()
        for fold in range(1, self.factor):
            piece = shaped[fold * m : (fold + 1) * m]
            total += piece[::-1] if fold % 2 else piece
        return np.asarray(total / self.factor)


def _interpolated(values: Array, m: int) -> Array:
    """Values (n,) interpolated at `m` places from the first to the last."""
    left, part = _places(len(values), m)
    return values[left] + part * (values[left + 1] - values[left])


@lru_cache(maxsize=32)
def _places(n: int, m: int) -> tuple[NDArray[np.intp], Array]:
    """The sample before each of `m` places on a series of `n`, and how far the place lies beyond it."""
    at = np.linspace(0.0, n - 1.0, m)
    left = np.minimum(at.astype(np.intp), n - 2)
    return left, at - left


def columns_of(
    hypothesis: Hypothesis, theta: float, views: Sequence[View], frames: Sequence[Binning]
) -> HypothesisColumns:
    """Transformed columns of a hypothesis on the mean."""
    effect = hypothesis.effect
    assert isinstance(effect, MeanEffect)
    parts: dict[int, Part] = {}
    p = 0
    for v, view in enumerate(views):
        if not hypothesis.touches(view):
            continue
        if effect.signals is None:
            block = columns_in(effect.columns, hypothesis, theta, view)
            p = len(block)
            add_block(parts, v, block, frames[v])
            continue
        signals = columns_in(effect.signals, hypothesis, theta, view)
        p = 3 * len(signals)
        X = frames[v].bins(signals)
        for c in range(3):
            parts[3 * v + c] = Part(3 * np.arange(len(X), dtype=np.intp) + c, X)
    return HypothesisColumns(p, parts, units_of(effect, p))


def units_of(effect: CatalogueEffect, p: int) -> NDArray[np.intp]:
    """Number of the unit of each of an effect's `p` amplitudes, (p,)."""
    names = [parameter.unit for parameter in effect.parameters]
    return np.array([names.index(name) for name in names] if len(names) == p else [0] * p, np.intp)


def columns_in(columns: Callable[[Trace, float], Array], hypothesis: Hypothesis, theta: float, view: View) -> Array:
    """Columns (p, n, 3) or signals (p, n) of a hypothesis in `view`, summed over its instances with their weights."""
    total: Array | None = None
    whole = bool(view.keep.all())
    for instance, weight in view.weights.items():
        if instance in hypothesis.instances:
            if view.fine is not None and hypothesis.fast:
                row = _at_lower_rate(columns, view.fine.traces[instance], theta, len(view.keep))
            else:
                row = _over_trace(columns, view.traces[instance], theta)
            row = row if whole else np.compress(view.keep, row, axis=1)
            row = row if weight == 1.0 else weight * row
            total = row if total is None else total + row
    assert total is not None
    return total


@remembered(8)
def _over_trace(columns: Callable[[Trace, float], Array], trace: Trace, theta: float) -> Array:
    """Columns or signals of a whole trace, kept for the views of several blocks that ask for them."""
    return columns(trace, theta)


@remembered(8)
def _at_lower_rate(columns: Callable[[Trace, float], Array], trace: Trace, theta: float, m: int) -> Array:
    """The same at a lower rate, of `m` samples."""
    return resampled(_over_trace(columns, trace, theta), m)


def add_block(parts: dict[int, Part], v: int, block: Array, frame: Binning) -> None:
    """Add the columns (p, n, 3) of series `v` to `parts`, without those that are zero."""
    for c in range(3):
        axis = block[:, :, c]
        used = np.flatnonzero(axis.any(axis=1))
        if len(used):
            parts[3 * v + c] = Part(used, frame.bins(np.ascontiguousarray(axis[used])))
