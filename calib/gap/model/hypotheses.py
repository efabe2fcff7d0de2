"""What competes: an effect of the catalogue on one instance, or with one set of parameters on all of them."""

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
"""Price of an effect on another instance than the one that has something: it decides where nothing else does, and no
more. Chosen, not measured: odds of exp(12) against the other instance."""
_WAVE = "~wave"
"""Form of an effect that follows the angle of a rotor."""


Key = tuple[str, tuple[int, ...]]
"""What tells hypotheses apart: the effect, in its form and number, and its instances."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An effect on `instances` of its sensor (of every sensor for effects that all share).

    `again` counts the times that it is already there, for effects that can happen more than once. `handicap` is its
    price, in twice the log-likelihood, where it is rather another instance that has something; `loud` whether its
    instances are the ones that have such noise, None where only their own residuals say.
    """

    effect: CatalogueEffect
    instances: tuple[int, ...]
    again: int = 0
    handicap: float = 0.0
    loud: bool | None = None

    @property
    def key(self) -> tuple[str, tuple[int, ...]]:
        """What tells hypotheses apart."""
        return self.effect.id + self.effect.form + _REPETITION_MARK * self.again, self.instances

    @property
    def before(self) -> tuple[str, tuple[int, ...]] | None:
        """Key of the one that must be there first, None for the first."""
        name = self.effect.id + self.effect.form
        return (name + _REPETITION_MARK * (self.again - 1), self.instances) if self.again else None

    def touches(self, view: View) -> bool:
        """Whether it would change this series."""
        own = self.effect.shared or view.sensor is self.effect.sensor
        slow = isinstance(self.effect, MeanEffect) and not self.fast
        return own and not (slow and view.first) and any(i in view.weights for i in self.instances)

    @property
    def fast(self) -> bool:
        """Whether it changes a mean at any frequency: it is made at the sensor's own rate."""
        return self.periodic or (self.effect.jumps and not self.effect.form)

    @property
    def periodic(self) -> bool:
        """Whether it is a wave: noise that wanders cannot take its place."""
        return self.effect.tonal or self.effect.form == _WAVE

    def is_covered_by(self, others: Iterable[Hypothesis]) -> bool:
        """Whether one of `others` is the same effect on the same instances, in any form: it happens once."""
        places = [other.instances for other in others if other.effect.id == self.effect.id]
        return not self.effect.repeatable and self.instances in places


@dataclass(frozen=True, eq=False)
class Part:
    """Columns on one axis of one series: which of the hypothesis' columns are not zero there, transformed."""

    index: NDArray[np.intp]
    X: Array


@dataclass(frozen=True, eq=False)
class HypothesisColumns:
    """`p` columns over every axis of every series; axis ``3 v + c`` is axis c of series v.

    `groups` numbers the units of their amplitudes; None: they have one.
    """

    p: int
    parts: Mapping[int, Part] = field(default_factory=dict)
    groups: NDArray[np.intp] | None = None

    @property
    def units(self) -> NDArray[np.intp]:
        """Which columns have amplitudes of the same unit: the same number, (p,)."""
        return np.zeros(self.p, np.intp) if self.groups is None else self.groups


def hypotheses_of(
    effects: Iterable[CatalogueEffect], views: Sequence[View], worse: Mapping[Sensor, FaultyInstances] | None = None
) -> tuple[tuple[Hypothesis, ...], tuple[tuple[str, str, str], ...]]:
    """Everything that can be tested, and (id, reason, need) of what cannot.

    `worse`: by sensor with two instances, on which of them an effect rather is.
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
    """Which instances have what an effect describes; None: nothing says."""
    faulty = worse.get(effect.sensor)
    if effect.shared or faulty is None:
        return None
    noise = isinstance(effect, NoiseEffect)
    if effect.tonal or (noise and not effect.drifts):
        return faulty.fast
    return faulty.fast if noise and faulty.slow is None else faulty.slow


def _is_certain(effect: CatalogueEffect, worse: Mapping[Sensor, FaultyInstances]) -> bool:
    """Whether an effect that shifts the mean is on the instances at fault, whatever fits better."""
    faulty = worse.get(effect.sensor)
    if faulty is None or faulty.slow is None or effect.shared or isinstance(effect, NoiseEffect):
        return False
    return faulty.certain and not effect.tonal


def _handicap(effect: CatalogueEffect, instances: tuple[int, ...], at_fault: tuple[int, ...] | None) -> float:
    """Noise of both adds up in a difference as that of one does; what both add to the mean is not in it at all."""
    noise = isinstance(effect, NoiseEffect)
    if at_fault is None or instances == at_fault or not (noise or len(instances) == len(at_fault)):
        return 0.0
    return _OTHER_INSTANCE_PRICE


def _is_loud(effect: CatalogueEffect, instances: tuple[int, ...], at_fault: tuple[int, ...] | None) -> bool | None:
    """A trajectory that is re-estimated turns with its own gyroscope, which shows none of its noise against it."""
    if at_fault is None or effect.sensor is not Sensor.GYRO or Trait.BROADBAND not in effect.traits:
        return None
    return instances == at_fault


def _instances(effect: CatalogueEffect, views: Sequence[View]) -> list[tuple[tuple[int, ...], list[Trace]]]:
    """Smallest sets of instances on which the effect can sit, with the traces that it would change."""
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
    """From samples to bins: long series are first averaged over `factor` consecutive samples."""

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
        """Bins: a length that transforms fast; the last few samples are left to the noise."""
        return fast_length(self.n // self.factor)

    def power(self, S: Array) -> Array:
        """Power of the averages, folded, from the power (n,) of the samples."""
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
    """Values (n,) drawn at `m` places from the first to the last."""
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
    """Which of an effect's `p` amplitudes have the same unit: the same number, (p,)."""
    names = [parameter.unit for parameter in effect.parameters]
    return np.array([names.index(name) for name in names] if len(names) == p else [0] * p, np.intp)


def columns_in(columns: Callable[[Trace, float], Array], hypothesis: Hypothesis, theta: float, view: View) -> Array:
    """Columns (p, n, 3) or signals (p, n) of a hypothesis in `view`: over its instances, with their weights."""
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
    """Put columns (p, n, 3) of series `v` into `parts`, leaving out what is zero."""
    for c in range(3):
        axis = block[:, :, c]
        used = np.flatnonzero(axis.any(axis=1))
        if len(used):
            parts[3 * v + c] = Part(used, frame.bins(np.ascontiguousarray(axis[used])))
