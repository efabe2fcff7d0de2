"""Parameters of the effects of a model, in the names and units of the catalogue, with their errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.gap.effects.base import EffectParameter
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.effects.vibration import mean_speed
from mavcal.calib.gap.model.joint import Model, NoiseTerm, Term
from mavcal.calib.gap.model.noise_fit import AxisFit, NoiseEstimate, densities_of, extra_rows, without_term
from mavcal.calib.gap.model.normal_equations import solved
from mavcal.calib.gap.schema import ParameterEstimate
from mavcal.calib.gap.search.added_noise import line_amplitudes
from mavcal.calib.gap.search.contest import noise_fits
from mavcal.calib.gap.search.selection import ChosenModel
from mavcal.calib.gap.unknown.transitions import jump_moment, level_mismatch
from mavcal.calib.gap.worth.attitude_error import variance_from_attitude

Array = NDArray[np.float64]

_Z = 1.959964
"""Standard errors from an estimate to either end of its 95 % interval. Source: quantile 0.975 of the normal
distribution."""
_FREE = 1e-4
"""Component of a parameter in undetermined directions above which its error is infinite. Source: numerical; far above
rounding, and too small to matter."""


_SIGNIFICANT = 3.0
"""Standard errors beyond which a step contradicts the levels beside it. Chosen, not measured: one step in 370 is
further off by chance."""


def estimates_of(chosen: ChosenModel, term: Term | NoiseTerm, widening: float = 1.0) -> tuple[ParameterEstimate, ...]:
    """Parameters of one effect, the shape last.

    Standard errors on the mean are `widening` times those of the noise, plus those of the reference's attitude
    (:mod:`calib.gap.worth.attitude_error`). A step has at least the error of its level mismatch, and its moment at
    least that of the sample interval.
    """
    if isinstance(term, NoiseTerm):
        found = chosen.noise.estimates[term.hypothesis.key]
        if Trait.LINE in term.hypothesis.effect.traits:
            values, se = line_amplitudes(term, chosen.model)
            found = NoiseEstimate(values[None], se[None])
        return _of_noise(term, found, chosen)
    i = chosen.model.terms.index(term)
    rows = chosen.joint.slices[i]
    covariance, gram = _with_fixed_temperatures(chosen)
    variance = np.diag(covariance)[rows].copy()
    variance[_undetermined(gram)[rows]] = math.inf
    effect = term.effect
    names = effect.parameters if effect.shape is None else (*effect.parameters, effect.shape.parameter)
    se = np.hypot(widening * np.sqrt(variance), np.sqrt(variance_from_attitude(chosen.model, chosen.joint)[rows]))
    values = term.values.copy()
    if effect.jumps:
        apart = level_mismatch(chosen.model, term)
        se[:3] = np.where(apart > _SIGNIFICANT * se[:3], np.hypot(se[:3], apart), se[:3])
        if effect.discontinuous:
            values[-1], between = jump_moment(chosen.model, term)
            se[-1] = math.hypot(se[-1], between)
    return tuple(
        _estimate(name, float(value), float(error)) for name, value, error in zip(names, values, se, strict=True)
    )


def _estimate(parameter: EffectParameter, value: float, se: float) -> ParameterEstimate:
    return ParameterEstimate(parameter.name, value, se, (value - _Z * se, value + _Z * se), parameter.unit)


def _of_noise(term: NoiseTerm, found: NoiseEstimate, chosen: ChosenModel) -> tuple[ParameterEstimate, ...]:
    effect = term.hypothesis.effect
    made = []
    for parameter, value, se in zip(effect.parameters, found.values.ravel(), found.se.ravel(), strict=True):
        if not parameter.squared:
            made.append(_estimate(parameter, float(value), float(se)))
            continue
        root = math.sqrt(max(float(value), 0.0))
        low, high = (math.sqrt(max(float(value) + sign * _Z * float(se), 0.0)) for sign in (-1.0, 1.0))
        made.append(ParameterEstimate(parameter.name, root, (high - low) / (2.0 * _Z), (low, high), parameter.unit))
    if effect.shape is not None:
        made.append(_estimate(effect.shape.parameter, term.theta, frequency_sd(chosen.model, term)))
    return tuple(made)


def _with_fixed_temperatures(chosen: ChosenModel) -> tuple[Array, Array]:
    """Covariance and Gram matrix of all amplitudes, with undetermined reference temperatures fixed.

    Beside a free offset the temperature at which a drift vanishes is arbitrary, since the offset compensates it. The
    fitted one is kept without an error.
    """
    joint = chosen.joint
    hidden = _undetermined(joint.normal.gram)
    stated = [
        rows.stop - 1
        for term, rows in zip(chosen.model.terms, joint.slices, strict=False)
        if term.effect.shape is not None and term.effect.shape.chosen and hidden[rows.stop - 1]
    ]
    if not stated:
        return joint.covariance, joint.normal.gram
    gram = joint.normal.gram.copy()
    gram[stated], gram[:, stated] = 0.0, 0.0
    count = len(joint.covariance)
    free = [k for k in range(count) if k not in stated]
    covariance = np.zeros_like(joint.covariance)
    covariance[np.ix_(free, free)] = solved(gram[np.ix_(free, free)], np.zeros(len(free)))[1]
    gram[stated, stated] = 1.0  # it is known
    return covariance, gram


def _undetermined(gram: Array) -> NDArray[np.bool_]:
    """Which parameters have a part in a direction without information."""
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    hidden = vectors[:, values <= 1e-9 * max(len(values), 1)]
    return np.asarray((hidden**2).sum(axis=1) > _FREE)


_TWO_SD = 4.0
"""Twice the log-likelihood that is lost two standard errors from the best value. Source: chi-square of one degree."""
_FIRST = 2.0**-8
"""First relative step from a frequency. Chosen, not measured: a third of a hertz at 87 Hz."""
_FURTHEST = 1.0
"""Largest relative distance tried from a frequency. Chosen, not measured: an octave up, and down to nothing."""


def frequency_sd(model: Model, term: NoiseTerm) -> float:
    """Standard error of the shape of a noise term; infinite if no value within an octave is excluded.

    Also infinite for a line at either end of the tried frequencies: power that rises up to the Nyquist frequency is not
    a line. Amplitudes are fitted again at every frequency.
    """
    if _at_an_end(model, term):
        return math.inf
    bare = without_term(model, term)
    fits = noise_fits(bare, term.hypothesis.effect.sensor)
    best = _deviance(bare, fits, term, term.theta)
    sides = [_sd_on_side(bare, fits, term, best, sign) for sign in (-1.0, 1.0)]
    return max(sides)


def _at_an_end(model: Model, term: NoiseTerm) -> bool:
    shape = term.hypothesis.effect.shape
    assert shape is not None
    if shape.screen is None:  # values that were given, and no range
        return False
    traces = [t for view in model.setting.views if term.hypothesis.touches(view) for t in view.traces.values()]
    tried = [grid for trace in traces if mean_speed(trace) == 0.0 and len(grid := shape.grid(trace))]
    return bool(tried) and not min(g[0] for g in tried) < term.theta < max(g[-1] for g in tried)


def _sd_on_side(bare: Model, fits: tuple[AxisFit, ...], term: NoiseTerm, best: float, sign: float) -> float:
    """Half of the distance at which the likelihood falls by two standard errors; infinite if it never does."""
    part, before = _FIRST, (0.0, 0.0)
    while part < _FURTHEST:
        lost = _deviance(bare, fits, term, term.theta * (1.0 + sign * part)) - best
        if lost >= _TWO_SD:
            low, there = before
            rise = (_TWO_SD - there) / max(lost - there, 1e-300)
            return 0.5 * term.theta * (low + (part - low) * math.sqrt(min(max(rise, 0.0), 1.0)))
        part, before = 2.0 * part, (part, max(lost, 0.0))
    return math.inf


def _deviance(bare: Model, fits: tuple[AxisFit, ...], term: NoiseTerm, theta: float) -> float:
    """``-2 log L`` of a sensor's axes with the line at `theta`."""
    own = replace(term, theta=theta)
    by_view = {
        v: densities_of(own.hypothesis, view, theta)
        for v, view in enumerate(bare.setting.views)
        if own.hypothesis.touches(view)
    }
    return sum(fit.fitted(extra_rows(bare, fit, by_view))[1] for fit in fits)
