"""Noise of a simulator that follows its motors: another flight with more of them has more of it, and that is no gap.

ArduPilot's SITL shakes the vehicle by a random force in proportion to the throttle (``Aircraft::add_noise``); its
inertial units sample that at their own moments, so that their difference has noise whose power goes with the square of
the throttle, and none on the ground.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.gap.likelihood import fit_amplitudes
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.noise import with_more
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_CHANCE = 1e-4
"""Chance of steady noise that seems to follow the motors."""
_FEWEST = 64  # samples that say something of noise


@dataclasses.dataclass(frozen=True, eq=False)
class Driven:
    """Noise of the difference of two instances: variance (3,) at motor power one, and its mean power in the flight."""

    variance: Array
    power: float


def motor_power(trace: Trace) -> Array | None:
    """Square of the mean motor output or, where there is none, of the throttle, (N,); None without either."""
    if trace.motors is not None:
        return np.asarray((np.maximum(trace.motors, 0.0) ** 2).mean(axis=1))
    return None if trace.throttle is None else np.asarray(np.maximum(trace.throttle, 0.0) ** 2)


def driven_by(nominal: Sequence[Trace]) -> dict[Sensor, Driven]:
    """By sensor what differences of instances in `nominal` recordings show; without those that show nothing."""
    found: dict[Sensor, list[Driven]] = {}
    for trace in nominal:
        if trace.against is not None and (one := _driven(trace)) is not None:
            found.setdefault(trace.sensor, []).append(one)
    return {
        sensor: Driven(np.mean([d.variance for d in each], axis=0), float(np.mean([d.power for d in each])))
        for sensor, each in found.items()
    }


def _driven(trace: Trace) -> Driven | None:
    power = motor_power(trace)
    rows = trace.observed
    if power is None or rows.sum() < _FEWEST or not power[rows].any():
        return None
    mean = float(power[rows].mean())
    residual = trace.residual[rows]
    return Driven(np.array([_variance(column, power[rows] / mean) / mean for column in residual.T]), mean)


def _variance(residual: Array, power: Array) -> float:
    """Part of the variance of `residual` (N,) that goes with `power` (N,) of mean one; 0 if none does."""
    squares = (residual - np.median(residual)) ** 2
    unit = float(squares.mean())
    if unit == 0.0:
        return 0.0
    none, ones = np.zeros(len(squares)), np.ones(len(squares))
    steady = fit_amplitudes(squares / unit, ones, none, [ones])
    both = fit_amplitudes(squares / unit, ones, none, [ones, power])
    follows = chdtrc(1, max(steady.deviance - both.deviance, 0.0)) < _CHANCE
    return unit * float(both.amplitudes[1]) if follows else 0.0


def as_driven(trace: Trace, found: Mapping[Sensor, Driven]) -> Trace:
    """`trace` with the noise expected that more power of its motors than in the nominal recordings makes."""
    driven, power = found.get(trace.sensor), motor_power(trace)
    if driven is None or power is None:
        return trace
    instances = 2.0 if trace.against is None else 1.0  # of a difference, two sensors have a half each
    more = driven.variance / instances * max(float(power[trace.observed].mean()) - driven.power, 0.0)
    return with_more(trace, more) if more.any() else trace
