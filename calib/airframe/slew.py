"""A limit on how fast a motor's command may change: an exact shape, found on a grid and then refined (AIRFRAME 4.1)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.fit import FlightLikelihood, expanded
from mavcal.calib.airframe.pair import Side, by_itself

Array = NDArray[np.float64]

_RATES: Final = (6.0, 4.0, 3.0, 2.5, 2.0, 1.7, 1.4, 1.2, 1.0, 0.8, 0.6, 0.5, 0.4)
"""Limits that are tried, 1/s. Source: the range of AIRFRAME 6, 0.5 to 4, and beyond."""
_REACHED: Final = 99.8
"""Percentile of the commands' own rates that a limit has to lie below so that it shows. Chosen, not measured."""
_SPREADS: Final = (0.15, 0.08)
"""Parts of a limit by which it is refined, each about a flight that was fitted again. Source: the grid's own steps."""
_ROUNDS: Final = 4
_WORTH: Final = 10.0
"""Nats that a limit must gain before the flight is fitted with it. Chosen, not measured: the contest decides."""


def with_limit(side: Side, sim: Side) -> tuple[Side, float] | None:
    """The real flight's side with the rate limit that suits it best, and the limit, 1/s; None: none is reached.

    Limits are compared at the simulator's own airframe: a fit without a limit has lost it already.
    """
    likelihood = side.likelihood
    airframe = likelihood.airframe
    rates = np.abs(np.diff(airframe.flight.c, axis=0)) * airframe.flight.fs
    fastest = float(np.percentile(rates, _REACHED))
    tried = [r for r in _RATES if r < fastest]
    if not tried or not likelihood.torque:
        return None
    theta = np.where(sim.own, side.fit.theta, sim.fit.theta)
    free = likelihood.airframe.layout
    theta[len(theta) - len(free.free) :] = 0.0

    found = {rate: _limited(likelihood, rate).loglik(theta, side.fit.spectra) for rate in tried}
    best = max(found, key=lambda rate: found[rate])
    if found[best] - likelihood.loglik(theta, side.fit.spectra) < _WORTH:
        return None
    for spread in _SPREADS:
        best, theta = _better(likelihood, theta, side, best, spread)
    made = _limited(likelihood, best)
    return Side(made, expanded(made, by_itself(made, theta), made.possible)), best


def _better(likelihood: FlightLikelihood, theta: Array, side: Side, best: float, spread: float) -> tuple[float, Array]:
    """The limit of most likelihood within `spread` of the best one, and the airframe that was fitted with it.

    Each limit is compared with an airframe of its own: gains and damping make up for a part of a wrong one.
    """
    rates = [best * (1.0 - spread), best, best * (1.0 + spread)]
    limited = [_limited(likelihood, rate) for rate in rates]
    fitted = [by_itself(one, theta, _ROUNDS) for one in limited]
    gains = [one.loglik(at, side.fit.spectra) for one, at in zip(limited, fitted, strict=True)]
    most = int(np.argmax(gains))
    bend = gains[0] - 2.0 * gains[1] + gains[2]
    if bend >= 0.0 or most != 1:
        return rates[most], fitted[most]
    return float(best - 0.5 * best * spread * (gains[2] - gains[0]) / bend), fitted[1]


def _limited(likelihood: FlightLikelihood, rate: float | None) -> FlightLikelihood:
    return FlightLikelihood(likelihood.airframe.changed(slew=rate), likelihood.usable, torque=likelihood.torque)
