"""Parameters without a useful derivative: the time of a load change, and the rate limit of a motor's command.

Both are searched for on a grid, and the flight is then fitted with the best value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mavcal.calib.airframe.effects import AirframeEffect
from mavcal.calib.airframe.fit import FlightLikelihood
from mavcal.calib.airframe.pair import PairEvidence, Side, about

Array = NDArray[np.float64]

_SMOOTH_S: Final = 0.5
_EDGE_S: Final = 5.0
"""Time, s, at both ends of a flight without a search for a step. Chosen, not measured: a hover of some seconds."""
_LEAST_STEP: Final = 0.01
"""Least step, as a fraction of the mass. Source: a third of the smallest step in AIRFRAME 6."""
_RATES: Final = (6.0, 4.0, 3.0, 2.5, 2.0, 1.7, 1.4, 1.2, 1.0, 0.8, 0.6, 0.5, 0.4)
"""Rate limits that are tried, 1/s. Source: the range of AIRFRAME 6, 0.5 to 4, and beyond."""
_REACHED: Final = 99.8
"""Percentile of the commands' own rates that a visible limit lies below. Chosen, not measured."""
_SPREADS: Final = (0.15, 0.05)
"""Relative steps of the refinement of a limit, one after the other. Source: the grid's own steps."""
_WORTH: Final = 10.0
"""Nats that a limit must gain before the flight is fitted with it. Chosen, not measured: the contest decides."""
_LOST: Final = 3
"""Consecutive limits that must lose likelihood before slower ones are skipped. Source: even too high a limit helps."""


def with_load(likelihood: FlightLikelihood, theta: Array) -> FlightLikelihood:
    """The flight with a step of its mass allowed, at the time that fits the vertical force best."""
    flight = likelihood.airframe.flight
    predicted, _ = likelihood.airframe.predicted(theta)
    width = max(round(_SMOOTH_S * flight.fs), 1)
    down, told = (uniform_filter1d(x[:, 2], width) for x in (flight.force, predicted))
    rows = np.flatnonzero(likelihood.usable)
    ratio = down[rows] / told[rows] - 1.0
    edge = round(_EDGE_S * flight.fs)
    if len(ratio) < 4 * edge:
        return likelihood
    count = np.arange(1, len(ratio))
    before = np.cumsum(ratio)[:-1] / count
    after = (ratio.sum() - np.cumsum(ratio)[:-1]) / (len(ratio) - count)
    gain = count * (len(ratio) - count) * (before - after) ** 2
    gain[:edge] = gain[-edge:] = 0.0
    most = int(gain.argmax())
    if abs(before[most] - after[most]) < _LEAST_STEP:
        return likelihood
    at = float(flight.t[rows[most + 1]])
    return _changed(likelihood, loaded_at=at)


def with_limit(side: Side, sim: Side, effects: Sequence[AirframeEffect]) -> tuple[Side, float] | None:
    """The real flight with its best rate limit, and the limit, 1/s; None: no limit is reached.

    Limits are compared with the simulator's airframe in the real flight's wind. A fit without a limit, or with a wrong
    one, would compensate for it. `effects` may be present as well.
    """
    likelihood = side.likelihood
    told = likelihood.airframe.flight.commands
    fastest = float(np.percentile(np.abs(np.diff(told.c, axis=0)) * told.rate_hz, _REACHED))
    tried = [r for r in _RATES if r < fastest]
    if not tried or not likelihood.torque:
        return None
    of_day = np.array([name.startswith("wind_") for name in side.fit.layout.names])
    theta = np.where(sim.own | of_day, side.fit.theta, sim.fit.theta)
    theta[len(theta) - len(likelihood.airframe.free) :] = 0.0
    free, found = likelihood.loglik(theta, side.fit.spectra), {}
    for rate in tried:
        found[rate] = _changed(likelihood, slew=rate).loglik(theta, side.fit.spectra)
        if max(found.values()) < free and len(found) >= _LOST:
            return None
    best = max(found, key=lambda rate: found[rate])
    if found[best] - free < _WORTH:
        return None
    pair = PairEvidence(side, sim, tuple(effects))
    known: dict[float, float] = {}
    for spread in _SPREADS:
        rates = [best * (1.0 - spread), best, best * (1.0 + spread)]
        for rate in rates:
            if rate not in known:
                made = about(Side(_changed(likelihood, slew=rate), side.fit), theta)
                known[rate] = _evidence(replace(pair, slewed=made))
        best = _vertex(rates, [known[rate] for rate in rates])
    return about(Side(_changed(likelihood, slew=best), side.fit), theta), best


def _evidence(pair: PairEvidence) -> float:
    """Evidence of the limit alone, or of the limit with the one effect that helps most."""
    limit = next(e.block for e in pair.effects if e.slew)
    lone = [frozenset({limit, e.block}) for e in pair.effects if not e.slew and e.exclusive != "motor_lag"]
    return max(pair.posterior(model).log_evidence for model in (frozenset({limit}), *lone))


def _vertex(rates: Sequence[float], values: Sequence[float]) -> float:
    """Where a parabola through three evenly spaced points is highest, or the highest of them."""
    most = int(np.argmax(values))
    bend = values[0] - 2.0 * values[1] + values[2]
    if bend >= 0.0 or most != 1:
        return rates[most]
    return float(rates[1] - 0.5 * (rates[2] - rates[1]) * (values[2] - values[0]) / bend)


def _changed(likelihood: FlightLikelihood, **changes: float) -> FlightLikelihood:
    return FlightLikelihood(likelihood.airframe.changed(**changes), likelihood.usable, torque=likelihood.torque)
