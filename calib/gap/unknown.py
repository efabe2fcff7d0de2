"""What no effect of the catalogue explains, as competitors that pay for their freedom.

Shapes: a broken line over each covariate, products of signals, jumps. They stand in the same contest as the catalogue
and pay for their freedom; the catalogue is tried first and alone, and a shape wins only if the best model with shapes
is better than the best without. (What is said of them, and of all else that is unknown: :mod:`calib.gap.strangers`.)
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.gap.contest import Beside, Contest, Gain, Score, existing, priced
from calib.gap.effects.base import MeanEffect
from calib.gap.evidence import evidence
from calib.gap.hypotheses import Hypothesis
from calib.gap.model import Model
from calib.gap.selection import MATERIAL, Chosen, largest_gain, objective, select
from calib.gap.shapes import shapes_of

Array = NDArray[np.float64]

_MARGIN = 6.0
"""Penalised evidence by which a model with shapes must beat the catalogue alone."""
_SHORTLIST = 6


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
    largest = largest_gain(chosen, contest)
    least = 0.0 if chosen.model.noise_terms else MATERIAL * largest
    strong = [s for s in scores if s.p * tests < alpha and s.delta > _MARGIN and s.gain >= least]
    if not strong:
        return WithShapes(chosen, contest)
    if chosen.model.members:
        strong = [*_best(strong), *_best(_scored(scorer, Beside(start)))]
    shortlist = {s.hypothesis.key: s.hypothesis for s in _best(strong)}
    both = Contest((*contest.hypotheses, *shortlist.values()), floor=contest.floor)
    level = alpha * sum(not h.again for h in both.hypotheses) / tests
    other = select(start, both, level)
    if objective(other) < objective(chosen) - max(_MARGIN, MATERIAL * largest):
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
            if hypothesis.key[0][-2:-1] != ".":
                found.append(_scored_alone(contest, hypothesis, beside))
            continue
        columns = contest.columns(hypothesis, math.nan, beside.model)
        gram, right, energy = beside.projected(columns)
        for key, rows in _parts(hypothesis, columns.p):
            basis = existing(gram[np.ix_(rows, rows)], energy[rows])
            gain = basis.T @ right[rows]
            own = singles.get(key)
            if own is not None:
                worth = evidence(gram[np.ix_(rows, rows)], right[rows], np.zeros(len(rows), np.intp))
                found.append(priced(own, math.nan, Gain(float(gain @ gain), basis.shape[1], basis @ gain, worth), 1))
    return found


def _scored_alone(contest: Contest, hypothesis: Hypothesis, beside: Beside) -> Score:
    return priced(hypothesis, math.nan, beside.gain(contest.columns(hypothesis, math.nan, beside.model)), 1)


def _parts(hypothesis: Hypothesis, p: int) -> Iterator[tuple[tuple[str, tuple[int, ...]], NDArray[np.intp]]]:
    """Keys of a shape and of its parts on single axes, and the columns that they have of it."""
    effect_id, instances = hypothesis.key
    yield hypothesis.key, np.arange(p)
    for c in range(3):
        yield (f"{effect_id}.{'xyz'[c]}", instances), np.arange(c, p, 3)
