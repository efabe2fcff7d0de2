"""What no effect of the catalogue explains, as competitors that pay for their freedom.

The catalogue is tried first and alone. Shapes (:mod:`calib.gap.shapes`) are then held against it in three places:
beside its model, in the place of all that it has on a sensor, and in the place of each of its effects; the best of them
join the contest. (What is said of them, and of all else that is unknown: :mod:`calib.gap.strangers`.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.gap.contest import Beside, Contest, Gain, Score, existing, priced
from calib.gap.evidence import evidence, price_of_kind
from calib.gap.hypotheses import Hypothesis
from calib.gap.model import Model
from calib.gap.noise_fit import refitted
from calib.gap.selection import MATERIAL, Chosen, fitted_about, grown, largest_gain, objective, select, without
from calib.gap.shapes import Shape, flexible, shapes_of

Array = NDArray[np.float64]

_MARGIN = 2.0
"""Penalised evidence by which a model with shapes must beat the catalogue alone."""
_SHORTLIST = 6
_CONTAINED = 0.8
"""Part of a flexible line's evidence from which on a named effect is what it bends about, and it stands beside that."""


@dataclass(frozen=True, eq=False)
class WithShapes:
    """The better of the two models, the contest it came from, and the number of all tests."""

    chosen: Chosen
    contest: Contest


def explained(chosen: Chosen, contest: Contest, start: Model, alpha: float) -> WithShapes:
    """The catalogue's model, or a better one with shapes, and a contest that has the likeliest shapes as rivals."""
    shapes = shapes_of(chosen.model.setting, [t for t in chosen.model.terms if t.hypothesis.periodic])
    scorer = Contest(())
    tests = chosen.tests + sum(len(s.hypotheses) for s in shapes)
    named = bool(chosen.model.members)
    places = [
        *((score, 0.0) for score in _scored(shapes, scorer, Beside(chosen.model))),
        *(_instead_of_all(chosen, shapes, scorer, start) if named else ()),
        *_instead_of_each(chosen, shapes, scorer),
    ]
    worth = max(_MARGIN, _least(chosen, contest)) if named else 0.0
    strong = [score for score, own in places if score.p * tests < alpha and score.delta > own + worth]
    likely = {s.hypothesis.key: s.hypothesis for s in _best(places) if s.delta > 0.0}
    bent = {s.hypothesis.key for s, own in places if flexible(s.hypothesis) and own > _CONTAINED * s.delta}
    rivals = [h for key, h in likely.items() if key not in bent]
    instead = Contest((*contest.hypotheses, *rivals), floor=contest.floor)
    if strong:
        level = alpha * sum(not h.again for h in instead.hypotheses) / tests
        beside = Contest((*contest.hypotheses, *likely.values()), floor=contest.floor)
        other = min((select(start, instead, level), grown(chosen, beside, alpha / tests)), key=objective)
        if objective(other) < objective(chosen) - worth:
            return WithShapes(other, instead)
    return WithShapes(chosen, instead)


def _least(chosen: Chosen, contest: Contest) -> float:
    """Part of the largest gain that is a second order of it; noise takes what is its own."""
    return 0.0 if chosen.model.noise_terms else MATERIAL * largest_gain(chosen, contest)


def _best(places: Sequence[tuple[Score, float]]) -> list[Score]:
    """The best few in each place."""
    found = []
    for own in dict.fromkeys(own for _, own in places):
        scores = [score for score, place in places if place == own]
        found += sorted(scores, key=lambda s: -s.delta)[:_SHORTLIST]
    return found


def _instead_of_all(
    chosen: Chosen, shapes: Sequence[Shape], scorer: Contest, start: Model
) -> list[tuple[Score, float]]:
    """Shapes in the place of all effects of a sensor, beside what these are worth together."""
    found = []
    before = refitted(start).deviance
    for sensor in {term.hypothesis.effect.sensor for term in chosen.model.members}:
        own = [s for s in chosen.scores if s.hypothesis.effect.sensor is sensor]
        gain = sum(before[key] - chosen.noise.deviance[key] for key in before if key[0] is sensor)
        worth = gain - sum(s.price for s in own)
        touched = [s for s in shapes if s.whole.effect.sensor is sensor]
        found += [(score, worth) for score in _scored(touched, scorer, Beside(start))]
    return found


def _instead_of_each(chosen: Chosen, shapes: Sequence[Shape], scorer: Contest) -> list[tuple[Score, float]]:
    """Shapes in the place of each effect, beside the penalised evidence of that effect."""
    found = []
    level = objective(chosen)
    for term in chosen.model.members:
        bare = refitted(fitted_about(without(chosen.model, term.hypothesis.key), term.hypothesis))
        touched = [s for s in shapes if s.whole.effect.sensor is term.hypothesis.effect.sensor]
        price = next((s.price for s in chosen.scores if s.hypothesis.key == term.hypothesis.key), 0.0)
        own = sum(bare.deviance.values()) + sum(s.price for s in chosen.scores) - price - level
        found += [(score, own) for score in _scored(touched, scorer, Beside(bare.model))]
    return found


def _scored(shapes: Sequence[Shape], contest: Contest, beside: Beside) -> list[Score]:
    """Scores of all shapes and of their parts, whose columns are made once."""
    found = []
    for shape in shapes:
        columns = contest.columns(shape.whole, math.nan, beside.model)
        gram, right, energy = beside.projected(columns)
        whole = _score(shape.whole, gram, right, energy)
        found.append(whole)
        for hypothesis, rows in shape.parts:
            if whole.gain > price_of_kind(hypothesis.effect.id):  # no part gains more than the whole
                found.append(_score(hypothesis, gram[np.ix_(rows, rows)], right[rows], energy[rows]))
    return found


def _score(hypothesis: Hypothesis, gram: Array, right: Array, energy: Array) -> Score:
    basis = existing(gram, energy)
    gain = basis.T @ right
    worth = evidence(gram, right, np.zeros(len(right), np.intp))
    return priced(hypothesis, math.nan, Gain(float(gain @ gain), basis.shape[1], basis @ gain, worth), 1)
