"""Effects of a model for the report: parameters, evidence, probability, rivals and gates."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.reference_attitude import REFERENCE
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.heldout.shrink import block_agreement
from mavcal.calib.gap.schema import FIRST, EffectEstimate, EffectEvidence, Gates, Rival
from mavcal.calib.gap.search.selection import ChosenModel
from mavcal.calib.gap.search.terms import member_of
from mavcal.calib.gap.search.wander import WanderFit, rms_rotation, sees_attitude
from mavcal.calib.gap.telling.estimates import estimates_of
from mavcal.calib.gap.worth.attribution import TEMPERATURE, Attribution
from mavcal.calib.recording import Sensor

_SHARPNESS = 0.7
"""Exponent that flattens the probability among rivals. Source: a fit, seeds 90001-90570."""
_LEVEL, _SLOPE = 3.3, 1.2
"""Log-odds that an effect of gain 200 is right, and their increase per power of ten. Source: a fit, seeds
90001-90570."""
_BESIDE_UNKNOWN = 2.1
"""Decrease of the log-odds if something unknown is present too. Source: a fit, seeds 90001-90570."""
_MIDDLE, _LEAST, _MOST = 2.3, 1.3, 3.3
"""Powers of ten of the gain: the middle and the limits of the fitted cases. Source: a fit, seeds 90001-90570."""


def effect_of(chosen: ChosenModel, found: Attribution, passed: bool | None, *, beside_unknown: bool) -> EffectEstimate:
    """The estimate of an effect; `passed`: whether held-out blocks confirm it, None if undecided."""
    term, dose = member_of(chosen.model, found.key), block_agreement(chosen, found.key)
    p = next((s.p for s in chosen.scores if s.hypothesis.key == found.key), 1.0)
    probability = calibrated_probability(found.probability, found.gain, beside_unknown=beside_unknown)
    return EffectEstimate(
        term.hypothesis.effect.id,
        term.hypothesis.effect.sensor,
        tuple(i + FIRST for i in found.key[1]),
        estimates_of(chosen, term, dose.widening),
        EffectEvidence(found.gain, found.df, min(1.0, p * chosen.tests), probability, found.share),
        found.rivals,
        Gates(passed, None, dose.agrees),
    )


def calibrated_probability(among_rivals: float, gain: float, *, beside_unknown: bool) -> float:
    """Probability that an effect is present, calibrated on cases with known effects.

    The softmax includes only listed rivals. A small gain is often a second-order term of something large or unnamed.
    The constants were fitted to 446 named effects of unsealed cases: one to three effects, seeds 90001 to 90570,
    without and with unknown errors. Each kind has the weight of a full run of the check (1000, 400, 400 and 200 cases),
    in which 83 % are right.

    Parameters
    ----------
    among_rivals
        Its probability among its rivals.
    gain
        Twice the log-likelihood that it gains beside all others.
    beside_unknown
        Whether something unknown is reported as well.

    Examples
    --------
    >>> round(calibrated_probability(1.0, 2000.0, beside_unknown=False), 2)
    0.99
    >>> round(calibrated_probability(1.0, 50.0, beside_unknown=False), 2)
    0.93
    """
    power = min(max(math.log10(max(gain, 1.0)), _LEAST), _MOST)
    odds = _LEVEL + _SLOPE * (power - _MIDDLE) - (_BESIDE_UNKNOWN if beside_unknown else 0.0)
    return float(among_rivals**_SHARPNESS / (1.0 + math.exp(-odds)))


def delay_on_late_unit(effect: EffectEstimate, units: Collection[int]) -> EffectEstimate:
    """A delay, moved to the unit that has it, of two `units`, which count from 1.

    A re-estimated trajectory follows one unit and has its delay. The other then seems to be early, which no sensor can
    be.
    """
    if Trait.LATE not in by_id()[effect.id].traits or len(units) != 2 or len(effect.instances) != 1:
        return effect
    (delay,) = effect.params
    low, high = delay.ci95
    if high >= 0.0:
        return effect
    late = replace(delay, value=-delay.value, ci95=(-high, -low))
    return replace(effect, instances=tuple(set(units) - set(effect.instances)), params=(late,))


def with_other_unit_as_rival(effect: EffectEstimate, units: Collection[int], sure: float) -> EffectEstimate:
    """`effect` with the other of two `units` (from 1) as a rival; `sure` is the probability that this unit has it."""
    other = next(unit for unit in sorted(units) if unit not in effect.instances)
    fix = f"turning through all headings and tilts (instance {other} may have it instead, with the opposite sign)"
    evidence = replace(effect.evidence, probability=sure * effect.evidence.probability)
    rivals = (Rival(effect.id, 1.0, 0.0, fix), *effect.confusable_with)
    return replace(effect, evidence=evidence, confusable_with=rivals)


def attitude_error_effect(wander: WanderFit, attributions: tuple[Attribution, ...]) -> EffectEstimate:
    """The reference's attitude error as an effect: its rms about each axis."""
    model = wander.chosen.model
    instances = sorted({i + FIRST for view in model.setting.views if sees_attitude(view) for i in view.weights})
    others = sum(a.gain for a in attributions)
    sure = EffectEvidence(
        wander.gain,
        2,
        float(np.exp(-0.5 * min(wander.gain, 1400.0))),
        float(1.0 / (1.0 + np.exp(-0.5 * min(wander.gain, 1400.0) / TEMPERATURE))),
        wander.gain / (wander.gain + others),
    )
    return EffectEstimate(REFERENCE, Sensor.ACCEL, tuple(instances), rms_rotation(model), sure)
