"""Effects that these data cannot tell from something else, and how the report names them.

A parameter without a finite error may have any value. An effect within the error of a re-estimated attitude may be that
error. It stays in the model, so that no other effect absorbs it, but is not reported. Two effects that differ by less
than that error are both named: two tilted accelerometers read like two with a horizontal offset.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.effects.base import CatalogueEffect, MeanEffect
from mavcal.calib.gap.model.hypotheses import Hypothesis, Key, columns_in
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term, predicted
from mavcal.calib.gap.model.views import View
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.schema import EffectEstimate, ParameterEstimate, Rival
from mavcal.calib.gap.search.selection import ChosenModel
from mavcal.calib.gap.search.terms import member_of
from mavcal.calib.gap.telling.estimates import estimates_of
from mavcal.calib.gap.unknown.verdict import UnnamedCause
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]


def is_bounded(params: Iterable[ParameterEstimate]) -> bool:
    """Whether all parameters are finite with finite errors."""
    return all(math.isfinite(p.value) and math.isfinite(p.se) for p in params)


def unbounded_parameters(chosen: ChosenModel) -> dict[Key, str]:
    """Named effects with a parameter without a finite error, and the names of those parameters."""
    found = {}
    for term in chosen.model.members:
        if term.hypothesis.effect.nameless:
            continue
        loose = [p.name for p in estimates_of(chosen, term) if not is_bounded([p])]
        if loose:
            found[term.hypothesis.key] = ", ".join(loose)
    return found


def unbounded_causes(chosen: ChosenModel, reported: Collection[Key]) -> Iterator[UnnamedCause]:
    """Unnamed causes in place of `reported` effects with unbounded parameters."""
    for key, names in unbounded_parameters(chosen).items():
        if key in reported:
            effect = member_of(chosen.model, key).hypothesis.effect
            like = f"a difference on {effect.sensor.value} like {effect.plain}"
            yield UnnamedCause((key,), f"{like}, whose {names} these data do not bound")


_ERRORS = 2.0
"""Least size of one amplitude of an effect, in standard errors. Source: decision 32."""


def inseparable(chosen: ChosenModel, reference: ReferenceInfo) -> frozenset[Key]:
    """Named effects on the mean without an amplitude beyond two standard errors, those of the attitude included."""
    if reference.kind is not ReferenceKind.ESTIMATOR:
        return frozenset()
    return frozenset(_within_error(chosen))


def _within_error(chosen: ChosenModel) -> Iterator[Key]:
    for term in chosen.model.terms:
        effect = term.effect
        if effect.nameless or effect.fixed or not effect.parameters:
            continue
        amplitudes = estimates_of(chosen, term)[: len(effect.parameters)]
        if not any(map(_exceeds_error, amplitudes)):
            yield term.hypothesis.key


def _exceeds_error(amplitude: ParameterEstimate) -> bool:
    """Whether an amplitude exceeds its error, or has no error by itself."""
    return not math.isfinite(amplitude.se) or abs(amplitude.value) > _ERRORS * amplitude.se


def inseparable_notice(ids: Collection[str]) -> tuple[str, ...]:
    """A notice of the effects; empty without any."""
    names = ", ".join(dict.fromkeys(ids))
    return (f"small, not separable from the reference's error: {names}",) if names else ()


_WITHIN = 4.0
"""Standard deviations of the reference within which two effects are the same, on every axis. Source: the wrong one of
two so far apart is nearer in 2 of 100 (normal distribution)."""
_LEAST = 1e-3
"""Least error of a reading, relative to the largest reading perpendicular to an axis. Chosen, not measured: an attitude
has errors of several kinds."""
_SAMPLES = 2000
"""Samples of a series that are compared. Chosen, not measured: it bounds the time, and both change slowly."""


def with_equal_effects(effect: EffectEstimate, model: Model, term: Term | NoiseTerm) -> EffectEstimate:
    """`effect` with those that are equal within the reference's error as rivals, sharing its probability."""
    if isinstance(term, NoiseTerm) or term.effect.shared or term.effect.shape is not None:
        return effect
    if effect.sensor is Sensor.GYRO:  # a rate of turn does not depend on the attitude
        return effect
    view = _series_with_error(model, term)
    if view is None:
        return effect
    same = [
        (rival, kappa)
        for rival, kappa in _equal_effects(term, view)
        if rival.id not in {t.effect.id for t in model.terms}
    ]
    if not same:
        return effect
    listed = {rival.id for rival, _ in same}
    more = tuple(Rival(rival.id, kappa, 0.0, term.effect.fix) for rival, kappa in same)
    others = tuple(r for r in effect.confusable_with if r.id not in listed)
    evidence = replace(effect.evidence, probability=effect.evidence.probability / (1.0 + len(same)))
    return replace(effect, evidence=evidence, confusable_with=(*more, *others))


def _series_with_error(model: Model, term: Term) -> View | None:
    """The series with the reference's error, if the effect is on all units of its sensor; otherwise None."""
    views = (view for view in model.setting.views if view.sensor is term.effect.sensor)
    if {unit for view in views for unit in view.weights} != set(term.hypothesis.instances):
        return None
    for view in model.setting.views:
        if term.hypothesis.touches(view) and view.reference_error and view.att_sd > 0.0 and not view.first:
            return view if set(view.weights) <= set(term.hypothesis.instances) else None
    return None


def _equal_effects(term: Term, view: View) -> Iterator[tuple[CatalogueEffect, float]]:
    """Linear rivals equal to the effect within the reference's error, and the part of its energy that they imitate."""
    every = max(1, view.n // _SAMPLES)
    made = predicted(term, view)[::every]
    ideal = view.ideal[::every]
    across = np.sqrt(np.maximum((ideal**2).sum(axis=1, keepdims=True) - ideal**2, 0.0))
    tilted = view.att_sd * np.maximum(across, _LEAST * float(across.max()))
    scales = np.array(view.inside_sd) if view.sensor is Sensor.ACCEL and view.inside_sd else np.zeros(3)
    weight = 1.0 / np.hypot(tilted, scales * (ideal - ideal.mean(axis=0)))
    for rival in by_id().values():
        known = rival.id in term.effect.rivals or term.effect.id in rival.rivals
        if not (known and isinstance(rival, MeanEffect) and rival.shape is None and rival.sensor is term.effect.sensor):
            continue
        own = next(iter(view.weights))
        if rival.missing(view.traces[own]) is not None:
            continue
        columns = columns_in(rival.columns, Hypothesis(rival, term.hypothesis.instances), np.nan, view)[:, ::every]
        left = made - _best_fit(columns, made, weight)
        off = np.sqrt(((left * weight) ** 2).mean(axis=0))
        if float(off.max()) < _WITHIN:
            yield rival, 1.0 - float((left**2).sum() / max(float((made**2).sum()), 1e-300))


def _best_fit(columns: Array, made: Array, weight: Array) -> Array:
    """Weighted least-squares fit of columns (p, n, 3) to `made` (n, 3)."""
    X = (columns * weight).reshape(len(columns), -1)
    found = np.linalg.lstsq(X.T, (made * weight).ravel(), rcond=1e-9)[0]
    return np.asarray(np.tensordot(found, columns, axes=1))
