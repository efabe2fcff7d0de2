"""Agreement of two diagnoses, of two flights, on an effect."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from scipy.special import ndtri

from mavcal.calib.gap.schema import EffectEstimate, ParameterEstimate

_CHANCE = 0.0455
"""Chance that one number of two flights that are alike differs by more than two standard errors. Source: two-sided
normal distribution."""
_ERRORS = 2.0
"""Standard errors within which one parameter is closed. Source: AIRFRAME 6, a rerun of the patched simulator."""


@dataclass(frozen=True)
class EffectAgreement:
    """An effect of one diagnosis beside the same one of another.

    `other` is None where the other diagnosis has none on the same instances. `holds`: no parameter differs by more than
    two standard errors, or as many more as the largest of several differs by chance.
    """

    effect: EffectEstimate
    other: EffectEstimate | None
    holds: bool


@dataclass(frozen=True)
class Remainder:
    """What is left of a parameter: the first by the other less 1 where it is a `ratio`, else the first less the other.

    `se` is its standard error, `within` whether it is no more than two of them.
    """

    value: float
    se: float
    ratio: bool
    within: bool


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


def remainders(compared: EffectAgreement) -> Mapping[str, Remainder]:
    """What is left of each parameter by name; where the other diagnosis has no such effect, all of it."""
    theirs = {} if compared.other is None else {p.name: p for p in compared.other.params}
    return {p.name: _remainder(p, theirs.get(p.name)) for p in compared.effect.params}


def _remainder(one: ParameterEstimate, other: ParameterEstimate | None) -> Remainder:
    value, se = (0.0, 0.0) if other is None else (other.value, other.se)
    ratio = one.ratio is not None and value > -1.0
    if ratio:
        left = (1.0 + one.value) / (1.0 + value) - 1.0
        sd = math.hypot(one.se, (1.0 + left) * se) / (1.0 + value)
    else:
        left, sd = one.value - value, math.hypot(one.se, se)
    return Remainder(left, sd, ratio, abs(left) <= _ERRORS * sd)


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
