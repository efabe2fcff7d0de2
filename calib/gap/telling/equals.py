"""Other effects that are the same within the error of a re-estimated attitude: both are named.

Both accelerometers tilted read as both with an offset across gravity; while the vehicle hardly tilts, the two differ by
less than the attitude is known to. The noise of the samples would tell them apart, and it is not the noise that errs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis, summed
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term, predicted
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.schema import EffectEstimate, Rival
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_WITHIN = 2.0
"""Standard deviations of the reference's attitude within which two effects are the same, on every axis. Source:
decision 32, the same for amplitudes."""
_LEAST = 1e-3
"""Part of the largest reading across an axis below which none is believed to be known. Chosen, not measured: an
attitude is off in more than one way."""
_SAMPLES = 2000
"""Samples of a series that are compared. Chosen, not measured: it bounds the time, and both change slowly."""


def with_equals(effect: EffectEstimate, model: Model, term: Term | NoiseTerm) -> EffectEstimate:
    """`effect` with those that are the same within the reference's error; the probability is shared with them."""
    if isinstance(term, NoiseTerm) or term.effect.shared or term.effect.shape is not None:
        return effect
    if effect.sensor is Sensor.GYRO:  # a rate of turn does not depend on the attitude
        return effect
    view = _seen_in(model, term)
    if view is None:
        return effect
    same = [(rival, kappa) for rival, kappa in _same(term, view) if rival.id not in {t.effect.id for t in model.terms}]
    if not same:
        return effect
    listed = {rival.id for rival, _ in same}
    more = tuple(Rival(rival.id, kappa, 0.0, term.effect.fix) for rival, kappa in same)
    others = tuple(r for r in effect.confusable_with if r.id not in listed)
    evidence = replace(effect.evidence, probability=effect.evidence.probability / (1.0 + len(same)))
    return replace(effect, evidence=evidence, confusable_with=(*more, *others))


def _seen_in(model: Model, term: Term) -> View | None:
    """The series that has the reference's error, if the effect is on all units in it: no unit says otherwise then."""
    for view in model.setting.views:
        if term.hypothesis.touches(view) and view.reference_error and view.att_sd > 0.0 and not view.first:
            return view if set(term.hypothesis.instances) == set(view.weights) else None
    return None


def _same(term: Term, view: View) -> Iterator[tuple[CatalogueEffect, float]]:
    """Linear effects that are known to imitate it, or to be imitated, and the part of its energy that they take."""
    every = max(1, view.n // _SAMPLES)
    made = predicted(term, view)[::every]
    ideal = np.add.reduce([w * view.traces[i].ideal[view.keep] for i, w in view.weights.items()])[::every]
    across = np.sqrt(np.maximum((ideal**2).sum(axis=1, keepdims=True) - ideal**2, 0.0))
    weight = 1.0 / (view.att_sd * np.maximum(across, _LEAST * float(across.max())))
    for rival in by_id().values():
        known = rival.id in term.effect.rivals or term.effect.id in rival.rivals
        if not (known and isinstance(rival, MeanEffect) and rival.shape is None and rival.sensor is term.effect.sensor):
            continue
        own = next(iter(view.weights))
        if rival.missing(view.traces[own]) is not None:
            continue
        columns = summed(rival.columns, Hypothesis(rival, term.hypothesis.instances), np.nan, view)[:, ::every]
        left = made - _fitted(columns, made, weight)
        off = np.sqrt(((left * weight) ** 2).mean(axis=0))
        if float(off.max()) < _WITHIN:
            yield rival, 1.0 - float((left**2).sum() / max(float((made**2).sum()), 1e-300))


def _fitted(columns: Array, made: Array, weight: Array) -> Array:
    """What columns (p, n, 3) make of `made` (n, 3), by weighted least squares."""
    X = (columns * weight).reshape(len(columns), -1)
    found = np.linalg.lstsq(X.T, (made * weight).ravel(), rcond=1e-9)[0]
    return np.asarray(np.tensordot(found, columns, axes=1))
