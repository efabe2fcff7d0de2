"""Telegraph noise: readings that switch between two levels, known as popcorn or burst noise of electronics.

Its spectrum is that of a mean-reverting drift, and a few of its jumps look like a transient effect. Only two levels
occur: each axis is a Markov chain of two states, observed through white noise.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.likelihood import AxisNoise
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term, predicted
from mavcal.calib.gap.unknown.misattributed_noise import is_coarsely_quantised
from mavcal.calib.gap.worth.attribution import Attribution
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_WINDOWS = 700
"""Number of averages of a series: tenths of a second for a minute. Chosen, not measured: it bounds the time."""
_FEWEST = 64
"""Least number of samples in a series to separate levels. Chosen, not measured: some ten stays of a few samples on
either level."""
_BETTER = 19.0
"""Least gain of the chains over an effect, in twice the log-likelihood: three random walks in a hundred reach it.
Source: measured on random walks; the seeds are not recorded."""
_FLAT = 2.0
"""Largest ratio of powers, below half the rate of the averages, of white noise. Chosen, not measured: averages of a
correlated noise scatter by less."""
_JUMPS = 3.5
"""Expected number of jumps above which readings alternate. Chosen, not measured: between the two of one temporary step
and the four of two."""
_RARE, _OFTEN = 1e-4, 0.5
"""Limits of the probability of a jump from one average to the next. Chosen, not measured: one jump in 10 000 averages
is none, and one in two is white noise."""
_STARTS = (0.02, 0.2)
"""Initial jump probabilities, one for each fit. Chosen, not measured: slow and fast chains; a fit from one of them
finds either."""
_ROUNDS, _SETTLED = 30, 0.05
"""Rounds of a fit at most, and the log-likelihood that a further one must gain. Chosen, not measured: they bound the
time; a twentieth of a nat decides nothing."""


@dataclass(frozen=True, eq=False)
class TelegraphNoise:
    """Effects that two levels explain far better."""

    keys: tuple[Key, ...]
    text: str


def telegraph_noise(
    model: Model, attributions: Sequence[Attribution], floor: Mapping[Sensor, float] | None = None
) -> tuple[TelegraphNoise, ...]:
    """Effects of a model, one or all of a sensor together, that actually represent jumps between two levels.

    Jumps that gain less than the `floor` of their sensor are usual differences between two recordings.
    """
    found: list[TelegraphNoise] = []
    for sensor in dict.fromkeys(view.sensor for view in model.setting.views):
        places = [(term, a.key) for a in attributions if (term := _slow_term(model, a.key, sensor)) is not None]
        least = max(_BETTER, (floor or {}).get(sensor, 0.0))
        better: list[tuple[Key, ...]] = [(key,) for term, key in places if _levels_explain_better(model, [term], least)]
        if not better and len(places) > 1 and _levels_explain_better(model, [term for term, _ in places], least):
            better = [tuple(key for _, key in places)]
        text = f"jumps to and fro between two levels on {sensor.value}"
        found += (TelegraphNoise(keys, text) for keys in better)
    return tuple(found)


def _slow_term(model: Model, key: Key, sensor: Sensor) -> Term | NoiseTerm | None:
    """The term of a key if it acts on a sensor and is not broadband noise."""
    term = next((t for t in model.members if t.hypothesis.key == key), None)
    views = [view for view in model.setting.views if view.sensor is sensor]
    if term is None or not any(term.hypothesis.touches(view) for view in views):
        return None
    return term if isinstance(term, Term) or term.hypothesis.effect.drifts else None


def _levels_explain_better(model: Model, terms: Sequence[Term | NoiseTerm], least: float) -> bool:
    """Whether two levels on each axis are far likelier than `terms`, with the other terms unchanged.

    All series that the terms change count: levels in one of them cannot replace an effect that explains them all. A
    constant is not a jump, so the terms also get one on each axis, and the levels must gain at least `least` beyond it.
    """
    own, chains, switched, jumping = 0.0, 0.0, 0.0, False
    for v, view in enumerate(model.setting.views):
        if not any(term.hypothesis.touches(view) for term in terms):
            continue
        series = model.residual[v] + sum(
            predicted(t, view) for t in terms if isinstance(t, Term) and t.hypothesis.touches(view)
        )
        drifts = {t.name(0) for t in terms if isinstance(t, NoiseTerm)}
        rest = np.array([_remaining_power(noise, drifts) for noise in model.noise[3 * v : 3 * v + 3]])
        own += _gain_of_model(model, v, series, rest)
        if view.first or view.count < _FEWEST or model.wanders_in(v) or is_coarsely_quantised(view):
            continue
        gain, constant, jumps = _level_gains(series, rest)
        own += _gain_of_constant(model, v)
        jumping = jumping or bool(((jumps > _JUMPS) & (gain - constant > _BETTER)).any())
        switched += float((gain - constant).sum())
        chains += float(gain.sum())
    return jumping and switched > least and chains > own + _BETTER


def _gain_of_model(model: Model, v: int, series: Array, rest: Array) -> float:
    """Twice the log-likelihood of a model over a `series` (n, 3) with noise `rest` (3, n)."""
    view = model.setting.views[v]
    full = np.array([noise.power for noise in model.noise[3 * v : 3 * v + 3]])
    bare = np.log(rest) + view.spectra(series) ** 2 / rest
    return float((bare - np.log(full) - view.spectra(model.residual[v]) ** 2 / full).sum())


def _gain_of_constant(model: Model, v: int) -> float:
    """Twice the log-likelihood that a constant on each axis gains beside a model."""
    lowest = model.setting.views[v].spectra(model.residual[v])[:, 0]
    return float(sum(y**2 / noise.power[0] for y, noise in zip(lowest, model.noise[3 * v : 3 * v + 3], strict=True)))


def _level_gains(series: Array, rest: Array) -> tuple[Array, Array, Array]:
    """Gain of two levels of a series (n, 3), gain of a constant, and number of jumps, by axis.

    Zero if the noise of the averages is not white.
    """
    width = -(-len(series) // _WINDOWS)
    count = len(series) // width
    slow = rest[:, :count]
    if (slow.max(axis=1) > _FLAT * slow.min(axis=1)).any():
        return np.zeros(3), np.zeros(3), np.zeros(3)
    means = series[: count * width].reshape(count, width, 3).mean(axis=1)
    variance = slow.max(axis=1) / width  # no more than the spectrum grants the effects
    gain, jumps = two_levels(means, variance)
    return gain, count * means.mean(axis=0) ** 2 / variance, jumps


def _remaining_power(noise: AxisNoise, names: Collection[str]) -> Array:
    """Power of the noise without the densities `names`."""
    own = [name for name in names if name in noise.densities]
    return noise.power - sum((noise.amplitudes[name] * noise.densities[name] for name in own), 0.0)


def two_levels(x: Array, variance: Array) -> tuple[Array, Array]:
    """Twice the log-likelihood ratio of a Markov chain of two levels against zero, and its jumps, by column of `x` (n,
    p).

    `variance` (p,) is that of the white noise. Levels and transition probabilities are estimated (Baum & Welch; Rabiner
    1989, III).
    """
    middle, spread = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-300)
    best, jumps = np.full(x.shape[1], -np.inf), np.zeros(x.shape[1])
    for start in _STARTS:
        levels = np.stack([middle - spread, middle + spread], axis=1)
        jump = np.full((x.shape[1], 2), start)
        before = np.full(x.shape[1], -np.inf)
        for _ in range(_ROUNDS):
            log_likelihood, levels, jump, expected = _baum_welch_round(x, variance, levels, jump)
            if np.all(log_likelihood - before < _SETTLED):
                break
            before = log_likelihood
        jumps = np.where(2.0 * log_likelihood > best, expected, jumps)
        best = np.maximum(best, 2.0 * log_likelihood)
    return best, jumps


def _baum_welch_round(x: Array, variance: Array, levels: Array, jump: Array) -> tuple[Array, Array, Array, Array]:
    """One round of Baum and Welch: log-likelihood at `levels` and `jump` (p, 2), their next values, and the jumps."""
    exponent = 0.5 * (x[..., None] ** 2 - (x[..., None] - levels) ** 2) / variance[:, None]
    top = exponent.max(axis=2, keepdims=True)
    emission = np.exp(exponent - top)
    moves = np.stack([np.stack([1.0 - jump[:, 0], jump[:, 0]], -1), np.stack([jump[:, 1], 1.0 - jump[:, 1]], -1)], -2)
    steps = moves * emission[:, :, None, :]
    first = jump[:, ::-1] / jump.sum(axis=1, keepdims=True) * emission[0]
    opened = steps.copy()
    opened[0] = first[:, None, :] * np.array([[1.0], [0.0]])
    forward, scale = _cumulative_products(opened)
    alpha = forward[:, :, 0, :]
    log_likelihood = scale[-1] + np.log(alpha[-1].sum(axis=-1)) + top[:, :, 0].sum(axis=0)
    beta = np.ones_like(alpha)
    beta[:-1] = _cumulative_products(np.swapaxes(steps[:0:-1], 2, 3))[0][::-1].sum(axis=2)
    state = alpha * beta
    state /= state.sum(axis=-1, keepdims=True)
    pairs = alpha[:-1, :, :, None] * steps[1:] * beta[1:, :, None, :]
    pairs /= pairs.sum(axis=(2, 3), keepdims=True)
    levels = (state * x[..., None]).sum(axis=0) / np.maximum(state.sum(axis=0), 1e-9)
    stays = np.maximum(state[:-1].sum(axis=0), 1e-9)
    jumps = np.stack([pairs[:, :, 0, 1].sum(axis=0), pairs[:, :, 1, 0].sum(axis=0)], axis=1)
    return log_likelihood, levels, np.clip(jumps / stays, _RARE, _OFTEN), jumps.sum(axis=1)


def _cumulative_products(steps: Array) -> tuple[Array, Array]:
    """Cumulative products of matrices (n, p, 2, 2), scaled to largest entry one, and their log scales (n, p).

    By doubling (Hillis & Steele 1986): log2(n) steps over whole arrays instead of n over small ones.
    """
    products, scale, reach = steps, np.zeros(steps.shape[:2]), 1
    while reach < len(steps):
        longer = products[:-reach] @ products[reach:]
        size = longer.max(axis=(2, 3))
        scale = np.concatenate([scale[:reach], scale[:-reach] + scale[reach:] + np.log(size)])
        products = np.concatenate([products[:reach], longer / size[..., None, None]])
        reach *= 2
    return products, scale
