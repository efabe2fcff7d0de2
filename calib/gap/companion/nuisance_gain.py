"""Gain that each hypothesis would have from the uncertainty of the nuisance effects.

A baseline subtracts the effects that another recording showed. They differ slightly in this one, and a hypothesis that
explains only the difference is not a gap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mavcal.calib.gap.effects.base import MeanEffect
from mavcal.calib.gap.effects.replay import shape_and_amplitudes
from mavcal.calib.gap.model.hypotheses import Key
from mavcal.calib.gap.model.joint import Model, Term, with_residual
from mavcal.calib.gap.problem import NuisanceEffect
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.projection import Projection
from mavcal.calib.gap.search.thresholds import GainThresholds


def above_nuisance(contest: Contest, bare: Model, nuisance: tuple[NuisanceEffect, ...]) -> Contest:
    """`contest` in which every hypothesis must also exceed its gain from the uncertainty of the `nuisance` effects.

    The noise of the `bare` model is the declared one: noise fitted to a gap would be larger, and that gain too small.
    """
    own = _nuisance_gains(contest, bare, nuisance) if nuisance else {}
    return Contest(
        contest.hypotheses, thresholds=GainThresholds(contest.thresholds.minimum_gain, own), pace=contest.pace
    )


def _nuisance_gains(contest: Contest, bare: Model, nuisance: tuple[NuisanceEffect, ...]) -> Mapping[Key, float]:
    nothing = with_residual(replace(bare, terms=()))
    residual = [np.zeros_like(r) for r in nothing.residual]
    y = [np.zeros_like(r) for r in nothing.y]
    for effect in nuisance:
        if (term := _as_term(contest, effect)) is None:
            continue
        there = with_residual(replace(bare, terms=(term,)))
        residual = [
            s + effect.uncertain_share * (a - b)
            for s, a, b in zip(residual, nothing.residual, there.residual, strict=True)
        ]
        y = [s + effect.uncertain_share * (a - b) for s, a, b in zip(y, nothing.y, there.y, strict=True)]
    left = replace(nothing, residual=tuple(residual), y=tuple(y))
    means = [h for h in contest.hypotheses if isinstance(h.effect, MeanEffect)]
    return {score.hypothesis.key: max(score.gain, 0.0) for score in contest.scores(means, Projection(left))}


def _as_term(contest: Contest, nuisance: NuisanceEffect) -> Term | None:
    """The nuisance effect as a term; None if no effect of that id can be tested here."""
    effect_id = nuisance.effect.id
    candidates = [h for h in contest.hypotheses if h.effect.id == effect_id and not h.again and not h.effect.form]
    if not candidates:
        return None
    hypothesis = max(candidates, key=lambda h: len(h.instances))
    effect = hypothesis.effect
    assert isinstance(effect, MeanEffect)
    theta, amplitudes = shape_and_amplitudes(effect, nuisance.effect)
    return Term(hypothesis, np.ones(1) if effect.fixed else amplitudes, theta)
