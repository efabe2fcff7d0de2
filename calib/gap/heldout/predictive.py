"""What a fit to some blocks predicts of another one, and with which uncertainty.

A curve that is carried on beyond what the blocks saw is known badly there; taken for certain it would be punished for
more than it claims. The amplitudes of the fit are therefore integrated out under the posterior of the blocks, whose
prior is that of :mod:`calib.gap.search.evidence`, widened: amplitudes of one unit are alike, and about as large as
these blocks say. They predict nothing about what they do not show at all.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.heldout.folds import carried, log_loss, with_weight
from mavcal.calib.gap.model.hypotheses import units_of
from mavcal.calib.gap.model.joint import Model, Term, jacobian, normal_equations
from mavcal.calib.gap.model.normal_equations import solved
from mavcal.calib.gap.search.evidence import prior_sd

Array = NDArray[np.float64]

_WIDE = 10.0
"""Times the size that the other blocks say, that an amplitude may have by the prior: it is to bound what they do not
show, and not to shrink what they do. Source: decision 6."""
_NOTHING = 1e-3
"""Prior standard deviation of an amplitude without any sign of it, in standard errors of all blocks together. Chosen,
not measured: nothing, and still a matrix with an inverse."""
_LEAST = 1e-9
"""Added to normalised information, so that what nothing tells has an inverse. Source: rounding of a matrix, 1e-16, with
a margin."""


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
    tested = carried(fitted, block)
    loss = log_loss(tested)
    if not tested.terms:
        return loss
    tested = with_weight(tested)
    fitted_gram, _ = _information(fitted)
    tested_gram, b = _information(tested)
    v = np.concatenate([term.values for term in fitted.terms])
    precision = _precision(fitted, fitted_gram, tested_gram)
    free = [i for i in range(len(v)) if i not in _moments(fitted.terms)]
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
    """Information on all values of a model's terms, and the right side beside it."""
    normal = normal_equations([jacobian(t, model.setting) for t in model.terms], model.y, model.weight)
    return normal.gram, normal.right


def _precision(fitted: Model, fitted_gram: Array, tested_gram: Array) -> Array:
    """Precision of the prior of every value: amplitudes have one of their own size, shapes none."""
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


def _moments(terms: tuple[Term, ...]) -> set[int]:
    """Where moments are among the values of all terms: nothing is smooth about them."""
    ends = np.cumsum([len(term.values) for term in terms])
    return {int(e) - 1 for e, t in zip(ends, terms, strict=True) if t.effect.shape is not None and t.effect.shape.still}


def _log_det(matrix: Array) -> float:
    return float(np.linalg.slogdet(matrix)[1])
