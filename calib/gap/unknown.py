"""What no effect of the catalogue explains, as competitors that pay for their freedom.

Shapes: a broken line over each covariate, products of signals, jumps. They stand in the same contest as the catalogue
and pay ``df log N``; the catalogue is tried first and alone, and a shape wins only if the best model with shapes is
better than the best without. Impostors: noise that is no sensor's own, because the axes drift together or because it
comes back (Gauss-Markov) where a random walk would not. What is left over is tested band by band.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from calib.gap.contest import Beside, Contest, Gain, Score, existing, priced
from calib.gap.effects.base import MeanEffect, Parameter
from calib.gap.evidence import DRIFT, evidence
from calib.gap.hypotheses import Hypothesis
from calib.gap.likelihood import fit_amplitudes, random_walk
from calib.gap.model import Model, NoiseTerm, Setting
from calib.gap.noise_fit import noise_rows
from calib.gap.problem import Trace
from calib.gap.schema import HiddenDriver
from calib.gap.selection import MATERIAL, Chosen, largest_gain, objective, select
from calib.gap.views import View
from calib.recording import Sensor

Array = NDArray[np.float64]

PREFIX = "unknown"
_KNOTS = 6
_KNOTS_TIME = 20
_MARGIN = 6.0
"""Penalised evidence by which a model with shapes must beat the catalogue alone."""
_SHORTLIST = 6
_TIES = 1e-3


def is_shape(hypothesis: Hypothesis) -> bool:
    """Whether it stands for the unknown."""
    return hypothesis.effect.id.startswith(PREFIX)


def describe(hypothesis: Hypothesis) -> str:
    """The shape in words: ``function of a_x on accel.x``."""
    return hypothesis.effect.excited_by


def shapes_of(setting: Setting) -> tuple[Hypothesis, ...]:
    """Every shape that can be drawn, of every sensor and instance."""
    found = []
    for view in setting.views:
        for instance, trace in view.traces.items() if not view.first else ():
            if instance in view.weights:
                found += [Hypothesis(effect, (instance,)) for effect in _effects(trace)]
    unique = {h.key: h for h in found}
    return tuple(unique.values())


def _effects(trace: Trace) -> Iterator[MeanEffect]:
    for name, values, knots in _covariates(trace):
        basis = _hats(values, trace.observed, knots)
        if basis is not None:
            yield from _on_axes(trace.sensor, f"function of {name}", basis)
    for name, products in _products(trace):
        yield _effect(trace.sensor, f"{name} on {trace.sensor.value}", products, None)


def _on_axes(sensor: Sensor, name: str, basis: Callable[[Trace], Array]) -> Iterator[MeanEffect]:
    yield _effect(sensor, f"{name} on {sensor.value}", basis, None)
    for c in range(3):
        yield _effect(sensor, f"{name} on {sensor.value}.{'xyz'[c]}", basis, c)


def _effect(sensor: Sensor, text: str, basis: Callable[[Trace], Array], axis: int | None) -> MeanEffect:
    def signals(trace: Trace, _theta: float) -> Array:
        return basis(trace)

    def columns(trace: Trace, _theta: float) -> Array:
        made = basis(trace)
        placed = np.zeros((*made.shape, 3))
        placed[:, :, axis or 0] = made
        return placed

    return MeanEffect(
        f"{PREFIX}:{text}",
        sensor,
        (Parameter("amplitude", ""),),
        text,
        "a recording in which the covariate varies by itself",
        columns=columns,
        signals=signals if axis is None else None,
    )


def _covariates(trace: Trace) -> Iterator[tuple[str, Array, int]]:
    for letter, vector in (("a", trace.force), ("w", trace.rate), ("dw", trace.spin), ("m", trace.field)):
        if vector is not None:
            yield from ((f"{letter}_{'xyz'[c]}", vector[:, c], _KNOTS) for c in range(3))
    for name, vector in (("|a|", trace.force), ("|w|", trace.rate)):
        if vector is not None:
            yield name, np.linalg.norm(vector, axis=1), _KNOTS
    yield "time", trace.t, _KNOTS_TIME
    for name, scalar in (("temperature", trace.temperature), ("current", trace.current), ("throttle", trace.throttle)):
        if scalar is not None:
            yield name, scalar, _KNOTS
    if trace.rotor_hz is not None:
        yield "rotor speed", trace.rotor_hz.mean(axis=1), _KNOTS
    if trace.temperature is not None:
        yield "the slope of temperature", np.gradient(trace.temperature, trace.t), _KNOTS


def _hats(values: Array, observed: NDArray[np.bool_], knots: int) -> Callable[[Trace], Array] | None:
    """Hat functions over quantiles of a covariate; None where it hardly varies."""
    seen = values[observed]
    if len(seen) < 4 * knots or float(np.ptp(seen)) <= 1e-9 * (abs(float(seen.mean())) + 1e-12):
        return None
    at = np.unique(np.quantile(seen, np.linspace(0.0, 1.0, knots)))
    keep = np.concatenate([[True], np.diff(at) > _TIES * np.ptp(at)])
    at = at[keep]
    if len(at) < 3:
        return None
    clipped = np.clip(values, at[0], at[-1])

    def basis(_trace: Trace) -> Array:
        return np.array([np.interp(clipped, at, unit) for unit in np.eye(len(at))])

    return basis


def _products(trace: Trace) -> Iterator[tuple[str, Callable[[Trace], Array]]]:
    pairs = (
        ("products of a and a", trace.force, trace.force),
        ("products of w and w", trace.rate, trace.rate),
        ("products of a and w", trace.force, trace.rate),
        ("current times field", _column(trace.current), trace.field),
        ("current times a", _column(trace.current), trace.force),
        ("temperature times a", _column(trace.temperature), trace.force),
        ("temperature times w", _column(trace.temperature), trace.rate),
    )
    for name, one, other in pairs:
        if one is not None and other is not None:
            yield name, _product(one, other)


def _column(scalar: Array | None) -> Array | None:
    return None if scalar is None else (scalar - scalar.mean())[:, None]


def _product(one: Array, other: Array) -> Callable[[Trace], Array]:
    same = one is other

    def basis(_trace: Trace) -> Array:
        rows = [one[:, i] * other[:, j] for i in range(one.shape[1]) for j in range(i if same else 0, other.shape[1])]
        return np.array(rows)

    return basis


@dataclass(frozen=True, eq=False)
class WithShapes:
    """The better of the two models, the contest it came from, and the number of all tests."""

    chosen: Chosen
    contest: Contest


def explained(chosen: Chosen, contest: Contest, start: Model, alpha: float) -> WithShapes:
    """The catalogue's model, or a better one with shapes.

    Shapes are tried beside the catalogue's model and beside none; those that are significant join the contest, which
    begins anew.
    """
    shapes = shapes_of(chosen.model.setting)
    scorer = Contest(shapes, budget=0)
    tests = chosen.tests + len(shapes)
    scores = _scored(scorer, Beside(chosen.model))
    least = 0.0 if chosen.model.noise_terms else MATERIAL * largest_gain(chosen)
    strong = [s for s in scores if s.p * tests < alpha and s.delta > _MARGIN and s.gain >= least]
    if not strong:
        return WithShapes(chosen, contest)
    if chosen.model.members:
        strong = [*_best(strong), *_best(_scored(scorer, Beside(start)))]
    shortlist = {s.hypothesis.key: s.hypothesis for s in _best(strong)}
    both = Contest((*contest.hypotheses, *shortlist.values()))
    level = alpha * sum(not h.again for h in both.hypotheses) / tests
    other = select(start, both, level)
    if objective(other) < objective(chosen) - _MARGIN:
        return WithShapes(other, both)
    return WithShapes(chosen, contest)


def _best(scores: Sequence[Score]) -> list[Score]:
    return sorted(scores, key=lambda s: -s.delta)[: 2 * _SHORTLIST]


def _scored(contest: Contest, beside: Beside) -> list[Score]:
    """Scores of all shapes; those of single axes are parts of the one of all axes, whose columns are made once."""
    singles = {h.key: h for h in contest.hypotheses}
    found = []
    for hypothesis in contest.hypotheses:
        assert isinstance(hypothesis.effect, MeanEffect)
        if hypothesis.effect.signals is None:
            continue
        columns = contest.columns(hypothesis, math.nan, beside.model)
        gram, right, energy = beside.projected(columns)
        for key, rows in _parts(hypothesis, columns.p):
            basis = existing(gram[np.ix_(rows, rows)], energy[rows])
            gain = basis.T @ right[rows]
            own = singles.get(key)
            if own is not None:
                worth = evidence(gram[np.ix_(rows, rows)], right[rows], np.zeros(len(rows), np.intp)) - _extra(own)
                found.append(priced(own, math.nan, Gain(float(gain @ gain), basis.shape[1], basis @ gain, worth), 1))
    return found


def _extra(hypothesis: Hypothesis) -> float:
    """What the unknown costs beside its amplitudes: more than drifting noise where it is drift itself."""
    return 2.0 * DRIFT if "function of time" in hypothesis.effect.id else DRIFT


def _parts(hypothesis: Hypothesis, p: int) -> Iterator[tuple[tuple[str, tuple[int, ...]], NDArray[np.intp]]]:
    """Keys of a shape and of its parts on single axes, and the columns that they have of it."""
    effect_id, instances = hypothesis.key
    yield hypothesis.key, np.arange(p)
    for c in range(3):
        yield (f"{effect_id}.{'xyz'[c]}", instances), np.arange(c, p, 3)


_DRIVEN = 1e-4
_LEAST = 8
_RETURNS = 24.0
"""Twice the log-likelihood by which noise that comes back must beat a walk: one in a million, and the search."""
_POLES = np.geomspace(3e-5, 0.3, 10)


@dataclass(frozen=True, eq=False)
class Impostor:
    """A noise effect that is something else."""

    key: tuple[str, tuple[int, ...]]
    text: str
    driver: HiddenDriver | None


def impostors(model: Model) -> tuple[Impostor, ...]:
    """Random walks and flicker of the model that are not a sensor's own noise."""
    found = []
    for term in model.noise_terms:
        if not term.hypothesis.effect.id.endswith(("_random_walk", "_flicker")):
            continue
        sensor = term.hypothesis.effect.sensor
        for v, view in enumerate(model.setting.views):
            if view.first or not term.hypothesis.touches(view):
                continue
            driver = coherent(model, v, term)
            if driver is not None:
                text = (
                    f"hidden scalar driver along [{', '.join(f'{d:.2f}' for d in driver.direction)}] on {sensor.value}"
                )
                found.append(Impostor(term.hypothesis.key, text, driver))
                break
            if returning(model, v, term):
                text = f"drift that comes back (Gauss-Markov) on {sensor.value}"
                found.append(Impostor(term.hypothesis.key, text, None))
                break
    return tuple(found)


def coherent(model: Model, v: int, term: NoiseTerm) -> HiddenDriver | None:
    """Whether the axes' drifts are correlated (Bartlett): then something drives them together."""
    view = model.setting.views[v]
    y, own = [], []
    for c in range(3):
        noise = model.noise[3 * v + c]
        part = sum(noise.amplitudes[name] * noise.densities[name] for name in noise.densities if name == term.name(0))
        y.append(view.spectra(model.residual[v])[c] / np.sqrt(noise.power))
        own.append(part / noise.power)
    bins = np.flatnonzero(np.max(own, axis=0) > 0.5)
    if len(bins) < _LEAST:
        return None
    low = np.array(y)[:, bins]
    norm = np.sqrt((low**2).sum(axis=1))
    correlation = (low @ low.T) / np.outer(norm, norm)
    statistic = -(len(bins) - 1.0 - 11.0 / 6.0) * math.log(max(float(np.linalg.det(correlation)), 1e-300))
    p = float(chdtrc(3, statistic))
    if p > _DRIVEN:
        return None
    scale = np.array([math.sqrt(float(model.noise[3 * v + c].power[bins].mean())) for c in range(3)])
    leading = np.linalg.eigh((low * scale[:, None]) @ (low * scale[:, None]).T)[1][:, -1]
    leading = leading * np.sign(leading[np.argmax(np.abs(leading))])
    return HiddenDriver(p, (float(leading[0]), float(leading[1]), float(leading[2])), view.sensor)


def returning(model: Model, v: int, term: NoiseTerm) -> bool:
    """Whether noise with a corner, ``1 / (4 sin^2(w/2) + lambda)``, fits much better than the term's own."""
    view = model.setting.views[v]
    bins = model.setting.bins[v]
    steep = 1.0 / random_walk(view.omega)
    gain = 0.0
    for c in range(3):
        counts, power, base, rows = noise_rows(model, 3 * v + c, term.name(0))
        if term.name(0) not in model.noise[3 * v + c].densities:
            continue
        own = bins.mean(model.noise[3 * v + c].densities[term.name(0)])
        walk = fit_amplitudes(power, counts, base, [*rows, own]).deviance
        best = min(
            fit_amplitudes(power, counts, base, [*rows, view.gain * bins.mean(1.0 / (steep + pole**2))]).deviance
            for pole in _POLES
        )
        gain += max(walk - best, 0.0)
    return gain > _RETURNS


_LEFTOVER = 1e-7
_MATERIAL = 0.03
_GROUPS = 24


def leftover(model: Model, gap: float) -> tuple[float, str]:
    """Share of the gap (nats) that single bands still show above the noise, and where; 0 if none is significant."""
    worst, total, text = 1.0, 0.0, ""
    for a in range(model.setting.axes):
        view: View = model.setting.views[a // 3]
        c = a % 3
        if model.ridge is not None and a in model.ridge.columns.parts:
            continue  # the error of the reference is known only up to the last of its cosines
        ratio = view.spectra(model.residual[a // 3])[c] ** 2 / model.noise[a].power
        edges = np.unique(np.geomspace(4, view.count, _GROUPS + 1).astype(np.intp))
        for low, high in itertools.pairwise(edges):
            count = int(high - low)
            square = float(ratio[low:high].sum())
            p = float(chdtrc(count, square)) * _GROUPS * model.setting.axes
            if p < _LEFTOVER:
                total += 0.5 * (square - count - count * math.log(square / count))
                if p < worst:
                    hz = 0.5 * view.fs / view.n
                    worst = p
                    band = (low + view.first) * hz, (high + view.first) * hz
                    text = f"power from {band[0]:.3g} to {band[1]:.3g} Hz on {view.sensor.value}.{'xyz'[c]}"
    share = total / max(gap + total, 1e-300)
    return (share, text) if share > _MATERIAL else (0.0, "")
