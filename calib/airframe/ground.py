"""Ground effect: thrust gained near the ground (AIRFRAME 2), judged on the rows of :mod:`calib.airframe.low`.

Cheeseman and Bennett (1955): thrust is multiplied by 1 / (1 - s / (4 z)^2), where z is the height of the rotors above
the ground. Strength (1 for a single rotor) and radius R act as one number, s = strength R^2, m2, and cannot be told
apart. Each pass over the ground has its own offsets of thrust and height.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, toeplitz
from scipy.special import expit, logsumexp

from mavcal.calib.airframe.answer import Domain
from mavcal.calib.airframe.found import FoundEffect, FoundValue
from mavcal.calib.airframe.low import CALM_M, LEGS_M, MEMORY_S, NEAR_M, LowFlight, NearGround, Pass, low_flight
from mavcal.calib.airframe.pair import Side
from mavcal.calib.airframe.testable import Missing
from mavcal.calib.airframe.words import FIXES

Array = NDArray[np.float64]

ID: Final = "ground_effect"
NEED: Final = FIXES[ID]
TOLD_AT_M: Final = 0.25
"""Rotor height at which the gain is reported, m. Chosen, not measured: two radii of a 10-inch propeller."""
LEAST_S: Final = 1.0
"""Least time near the ground, s. Chosen, not measured: a landing at 0.4 m/s."""
USUAL: Final = 0.03
"""s of a typical vehicle, m2: 10-inch propellers and a strength of 2. Source: AIRFRAME 2, several rotors have more than
one (Sanchez-Cuevas 2017)."""
_SHOWN: Final = 8.0
"""Evidence, nats, that the typical s would give in a flight, for its absence to count. Source: naming an effect takes
log(0.9 / 0.1 / 0.05) = 5.2 nats beyond the Occam factor."""
_NAMED: Final = 0.5
"""Probability above which an answer counts in a noisier flight as well. Source: even odds."""
_STRENGTH_SD: Final = 0.06
"""Prior standard deviation of s if the effect is present, m2. Source: twice the typical value."""
_STRENGTHS: Final = np.concatenate([[0.0], np.geomspace(5e-4, 0.4, 90)])
_LEGS: Final = 13
_LEAST_LEGS_M: Final = 0.04
"""Number of rotor heights tried for each pass, and the lowest of them, m."""
_OFFSET: Final = 0.01
"""Standard deviation of a pass's relative offset of thrust, from voltage and wind. Chosen, not measured."""


@dataclass(frozen=True)
class GroundEffect:
    """Thrust gain at :data:`TOLD_AT_M`, real and simulated, and the difference with its error."""

    real: float
    sim: float
    value: float
    sd: float
    nats: float
    probability: float

    def told(self) -> FoundEffect:
        """The ground effect as an effect of the report."""
        value = FoundValue("a", self.value, self.sd, "1", real=self.real, sim=self.sim)
        return FoundEffect(ID, Domain.AIRFRAME, (), (value,), max(self.nats, 0.0), 1, self.probability, 0.0)


def gain_at(s: float, height: Array) -> Array:
    """Relative thrust gain with the rotors `height` m above the ground; held below half a radius."""
    near = s / (4.0 * np.maximum(height, 0.5 * np.sqrt(s) + 1e-3)) ** 2
    return np.asarray(1.0 / (1.0 - near) - 1.0)


def loglik(low: LowFlight) -> Array:
    """Log-likelihood of each strength of the grid."""
    return np.asarray(sum((_of_pass(low, p) for p in low.passes), np.zeros(len(_STRENGTHS))))


def power(low: LowFlight) -> float:
    """Evidence, nats, that the typical strength would give."""
    shapes = [gain_at(USUAL, p.height + LEGS_M[0]) for p in low.passes]
    return sum(0.5 * float(shape @ cho_solve(_root(low, len(shape)), shape)) for shape in shapes)


def _root(low: LowFlight, rows: int) -> tuple[Array, bool]:
    noise = np.zeros(rows)
    noise[: len(low.noise)] = low.noise[:rows]
    root, lower = cho_factor(toeplitz(noise) + _OFFSET**2, lower=True)
    return np.asarray(root), bool(lower)


def _of_pass(low: LowFlight, one: Pass) -> Array:
    root = _root(low, len(one.gain))
    mean, sd = LEGS_M[0], float(np.hypot(LEGS_M[1], low.height_sd))
    legs = np.linspace(max(mean - 2.5 * sd, _LEAST_LEGS_M), mean + 2.5 * sd, _LEGS)
    weight = -0.5 * ((legs - mean) / sd) ** 2
    weight -= logsumexp(weight)
    found = []
    for s in _STRENGTHS:
        off = one.gain - gain_at(float(s), one.height + legs[:, None])
        found.append(float(logsumexp(weight - 0.5 * np.einsum("kn,nk->k", off, cho_solve(root, off.T)))))
    return np.array(found)


def compared(real: LowFlight, sim: LowFlight, odds: float) -> GroundEffect:
    """Comparison of one strength for both flights with one for each.

    A priori each flight has none, or one of about :data:`_STRENGTH_SD`, with even odds.
    """
    prior, ours, theirs = _prior(), loglik(real), loglik(sim)
    alike = float(logsumexp(prior + ours + theirs))
    apart = (prior + ours)[:, None] + (prior + theirs)[None, :]
    apart[0, 0] = -np.inf  # none in either is no difference
    own = float(logsumexp(apart))
    weight = np.exp(apart - own)
    gains = np.array([float(gain_at(float(s), np.array([TOLD_AT_M]))[0]) for s in _STRENGTHS])
    difference = gains[:, None] - gains[None, :]
    value = float((weight * difference).sum())
    sd = float(np.sqrt((weight * (difference - value) ** 2).sum()))
    here, there = (float(weight.sum(axis=k) @ gains) for k in (1, 0))
    nats = own - float(np.log1p(-np.exp(2.0 * prior[0]))) - alike
    return GroundEffect(here, there, value, sd, nats, float(expit(nats + np.log(odds))))


def _prior() -> Array:
    """Log of the prior of the strengths of the grid."""
    prior = -0.5 * (_STRENGTHS / _STRENGTH_SD) ** 2 + np.log(np.gradient(_STRENGTHS))
    prior[0] = -np.inf
    prior -= logsumexp(prior) + np.log(2.0)
    prior[0] = -np.log(2.0)
    return np.asarray(prior)


def ground_gap(
    real: tuple[NearGround | None, Side], sim: tuple[NearGround | None, Side], odds: float
) -> GroundEffect | Missing:
    """Thrust gained near the ground, real beside simulated, or why these flights cannot show it."""
    low = {}
    for which, (near, side) in (("real", real), ("simulated", sim)):
        if near is None:
            return Missing(ID, f"the {which} flight logs no height", NEED)
        found = low_flight(near, side.likelihood.airframe, side.fit.theta)
        if found is None:
            reason = f"the {which} vehicle hovers for less than {2.0 * MEMORY_S:.0f} s above {CALM_M:.0f} m"
            return Missing(ID, reason, NEED)
        if found.low_s < LEAST_S:
            reason = f"the {which} vehicle flies {found.low_s:.1f} s with its rotors below {NEAR_M} m"
            return Missing(ID, reason, NEED)
        low[which] = found
    answer = compared(low["real"], low["simulated"], odds)
    loud = min(low, key=lambda which: power(low[which]))
    if answer.probability < _NAMED and power(low[loud]) < _SHOWN:
        reason = f"the {loud} vehicle's thrust is too noisy near the ground to show a gain of 3 %"
        return Missing(ID, reason, f"{NEED}, in calm air")
    return answer
