"""Contiguous blocks that are held out in turn: the rest is a problem of its own, on which everything is done again."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import (
    Model,
    NoiseTerm,
    Setting,
    Term,
    jacobian,
    normal_equations,
    setting_of,
    starting_model,
    with_residual,
)
from mavcal.calib.gap.model.noise_fit import starting_noise, with_term
from mavcal.calib.gap.model.views import View, between
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.selection import fitted_about, without
from mavcal.calib.gap.search.thresholds import GainThresholds

Array = NDArray[np.float64]

_UNSEEN = 1e-9
"""Part of an amplitude's information below which the other blocks do not show it. Source: rounding of an information
matrix, 1e-16, with a margin."""
_LEAST_BLOCKS = 3
"""Blocks with samples at least. Chosen, not measured: fewer say nothing of each other."""
GUARD_S = 0.5
"""Seconds cut off at either end of a block, so that noise with memory does not tell one block of the next. Source: GAP
3.4."""


@dataclass(frozen=True, eq=False)
class Fold:
    """One block and all the others, each with its noise before any effect."""

    train: Model
    test: Model


@remembered(2)
def folds_of(setting: Setting, count: int) -> tuple[Fold, ...]:
    """`count` folds of a setting; fewer where a block has no samples. The last ones asked for are kept."""
    edges, guard = _edges(setting, count)
    found = []
    for low, high in itertools.pairwise(edges):
        block = _part(setting, low + guard, high - guard)
        rest = [*_part(setting, -math.inf, low - guard), *_part(setting, high + guard, math.inf)]
        if block and rest:
            found.append(Fold(_start(rest), _start(block)))
    return tuple(found) if len(found) >= _LEAST_BLOCKS else ()


@remembered(1)
def blocks_of(setting: Setting, count: int) -> tuple[Model, ...]:
    """The blocks of those folds alone."""
    edges, guard = _edges(setting, count)
    parts = (_part(setting, low + guard, high - guard) for low, high in itertools.pairwise(edges))
    blocks = [part for part in parts if part]
    return tuple(_start(part) for part in blocks) if len(blocks) >= _LEAST_BLOCKS else ()


def _edges(setting: Setting, count: int) -> tuple[Array, float]:
    """Moments between which `count` blocks of equal length lie, s, and what is cut off at either end of each."""
    start = min(float(view.t[0]) for view in setting.views)
    end = max(float(view.t[-1]) for view in setting.views)
    return np.linspace(start, end, count + 1), min(GUARD_S, 0.1 * (end - start) / count)


def _part(setting: Setting, low: float, high: float) -> list[View]:
    return [part for view in setting.views if (part := between(view, low, high)) is not None]


def _start(views: Sequence[View]) -> Model:
    setting = setting_of(tuple(views))
    return starting_model(setting, starting_noise(setting))


def joined(model: Model, term: Term | NoiseTerm) -> Model:
    """The model with a term of another setting, fitted from where that is."""
    if isinstance(term, NoiseTerm):
        return fitted_about(with_term(model, term), term.hypothesis)
    return fitted_about(with_residual(replace(model, terms=(*model.terms, term))), term.hypothesis)


def foretold(term: Term | NoiseTerm, whole: Model, train: Setting) -> bool:
    """Whether the blocks of `train` can know of a term of the `whole` model.

    Beside a drift of the bias, only blocks in which a jump happens know of it; without a drift, their levels tell its
    size. Blocks without a sample between two jumps know the sum of both, and neither.
    """
    effect = term.hypothesis.effect
    if not isinstance(term, Term) or effect.shape is None or not effect.shape.still:
        return True
    seen = np.concatenate([view.t for view in train.views if term.hypothesis.touches(view)] or [np.zeros(0)])
    for other in whole.terms:
        if other is not term and other.effect.shape is effect.shape and other.effect.sensor is effect.sensor:
            first, last = sorted((term.theta, other.theta))
            if not ((seen > first) & (seen < last)).any():
                return False
    drifts = (t.hypothesis.effect for t in whole.noise_terms)
    if not any(e.drifts and e.sensor is effect.sensor for e in drifts):
        return True
    own = (view for view in train.views if term.hypothesis.touches(view))
    return any(view.t[0] < term.theta < view.t[-1] for view in own)


def parted(model: Model, hypothesis: Hypothesis) -> Model:
    """The model without the term of a hypothesis, what remains fitted again."""
    return fitted_about(without(model, hypothesis.key), hypothesis)


def carried(model: Model, test: Model) -> Model:
    """A model of the training blocks applied to the held-out one: the same effects, the same noise."""
    for noise_term in model.noise_terms:
        test = with_term(test, noise_term)
    # A density has the same name on every axis.
    known = {(name, a % 3): value for a, noise in enumerate(model.noise) for name, value in noise.amplitudes.items()}
    noise = tuple(
        replace(n, amplitudes={name: known.get((name, a % 3), value) for name, value in n.amplitudes.items()})
        for a, n in enumerate(test.noise)
    )
    return with_residual(replace(test, terms=model.terms, noise=noise))


def log_loss(model: Model) -> float:
    """Negative log-likelihood of a model's own data, in nats, without the constant."""
    total = 0.0
    for a in range(model.setting.axes):
        bins = model.setting.bins[a // 3]
        power = bins.mean(model.noise[a].power)
        total += 0.5 * float(bins.counts @ np.log(power) + (model.periodogram(a) / power).sum())
    return total


def power_ratio(model: Model) -> tuple[float, int]:
    """Mean square of the whitened residual, and how many numbers it is of."""
    total, count = 0.0, 0
    for a in range(model.setting.axes):
        bins = model.setting.bins[a // 3]
        total += float((model.periodogram(a) / bins.mean(model.noise[a].power)).sum())
        count += int(bins.counts.sum())
    return total / max(count, 1), count


def expected_gain(term: Term, train: Model, test: Model) -> float:
    """Nats by which a term of the mean should lower the loss of a held-out block, if it is what it says.

    Half the energy it has there beyond what the error of its estimate costs; far below zero where the other blocks do
    not show what this one does.
    """
    if not any(term.hypothesis.touches(view) for view in test.setting.views):
        return 0.0
    if not any(term.hypothesis.touches(view) for view in train.setting.views):
        return -math.inf
    weighted = with_weight(test)
    block = normal_equations([jacobian(term, test.setting)], weighted.y, weighted.weight)
    rest = normal_equations([jacobian(term, train.setting)], train.y, train.weight)
    whole = rest.gram + block.gram
    scale = np.sqrt(np.maximum(np.diag(whole), np.finfo(float).tiny))
    least = _UNSEEN * np.eye(len(scale))
    covariance = np.linalg.inv(rest.gram / np.outer(scale, scale) + least)
    cost = float(np.trace((block.gram / np.outer(scale, scale)) @ covariance))
    return 0.5 * (_energy(term, weighted) - cost)


def _energy(term: Term, model: Model) -> float:
    """Weighted sum of squares of what a term adds."""
    without = with_residual(replace(model, terms=()))
    alone = with_residual(replace(model, terms=(term,)))
    pairs = zip(without.y, alone.y, model.weight, strict=True)
    return sum(float(w @ (a - b) ** 2) for a, b, w in pairs)


def with_weight(model: Model) -> Model:
    """The model with weights of its present noise."""
    frames = model.setting.frames
    weight = tuple(1.0 / frames[a // 3].power(model.noise[a].power) for a in range(model.setting.axes))
    return replace(model, weight=weight)


def contest_of(hypotheses: Sequence[Hypothesis], thresholds: GainThresholds, pace: GapPace | None = None) -> Contest:
    """A contest of its own: every fold has other columns, and only as many are kept as one selection asks for."""
    return Contest(hypotheses, budget=16_000_000, thresholds=thresholds, pace=pace)
