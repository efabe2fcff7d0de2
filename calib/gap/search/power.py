"""Power of the tests: the smallest parameter value that these recordings would show with a chance of one half."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri, chndtr

from mavcal.calib.gap.effects.base import MeanEffect, NoiseEffect
from mavcal.calib.gap.schema import Power
from mavcal.calib.gap.search.contest import Contest
from mavcal.calib.gap.search.projection import Projection
from mavcal.calib.gap.search.selection import ChosenModel


def powers_of(chosen: ChosenModel, contest: Contest, alpha: float) -> tuple[Power, ...]:
    """For every linear effect that was not found, the smallest detectable value of each parameter."""
    taken = {t.hypothesis.effect.id for t in chosen.model.members}
    best: dict[tuple[str, str], Power] = {}
    for power in _powers(chosen, contest, alpha / max(chosen.tests, 1)):
        key = power.id, power.name
        if power.id not in taken and (key not in best or power.smallest < best[key].smallest):
            best[key] = power
    return tuple(best.values())


def _powers(chosen: ChosenModel, contest: Contest, level: float) -> Iterator[Power]:
    beside = Projection(chosen.model)
    for hypothesis in contest.hypotheses:
        effect = hypothesis.effect
        if isinstance(effect, NoiseEffect) or effect.shape is not None or effect.nameless:
            continue
        assert isinstance(effect, MeanEffect)
        gram, _, energy = beside.projected(contest.columns.of(hypothesis, math.nan, chosen.model.setting))
        needed = noncentrality(len(effect.parameters), level)
        for parameter, own, whole in zip(effect.parameters, np.diag(gram), energy, strict=True):
            if own > 1e-6 * whole > 0.0:
                yield Power(effect.id, parameter.name, math.sqrt(needed / float(own)), parameter.unit)


def noncentrality(df: int, level: float) -> float:
    """The sum of (effect / sigma)^2 at which a test of `df` numbers at `level` fires with a chance of one half."""
    threshold = float(chdtri(df, level))
    return float(brentq(lambda x: float(chndtr(threshold, df, x)) - 0.5, 1e-9, 4.0 * threshold + 50.0))
