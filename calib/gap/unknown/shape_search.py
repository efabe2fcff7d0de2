"""Unnamed shapes as competitors of the catalogue, which pay for their flexibility.

The catalogue is tried first, alone. Shapes (:mod:`calib.gap.unknown.shapes`) are then compared with it in three places:
beside its model, instead of all effects on a sensor, and instead of each effect. The best of them enter the contest.
(The report of unnamed causes: :mod:`calib.gap.unknown.verdict`.)
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.model.hypotheses import Hypothesis
from mavcal.calib.gap.model.joint import Model
from mavcal.calib.gap.model.noise_fit import noise_fitted
from mavcal.calib.gap.search import prices
from mavcal.calib.gap.search.contest import Contest, ContestScore, free_score
from mavcal.calib.gap.search.evidence import price_of_kind
from mavcal.calib.gap.search.projection import Projection, gain_of
from mavcal.calib.gap.search.selection import ChosenModel, extended, largest_gain, objective, select, total_price
from mavcal.calib.gap.search.terms import locally_fitted, without_effect
from mavcal.calib.gap.unknown.shapes import ShapeHypothesis, is_broken_line, shapes_of

Array = NDArray[np.float64]

_LEAST_IMPROVEMENT = 2.0
"""Penalised evidence by which a model with shapes must beat the catalogue alone. Source: decision 5."""
_SHORTLIST = 6
"""Shapes of each place that enter the contest. Chosen, not measured: it bounds the time."""
_CONTAINED_SHARE = 0.8
"""Fraction of a shape's evidence above which a simpler effect explains it. Source: decision 5."""


@dataclass(frozen=True, eq=False)
class ShapeSearch:
    """The better of the two models, and the contest with the likeliest shapes among the rivals."""

    chosen: ChosenModel
    contest: Contest


@dataclass(frozen=True, eq=False)
class _ShapePlace:
    """A shape in a place: it replaces effects of penalised evidence `own` with `df` parameters."""

    score: ContestScore
    own: float = 0.0
    df: int = 0

    @property
    def better(self) -> float:
        """Penalised evidence of the shape minus that of the replaced effects."""
        return self.score.delta - self.own

    @property
    def elaborate(self) -> bool:
        """Whether it has more parameters than the replaced effects but explains hardly more."""
        more = is_broken_line(self.score.hypothesis) or self.score.df > self.df
        return more and self.own > _CONTAINED_SHARE * self.score.delta


def with_shapes(
    chosen: ChosenModel, contest: Contest, start: Model, alpha: float, named: Collection[str]
) -> ShapeSearch:
    """The catalogue's model, or a better one with shapes, and a contest with the likeliest shapes as rivals.

    `named` are all ids of the catalogue, including effects that cannot be tested here.
    """
    if contest.pace.ends():
        return ShapeSearch(chosen, contest)
    periodic = [t for t in chosen.model.terms if t.hypothesis.periodic]
    shapes = shapes_of(chosen.model.setting, periodic, named)
    scorer = contest.restricted_to(())
    tests = chosen.tests + sum(len(s.hypotheses) for s in shapes)
    beside = [_ShapePlace(score) for score in _shape_scores(shapes, scorer, Projection(chosen.model))]
    instead = [
        *_instead_of_all_effects(chosen, shapes, scorer, start),
        *_instead_of_each_effect(chosen, shapes, scorer),
    ]
    worth = max(_LEAST_IMPROVEMENT, _second_order_gain(chosen, contest)) if chosen.model.members else 0.0
    strong = any(p.score.p * tests < alpha and p.better > worth for p in (*beside, *instead))
    likely = {
        p.score.hypothesis.key: p.score.hypothesis for p in _shortlist((*beside, *instead)) if p.score.delta > 0.0
    }
    elaborate = {p.score.hypothesis.key for p in instead if p.elaborate}
    plain = [h for key, h in likely.items() if key not in elaborate]
    rivals = contest.restricted_to((*contest.hypotheses, *plain))
    if strong:
        level = alpha * sum(not h.again for h in rivals.hypotheses) / tests
        everything = contest.restricted_to((*contest.hypotheses, *likely.values()))
        again = select(start, rivals, level, earlier=chosen)
        other = min((again, extended(chosen, everything, alpha / tests)), key=objective)
        if objective(other) < objective(chosen) - worth:
            return ShapeSearch(other, rivals)
    return ShapeSearch(chosen, rivals)


def _second_order_gain(chosen: ChosenModel, contest: Contest) -> float:
    """Second-order part of the largest gain; zero if noise effects are in the model."""
    return 0.0 if chosen.model.noise_terms else prices.SECOND_ORDER_SHARE * largest_gain(chosen, contest)


def _shortlist(places: Sequence[_ShapePlace]) -> list[_ShapePlace]:
    """The best few shapes of each place."""
    found = []
    for own in dict.fromkeys(p.own for p in places):
        found += sorted((p for p in places if p.own == own), key=lambda p: -p.score.delta)[:_SHORTLIST]
    return found


def _instead_of_all_effects(
    chosen: ChosenModel, shapes: Sequence[ShapeHypothesis], scorer: Contest, start: Model
) -> list[_ShapePlace]:
    """Shapes in place of all effects on a sensor."""
    found = []
    before = noise_fitted(start).deviance
    for sensor in {term.hypothesis.effect.sensor for term in chosen.model.members}:
        own = [s for s in chosen.scores if s.hypothesis.effect.sensor is sensor]
        gain = sum(before[key] - chosen.noise.deviance[key] for key in before if key[0] is sensor)
        worth, df = (
            gain - total_price(own) + prices.EFFECT_COUNT_PRICE,
            sum(s.df for s in own),
        )  # a shape is one of its own
        touched = [s for s in shapes if s.whole.effect.sensor is sensor]
        found += [_ShapePlace(score, worth, df) for score in _shape_scores(touched, scorer, Projection(start))]
    return found


def _instead_of_each_effect(
    chosen: ChosenModel, shapes: Sequence[ShapeHypothesis], scorer: Contest
) -> list[_ShapePlace]:
    """Shapes in place of each effect."""
    found = []
    level = sum(chosen.noise.deviance.values())
    for term in chosen.model.members:
        bare = noise_fitted(locally_fitted(without_effect(chosen.model, term.hypothesis.key), term.hypothesis))
        touched = [s for s in shapes if s.whole.effect.sensor is term.hypothesis.effect.sensor]
        score = next((s for s in chosen.scores if s.hypothesis.key == term.hypothesis.key), None)
        price, df = (0.0, 0) if score is None else (score.price, score.df)
        own = sum(bare.deviance.values()) - level - price
        found += [_ShapePlace(score, own, df) for score in _shape_scores(touched, scorer, Projection(bare.model))]
    return found


def _shape_scores(shapes: Sequence[ShapeHypothesis], contest: Contest, beside: Projection) -> list[ContestScore]:
    """Scores of all shapes and their parts, with the columns of a shape made once."""
    found = []
    for shape in shapes:
        columns = contest.columns.of(shape.whole, math.nan, beside.model.setting)
        gram, right, energy = beside.projected(columns)
        whole = _score(shape.whole, gram, right, energy)
        found.append(whole)
        for hypothesis, rows in shape.parts:
            if whole.gain > price_of_kind(hypothesis.effect):  # no part gains more than the whole
                found.append(_score(hypothesis, gram[rows[:, None], rows], right[rows], energy[rows]))
    return found


def _score(hypothesis: Hypothesis, gram: Array, right: Array, energy: Array) -> ContestScore:
    gain = gain_of(gram, right, energy, np.zeros(len(right), np.intp))
    return free_score(hypothesis, math.nan, gain, 1)
