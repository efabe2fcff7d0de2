"""Steady effects that a recording shows against its own ideal: what a baseline is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.model.bands import split
from mavcal.calib.gap.model.hypotheses import Key, hypotheses_of
from mavcal.calib.gap.model.joint import setting_of, starting_model
from mavcal.calib.gap.model.noise_fit import refitted, starting_noise
from mavcal.calib.gap.model.views import views_of
from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.remembered import one_diagnosis
from mavcal.calib.gap.schema import EffectEstimate, EffectEvidence
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.selection import ChosenModel, last_gains, reduced, select
from mavcal.calib.gap.search.thresholds import GainThresholds
from mavcal.calib.gap.telling.estimates import estimates_of
from mavcal.calib.recording import Sensor


@dataclass(frozen=True, eq=False)
class SteadyEffect:
    """An effect, its gain beside all the others, and the sensors on which it is seen."""

    effect: EffectEstimate
    gain: float
    sensors: tuple[Sensor, ...]


@one_diagnosis()
def steady_effects(
    problem: GapProblem, alpha: float, thresholds: GainThresholds, without: Sequence[str] = ()
) -> list[SteadyEffect]:
    """Steady effects on the mean that are significant beside each other, and above what recordings differ by anyway."""
    views = split(views_of(problem, {}, {}))
    hypotheses, _ = hypotheses_of([e for e in catalogue() if _carried(e) and e.id not in without], views)
    if not views or not hypotheses:
        return []
    setting = setting_of(views)
    contest = Contest(hypotheses, floors=thresholds)
    chosen = select(refitted(starting_model(setting, starting_noise(setting))).model, contest, alpha)
    chosen = reduced(chosen, _indifferent(chosen, contest))
    gains = {key: gain for key, (gain, _, _) in last_gains(chosen.model, contest).items()}
    found = []
    for term in chosen.model.terms:
        effect, gain = term.hypothesis.effect, gains[term.hypothesis.key]
        instances = tuple(i + 1 for i in term.hypothesis.instances)
        evidence = EffectEvidence(gain, len(term.values), 0.0, 1.0, 0.0)
        estimate = EffectEstimate(effect.id, effect.sensor, instances, estimates_of(chosen, term), evidence)
        seen = dict.fromkeys(v.sensor for v in views if effect.shared or v.sensor is effect.sensor)
        found.append(SteadyEffect(estimate, gain, tuple(seen)))
    return found


def _indifferent(chosen: ChosenModel, contest: Contest) -> list[Key]:
    """Effects that gain less than the minimum once the noise is fitted with them."""
    gains = last_gains(chosen.model, contest)
    small = []
    for term in chosen.model.terms:
        touched = (v.sensor for v in chosen.model.setting.views if term.hypothesis.touches(v))
        if gains[term.hypothesis.key][0] < max(map(contest.floors.lasting, touched)):
            small.append(term.hypothesis.key)
    return small


def _carried(effect: CatalogueEffect) -> bool:
    return isinstance(effect, MeanEffect) and Trait.STEADY in effect.traits
