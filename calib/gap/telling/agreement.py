"""Agreement of two diagnoses, of two flights, on an effect."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from scipy.special import ndtri

from mavcal.calib.gap.schema import EffectEstimate

_CHANCE = 0.0455
"""Chance that one number of two flights that are alike differs by more than two standard errors. Source: two-sided
normal distribution."""


@dataclass(frozen=True)
class EffectAgreement:
    """An effect of one diagnosis beside the same one of another.

    `other` is None where the other diagnosis has none on the same instances. `holds`: no parameter differs by more than
    two standard errors, or as many more as the largest of several differs by chance.
    """

    effect: EffectEstimate
    other: EffectEstimate | None
    holds: bool


def agreements(effects: Sequence[EffectEstimate], others: Iterable[EffectEstimate]) -> tuple[EffectAgreement, ...]:
    """Each of `effects` with its counterpart among `others`, each of which is used once.

    Of several of one kind (steps), the one with the nearest parameters.
    """
    left = list(others)
    found = []
    for effect in effects:
        like = [o for o in left if o.id == effect.id and o.instances == effect.instances]
        best = min(like, key=lambda o: distance(effect, o), default=None)
        if best is not None:
            left.remove(best)
        found.append(EffectAgreement(effect, best, best is not None and distance(effect, best) <= 1.0))
    return tuple(found)


def distance(one: EffectEstimate, other: EffectEstimate) -> float:
    """Largest difference of their parameters in units of the allowed one; infinite without a common parameter."""
    theirs = {p.name: p for p in other.params}
    apart = [
        abs(p.value - theirs[p.name].value) / max(math.hypot(p.se, theirs[p.name].se), 1e-300)
        for p in one.params
        if p.name in theirs and math.isfinite(p.se) and math.isfinite(theirs[p.name].se)
    ]
    if not apart:
        return math.inf
    return max(apart) / -float(ndtri(0.5 * _CHANCE / len(apart)))
