"""How well the frequency of a line is known that is in the noise: by what the likelihood loses beside it."""

from __future__ import annotations

import math
from dataclasses import replace

from mavcal.calib.gap.model.joint import Model, NoiseTerm
from mavcal.calib.gap.model.noise_fit import AxisFit, densities_of, extra_rows, without_term
from mavcal.calib.gap.search.contest import noise_fits

_TWO_SD = 4.0
"""Twice the log-likelihood that is lost two standard errors from the best value. Source: chi-square of one degree."""
_FIRST = 2.0**-8
"""Part of a frequency by which the first one beside it differs. Chosen, not measured: a third of a hertz at 87 Hz."""
_FURTHEST = 1.0
"""Part of a frequency up to which one beside it is tried. Chosen, not measured: an octave up, and down to nothing."""


def frequency_sd(model: Model, term: NoiseTerm) -> float:
    """Standard error of the shape of a noise term, in its unit; infinite where any other within an octave is as likely.

    The amplitudes are fitted again at every frequency.
    """
    bare = without_term(model, term)
    fits = noise_fits(bare, term.hypothesis.effect.sensor)
    best = _deviance(bare, fits, term, term.theta)
    sides = [_side(bare, fits, term, best, sign) for sign in (-1.0, 1.0)]
    return max(sides)


def _side(bare: Model, fits: tuple[AxisFit, ...], term: NoiseTerm, best: float, sign: float) -> float:
    """Half of the distance at which two standard errors are lost, by doubling; infinite where they never are."""
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
