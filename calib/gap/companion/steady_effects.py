"""Steady effects that a recording shows against its own ideal reading: the content of a baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.bands import split
from mavcal.calib.gap.model.hypotheses import Key, hypotheses_of
from mavcal.calib.gap.model.joint import Model, setting_of
from mavcal.calib.gap.model.noise_fit import model_without_effects, noise_fitted
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.progress import GapPace
from mavcal.calib.gap.remembered import one_diagnosis
from mavcal.calib.gap.schema import EffectEstimate, EffectEvidence
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.selection import ChosenModel, refitted_without, select
from mavcal.calib.gap.search.terms import marginal_gains, without_effect
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.gap.telling.estimates import estimates_of
from mavcal.calib.gap.worth.attitude_error import below_reference
from mavcal.calib.recording import Sensor

_FURTHER_RATIO = 1.2
"""Ratio of the residual with an effect to that without it, above which the effect makes it worse. Chosen, not measured:
a fifth more may be the noise of other samples."""
_TINY = 1e-30
"""Least variance of a series. Source: it guards a division; no sensor resolves its root, 1e-15."""


@dataclass(frozen=True, eq=False)
class SteadyEffect:
    """An effect, its gain beside all others, and the sensors on which it acts."""

    key: Key
    effect: EffectEstimate
    gain: float
    sensors: tuple[Sensor, ...]


@dataclass(frozen=True, eq=False)
class SteadyEffects:
    """Effects that a flight shows.

    `own` effects are subtracted from this flight's readings; some may be errors of its reference, which differ from
    flight to flight. `supported` effects are expected in another flight too. `doubted` effects fit noise.
    """

    own: tuple[SteadyEffect, ...] = ()
    supported: tuple[SteadyEffect, ...] = ()
    doubted: tuple[SteadyEffect, ...] = ()


@one_diagnosis()
def steady_effects(
    problem: GapProblem,
    alpha: float,
    thresholds: GainThresholds,
    without: Sequence[str] = (),
    pace: GapPace | None = None,
) -> SteadyEffects:
    """Steady effects on the mean that are significant beside each other and exceed the accepted differences."""
    views = split(views_of(problem, {}, {}))
    hypotheses, _ = hypotheses_of([e for e in catalogue() if _is_steady_mean(e) and e.id not in without], views)
    if not views or not hypotheses:
        return SteadyEffects()
    setting = setting_of(views)
    contest = Contest(hypotheses, thresholds=thresholds, pace=pace)
    chosen = select(noise_fitted(model_without_effects(setting)).model, contest, alpha)
    chosen = refitted_without(chosen, _below_minimum(chosen, contest))
    noise = _further_from_ideal(chosen.model)
    doubted = tuple(e for e in _estimated(chosen, contest) if e.key in noise)
    own = refitted_without(chosen, noise) if noise else chosen
    left = below_reference(chosen.model, chosen.joint) - frozenset(noise)
    supported = refitted_without(own, left) if left else own
    return SteadyEffects(_estimated(own, contest), _estimated(supported, contest), doubted)


def _estimated(chosen: ChosenModel, contest: Contest) -> tuple[SteadyEffect, ...]:
    """The effects of a model with their estimates and gains."""
    gains = {key: gain for key, (gain, _, _) in marginal_gains(chosen.model, contest).items()}
    found = []
    for term in chosen.model.terms:
        effect, gain = term.hypothesis.effect, gains[term.hypothesis.key]
        instances = tuple(i + 1 for i in term.hypothesis.instances)
        evidence = EffectEvidence(gain, len(term.values), 0.0, 1.0, 0.0)
        estimate = EffectEstimate(effect.id, effect.sensor, instances, estimates_of(chosen, term), evidence)
        views = chosen.model.setting.views
        seen = dict.fromkeys(v.sensor for v in views if effect.shared or v.sensor is effect.sensor)
        found.append(SteadyEffect(term.hypothesis.key, estimate, gain, tuple(seen)))
    return tuple(found)


def _below_minimum(chosen: ChosenModel, contest: Contest) -> list[Key]:
    """Effects that gain less than the minimum once the noise is fitted with them."""
    gains = marginal_gains(chosen.model, contest)
    small = []
    for term in chosen.model.terms:
        touched = (v.sensor for v in chosen.model.setting.views if term.hypothesis.touches(v))
        if gains[term.hypothesis.key][0] < max(map(contest.thresholds.lasting, touched)):
            small.append(term.hypothesis.key)
    return small


def _further_from_ideal(model: Model) -> list[Key]:
    """Effects that move the readings further from the ideal ones.

    They fit noise: whitened samples give weight to fast movement, which a re-estimated trajectory does not follow. In a
    flight with other movement they would add an error to the ideal reading that no sensor has.
    """
    left = _normalised_residual(model)
    return [
        t.hypothesis.key
        for t in model.terms
        if left > _FURTHER_RATIO * _normalised_residual(without_effect(model, t.hypothesis.key))
    ]


def _normalised_residual(model: Model) -> float:
    """Sum of squares of the residual about its mean, in units of the variance of each series.

    The mean is excluded, because an offset may replace another effect's contribution to it.
    """
    return sum(
        float((left.var(axis=0) / np.maximum(view.residual.var(axis=0), _TINY)).sum() * len(left))
        for view, left in zip(model.setting.views, model.residual, strict=True)
    )


def _is_steady_mean(effect: CatalogueEffect) -> bool:
    return isinstance(effect, MeanEffect) and Trait.STEADY in effect.traits
