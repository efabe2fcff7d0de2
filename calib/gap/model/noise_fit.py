"""The noise of every axis: declared or learned noise and the densities of effects, fitted to the periodogram.

An axis of a sensor is fitted over all its series, since an effect on several instances has one amplitude. Noise learned
from a finite recording is uncertain: its scale is a parameter, and that recording adds squared coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import NoiseEffect
from mavcal.calib.gap.likelihood import AxisNoise, deviance, fit_amplitudes, flicker, random_walk
from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Setting, starting_model, with_noise
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_LEAST_GAIN = 1.0
"""Twice the log-likelihood, to second order, below which a density is not fitted. Source: what a number without meaning
gains on average (chi-square of one degree)."""
_LEAST_RELATIVE_NOISE = 1e-9
"""Least noise of a sample, relative to its reading. Chosen, not measured: a converter of 24 bits has 6e-8."""
_NUISANCE: dict[str, Callable[[Array], Array]] = {"white": np.ones_like, "walk": random_walk, "flicker": flicker}
"""Components of undeclared noise."""


def is_declared(view: View) -> bool:
    """Whether the noise of a series is declared or learned."""
    return view.density is not None or view.variance is not None


def declared(view: View) -> Array | None:
    """Declared or learned power (n, 3), None without any."""
    if view.density is not None:
        return view.density
    return None if view.variance is None else np.broadcast_to(view.variance, (view.count, 3)).copy()


def axes_with_learned_noise(setting: Setting, axes: Sequence[int]) -> set[int]:
    """The axes on which the recording of the learned noise counts: once for all blocks and bands of a series."""
    first: dict[str, int] = {}
    for a in axes:
        view = setting.views[a // 3]
        if np.isfinite(view.dof) and is_declared(view) and not view.first:
            first.setdefault(view.label, a)
    return set(first.values())


def starting_noise(setting: Setting) -> tuple[AxisNoise, ...]:
    """Noise of every axis before any effect: declared, or initial white, walk and flicker noise."""
    noise = []
    for view in setting.views:
        base = declared(view)
        for c in range(3):
            if base is not None:
                scale = {f"scale{view.label}.{c}": base[:, c]} if np.isfinite(view.dof) else {}
                fixed = np.zeros(view.count) if scale else base[:, c]
                noise.append(AxisNoise(fixed, scale, dict.fromkeys(scale, 1.0)))
                continue
            omega = view.omega
            level = max(float(np.diff(view.residual[:, c]).var()) / (2.0 * view.gain), 1e-30)
            least = max(_LEAST_RELATIVE_NOISE * view.any_trace.largest, 1e-15) ** 2
            parts = {
                f"{kind}{view.label}.{c}": view.gain * np.asarray(shape(omega)) for kind, shape in _NUISANCE.items()
            }
            start = {name: level if name.startswith("white") else 1e-9 * level for name in parts}
            noise.append(AxisNoise(np.full(view.count, least), parts, start))
    return tuple(noise)


def model_without_effects(setting: Setting) -> Model:
    """A model without effects, whose noise is not fitted yet."""
    return starting_model(setting, starting_noise(setting))


@dataclass(frozen=True, eq=False)
class AxisFit:
    """Data for the noise fit of one axis of a sensor over its series, in merged bins."""

    axes: tuple[int, ...]
    counts: Array
    periodogram: Array
    base: Array
    names: tuple[str, ...]
    densities: Array
    start: Array

    def may_gain(self, extra: Sequence[Array]) -> bool:
        """Whether one of the densities `extra` would gain noticeably, to second order."""
        power = self.base + (self.start @ self.densities if len(self.names) else 0.0)
        excess, information = self.periodogram / power - self.counts, self.counts / power
        for row in extra:
            score = 0.5 * float((row / power) @ excess)
            if score > 0.0 and score**2 > _LEAST_GAIN * 0.5 * float((row**2 / power) @ information):
                return True
        return False

    def information_of(self, extra: Sequence[Array]) -> Array:
        """Information (p,) of the amplitudes of densities `extra` at zero."""
        power = self.base + (self.start @ self.densities if len(self.names) else 0.0)
        return np.array([0.5 * float(self.counts @ (row / power) ** 2) for row in extra])

    def fitted(self, extra: Sequence[Array] = ()) -> tuple[Array, float, Array]:
        """Amplitudes, ``-2 log L`` and information, with densities `extra` beside its own."""
        rows = [*self.densities, *extra]
        if not rows:
            return np.zeros(0), deviance(self.base, self.periodogram, self.counts), np.zeros((0, 0))
        if not extra:
            found = fit_amplitudes(self.periodogram, self.counts, self.base, rows, self.start)
            return found.amplitudes, found.deviance, found.information
        warm = np.append(self.start, np.zeros(len(extra)))
        found = fit_amplitudes(self.periodogram, self.counts, self.base, rows, warm)
        if self.may_gain(extra):
            cold = fit_amplitudes(self.periodogram, self.counts, self.base, rows)
            found = min(found, cold, key=lambda fit: fit.deviance)
        return found.amplitudes, found.deviance, found.information


def axis_fit(model: Model, axes: Sequence[int]) -> AxisFit:
    """The noise fit of one axis of a sensor over all its series."""
    setting = model.setting
    names = tuple(dict.fromkeys(name for a in axes for name in model.noise[a].densities))
    counts, power, base = [], [], []
    rows: dict[str, list[Array]] = {name: [] for name in names}
    learned = axes_with_learned_noise(setting, axes)
    for a in axes:
        bins, noise, view = setting.bins[a // 3], model.noise[a], setting.views[a // 3]
        pseudo = a in learned
        tail = np.ones(1) if pseudo else np.zeros(0)
        counts.append(np.append(bins.counts, tail * view.dof if pseudo else tail))
        power.append(np.append(model.periodogram(a), tail * view.dof if pseudo else tail))
        base.append(np.append(bins.mean(noise.base), 0.0 * tail))
        for name in names:
            density = bins.mean(noise.densities[name]) if name in noise.densities else np.zeros(len(bins.counts))
            rows[name].append(np.append(density, tail * (name == f"scale{view.label}.{a % 3}")))
    known = {name: value for a in axes for name, value in model.noise[a].amplitudes.items()}
    start = np.array([known[name] for name in names])
    return AxisFit(
        tuple(axes),
        np.concatenate(counts),
        np.concatenate(power),
        np.concatenate(base),
        names,
        np.array([np.concatenate(rows[n]) for n in names]).reshape(len(names), sum(map(len, base))),
        start,
    )


def noise_rows(model: Model, axis: int, leave: str) -> tuple[Array, Array, Array, list[Array]]:
    """Counts, periodogram, base and densities of one axis in merged bins, without the density `leave`."""
    bins, noise = model.setting.bins[axis // 3], model.noise[axis]
    rows = [bins.mean(density) for name, density in noise.densities.items() if name != leave]
    return bins.counts, model.periodogram(axis), bins.mean(noise.base), rows


def axes_of(setting: Setting, sensor: Sensor, c: int) -> tuple[int, ...]:
    """Axis c of every series of `sensor`."""
    return tuple(3 * v + c for v, view in enumerate(setting.views) if view.sensor is sensor)


def densities_of(hypothesis: Hypothesis, view: View, theta: float) -> Array:
    """Densities (p, n) of a noise effect in a series, over its instances with squared weights."""
    effect = hypothesis.effect
    assert isinstance(effect, NoiseEffect)
    own = {i: w for i, w in view.weights.items() if i in hypothesis.instances}
    return np.asarray(np.add.reduce([w**2 * _density(effect, view, i, theta) for i, w in own.items()]))


@remembered(96)
def _density(effect: NoiseEffect, view: View, instance: int, theta: float) -> Array:
    return view.gain * effect.density(view.whole.traces[instance], view.omega, theta)


def extra_rows(model: Model, fit: AxisFit, by_view: Mapping[int, Array]) -> list[Array]:
    """Merged densities of a candidate in the layout of `fit`; `by_view` (p, n) by series, zero elsewhere."""
    p = len(next(iter(by_view.values())))
    pieces: list[Array] = []
    learned = axes_with_learned_noise(model.setting, fit.axes)
    for a in fit.axes:
        v = a // 3
        bins = model.setting.bins[v]
        tail = 1 if a in learned else 0
        block = bins.mean(by_view[v]) if v in by_view else np.zeros((p, len(bins.counts)))
        pieces.append(np.hstack([block, np.zeros((p, tail))]))
    return list(np.hstack(pieces))


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Amplitudes of a noise term by density and axis (p, 3), and standard errors."""

    values: Array
    se: Array


@dataclass(frozen=True, eq=False)
class FittedNoise:
    """A model with fitted noise, the deviance by sensor axis, and the estimates of its noise terms."""

    model: Model
    deviance: Mapping[tuple[Sensor, int], float]
    estimates: Mapping[tuple[str, tuple[int, ...]], NoiseEstimate] = field(default_factory=dict)


def noise_fitted(model: Model, sensors: Iterable[Sensor] | None = None) -> FittedNoise:
    """The noise fitted to the residual of the model, of `sensors` only if given."""
    setting = model.setting
    noise = list(model.noise)
    levels: dict[tuple[Sensor, int], float] = {}
    sd: dict[tuple[str, int], tuple[float, float]] = {}
    wanted = tuple(dict.fromkeys(view.sensor for view in setting.views)) if sensors is None else tuple(sensors)
    for sensor in wanted:
        for c in range(3):
            fit = axis_fit(model, axes_of(setting, sensor, c))
            amplitudes, levels[sensor, c], information = fit.fitted()
            if not fit.names:
                continue
            value = dict(zip(fit.names, map(float, amplitudes), strict=True))
            se = np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-12, hermitian=True)))
            sd |= {(n, c): (value[n], float(s)) for n, s in zip(fit.names, se, strict=True)}
            for a in fit.axes:
                own = noise[a]
                noise[a] = replace(own, amplitudes={n: value[n] for n in own.densities})
    return FittedNoise(with_noise(model, tuple(noise)), levels, _estimates(model.noise_terms, sd))


def _estimates(
    terms: Sequence[NoiseTerm], sd: Mapping[tuple[str, int], tuple[float, float]]
) -> dict[tuple[str, tuple[int, ...]], NoiseEstimate]:
    found = {}
    for term in terms:
        p = len(term.hypothesis.effect.parameters) // 3
        pairs = np.array([[sd.get((term.name(j), c), (0.0, 0.0)) for c in range(3)] for j in range(p)])
        found[term.hypothesis.key] = NoiseEstimate(pairs[:, :, 0], pairs[:, :, 1])
    return found


def with_term(model: Model, term: NoiseTerm) -> Model:
    """The model with a noise effect of amplitude zero."""
    noise = list(model.noise)
    for v, view in enumerate(model.setting.views):
        if not term.hypothesis.touches(view):
            continue
        densities = densities_of(term.hypothesis, view, term.theta)
        for c in range(3):
            own = noise[3 * v + c]
            new = {term.name(j): density for j, density in enumerate(densities)}
            noise[3 * v + c] = AxisNoise(
                own.base, {**own.densities, **new}, {**own.amplitudes, **dict.fromkeys(new, 0.0)}
            )
    return replace(model, noise_terms=(*model.noise_terms, term), noise=tuple(noise))


def without_term(model: Model, term: NoiseTerm) -> Model:
    """The model without a noise effect."""
    p = len(term.hypothesis.effect.parameters) // 3
    names = {term.name(j) for j in range(p)}
    noise = tuple(
        AxisNoise(
            n.base,
            {k: d for k, d in n.densities.items() if k not in names},
            {k: a for k, a in n.amplitudes.items() if k not in names},
        )
        for n in model.noise
    )
    left = tuple(t for t in model.noise_terms if t is not term)
    return with_noise(replace(model, noise_terms=left), noise)
