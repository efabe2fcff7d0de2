"""Contiguous blocks that are held out in turn, the models of the other blocks, and their predictive loss on the block.

A curve extrapolated beyond the other blocks is uncertain. The amplitudes of the fit are therefore integrated out under
the posterior of those blocks. Its prior is that of :mod:`calib.gap.search.evidence`, widened: amplitudes of one unit
are similar, of about the size in these blocks.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.model.hypotheses import Hypothesis, units_of
from mavcal.calib.gap.model.joint import (
    Model,
    NoiseTerm,
    Setting,
    Term,
    jacobian,
    normal_equations,
    setting_of,
    with_residual,
)
from mavcal.calib.gap.model.noise_fit import model_without_effects, with_term
from mavcal.calib.gap.model.normal_equations import solved
from mavcal.calib.gap.model.views import View, between
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.evidence import prior_sd
from mavcal.calib.gap.search.terms import locally_fitted, with_member, without_effect
from mavcal.calib.gap.search.thresholds import GainThresholds

Array = NDArray[np.float64]

_UNSEEN = 1e-9
"""Fraction of an amplitude's information below which the other blocks do not determine it. Source: rounding of an
information matrix, 1e-16, with a margin."""
_LEAST_BLOCKS = 3
"""Least number of blocks with samples. Chosen, not measured: fewer cannot predict each other."""
GUARD_S = 0.5
"""Time, s, cut off at either end of a block, so that correlated noise does not connect it with the next. Source: GAP
3.4."""


@dataclass(frozen=True, eq=False)
class Fold:
    """A held-out block and the others, each with its noise before any effect."""

    train: Model
    test: Model


@remembered(2)
def folds_of(setting: Setting, count: int) -> tuple[Fold, ...]:
    """`count` folds of a setting, without blocks that have no samples."""
    edges, guard = _block_edges(setting, count)
    found = []
    for low, high in itertools.pairwise(edges):
        block = _views_between(setting, low + guard, high - guard)
        rest = [*_views_between(setting, -math.inf, low - guard), *_views_between(setting, high + guard, math.inf)]
        if block and rest:
            found.append(Fold(_starting_model(rest), _starting_model(block)))
    return tuple(found) if len(found) >= _LEAST_BLOCKS else ()


@remembered(1)
def blocks_of(setting: Setting, count: int) -> tuple[Model, ...]:
    """The blocks of those folds."""
    edges, guard = _block_edges(setting, count)
    parts = (_views_between(setting, low + guard, high - guard) for low, high in itertools.pairwise(edges))
    blocks = [part for part in parts if part]
    return tuple(_starting_model(part) for part in blocks) if len(blocks) >= _LEAST_BLOCKS else ()


def _block_edges(setting: Setting, count: int) -> tuple[Array, float]:
    """Edges of `count` blocks of equal length, s, and the guard time at either end of each."""
    start = min(float(view.t[0]) for view in setting.views)
    end = max(float(view.t[-1]) for view in setting.views)
    return np.linspace(start, end, count + 1), min(GUARD_S, 0.1 * (end - start) / count)


def _views_between(setting: Setting, low: float, high: float) -> list[View]:
    return [part for view in setting.views if (part := between(view, low, high)) is not None]


def _starting_model(views: Sequence[View]) -> Model:
    return model_without_effects(setting_of(tuple(views)))


def with_joined_term(model: Model, term: Term | NoiseTerm, *, hold: bool = False) -> Model:
    """The model with a term of another setting, fitted from its present values; with `hold` shapes are held."""
    return locally_fitted(with_member(model, term), term.hypothesis, hold=hold)


def is_predictable(term: Term | NoiseTerm, whole: Model, train: Setting) -> bool:
    """Whether the blocks of `train` determine a term of the `whole` model.

    Beside a bias drift, only blocks that contain a jump determine it; without a drift, the levels do. Blocks without a
    sample between two jumps determine only their sum.
    """
    effect = term.hypothesis.effect
    if not isinstance(term, Term) or not effect.discontinuous:
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


def without_hypothesis(model: Model, hypothesis: Hypothesis, *, hold: bool = False) -> Model:
    """The model without the term of a hypothesis, fitted again; with `hold` shapes are held."""
    return locally_fitted(without_effect(model, hypothesis.key), hypothesis, hold=hold)


def applied_to(model: Model, test: Model) -> Model:
    """A model of the training blocks applied to the held-out one: same effects, same noise."""
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
    """Mean square of the whitened residual, and the count of its numbers."""
    total, count = 0.0, 0
    for a in range(model.setting.axes):
        bins = model.setting.bins[a // 3]
        total += float((model.periodogram(a) / bins.mean(model.noise[a].power)).sum())
        count += int(bins.counts.sum())
    return total / max(count, 1), count


def expected_gain(term: Term, train: Model, test: Model) -> float:
    """Expected decrease of the loss of a held-out block by a term of the mean, in nats, if the term is true.

    Half of its energy there, less the cost of its estimation error; very negative if the other blocks do not determine
    it.
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
    return 0.5 * (_term_energy(term, weighted) - cost)


def _term_energy(term: Term, model: Model) -> float:
    """Weighted sum of squares of a term's contribution."""
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
    """A contest with a cache of one selection, since every fold has other columns."""
    return Contest(hypotheses, budget=16_000_000, thresholds=thresholds, pace=pace)


_WIDE = 10.0
"""Width of the prior of an amplitude, relative to its size in the other blocks. It bounds what they do not determine,
and does not shrink what they do. Source: decision 6."""
_NOTHING = 1e-3
"""Prior standard deviation of an amplitude of zero evidence, in standard errors of all blocks together. Chosen, not
measured: practically zero, with an invertible matrix."""
_LEAST = 1e-9
"""Added to the normalised information, so that undetermined directions stay invertible. Source: rounding of a matrix,
1e-16, with a margin."""


def predictive_loss(fitted: Model, block: Model) -> float:
    """Negative log predictive density of a held-out block under what was fitted to the others, in nats.

    K and v are the information and the estimates of the other blocks, and L is the prior precision. S and b are the
    information of the block and the right side of its normal equations at v. The posterior is ``N(v - d, P^-1)`` with
    ``P = K + L`` and ``P d = L v``. With ``c = b + S d``, the block costs this much more than at a certain v:
    ``d'b + d'Sd/2 + (log|P + S| - log|P| - c'(P + S)^-1 c) / 2``.

    Parameters
    ----------
    fitted
        A model of the other blocks.
    block
        The held-out block's data without an effect.
    """
    tested = applied_to(fitted, block)
    loss = log_loss(tested)
    if not tested.terms:
        return loss
    tested = with_weight(tested)
    fitted_gram, _ = _information(fitted)
    tested_gram, b = _information(tested)
    v = np.concatenate([term.values for term in fitted.terms])
    precision = _precision(fitted, fitted_gram, tested_gram)
    free = [i for i in range(len(v)) if i not in _jump_indices(fitted.terms)]
    fitted_gram, tested_gram = fitted_gram[np.ix_(free, free)], tested_gram[np.ix_(free, free)]
    b, v, precision = b[free], v[free], precision[free]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(fitted_gram + tested_gram) + precision, np.finfo(float).tiny))
    S, prior = tested_gram * np.outer(scale, scale), precision * scale**2
    P = fitted_gram * np.outer(scale, scale) + np.diag(prior + _LEAST)
    b = b * scale
    d = np.linalg.solve(P, prior * v / scale)
    c = b + S @ d
    moved = float(d @ b + 0.5 * d @ S @ d)
    return loss + moved + 0.5 * (_log_det(P + S) - _log_det(P) - float(c @ np.linalg.solve(P + S, c)))


def _information(model: Model) -> tuple[Array, Array]:
    """Information of all values of a model's terms, and the right side."""
    normal = normal_equations([jacobian(t, model.setting) for t in model.terms], model.y, model.weight)
    return normal.gram, normal.right


def _precision(fitted: Model, fitted_gram: Array, tested_gram: Array) -> Array:
    """Prior precision of every value: amplitudes have a prior of their own size, shapes none."""
    ends = np.cumsum([0, *(len(term.values) for term in fitted.terms)])
    error = 1.0 / np.sqrt(np.maximum(np.diag(fitted_gram + tested_gram), np.finfo(float).tiny))
    values = np.concatenate([term.values for term in fitted.terms])
    precision = np.zeros(len(fitted_gram))
    for term, (start, end) in zip(fitted.terms, itertools.pairwise(ends), strict=True):
        if term.effect.fixed:
            continue
        own = np.arange(start, start + len(term.beta))
        rest = np.setdiff1d(np.arange(len(fitted_gram)), np.arange(start, end))
        cross = fitted_gram[np.ix_(own, rest)]
        gram = (
            fitted_gram[np.ix_(own, own)]
            - cross @ solved(fitted_gram[np.ix_(rest, rest)], np.zeros(len(rest)))[1] @ cross.T
        )
        units = units_of(term.effect, len(own))
        size = prior_sd(gram, gram @ term.beta, units)
        if not size.any():  # beside another that does the same there; of both together they may say much
            size = prior_sd(fitted_gram[np.ix_(own, own)], fitted_gram[own] @ values, units)
        precision[own] = 1.0 / np.maximum(_WIDE * size, _NOTHING * error[own]) ** 2
    return precision


def _jump_indices(terms: tuple[Term, ...]) -> set[int]:
    """Indices of jump moments among the values of all terms, which have no smooth derivative."""
    ends = np.cumsum([len(term.values) for term in terms])
    return {int(e) - 1 for e, t in zip(ends, terms, strict=True) if t.effect.discontinuous}


def _log_det(matrix: Array) -> float:
    return float(np.linalg.slogdet(matrix)[1])
