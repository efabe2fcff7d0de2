"""A load that is dropped or taken up in flight: the moment at which thrust and force part."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mavcal.calib.airframe.fit import FlightLikelihood

Array = NDArray[np.float64]

_SMOOTH_S: Final = 0.5
_EDGE_S: Final = 5.0
"""A step so near to either end of a flight is told from nothing. Chosen, not measured: a hover of some seconds."""
_LEAST: Final = 0.01
"""Part of the mass below which a step is not looked at. Source: a third of the least that AIRFRAME 6 asks for."""


def with_load(likelihood: FlightLikelihood, theta: Array) -> FlightLikelihood:
    """The same flight with a step of its mass allowed at the moment where it suits the vertical force best."""
    airframe = likelihood.airframe
    flight = airframe.flight
    predicted, _ = airframe.predicted(theta)
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
    if abs(before[most] - after[most]) < _LEAST:
        return likelihood
    at = float(flight.t[rows[most + 1]])
    return FlightLikelihood(airframe.changed(loaded_at=at), likelihood.usable, torque=likelihood.torque)
