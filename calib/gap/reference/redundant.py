"""Instances of one vehicle against each other: a reference that needs neither attitude nor field."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.calibrated import TRIADS
from mavcal.calib.gap.reference.chosen import comparable
from mavcal.calib.gap.reference.denoised import denoised, error_sd
from mavcal.calib.gap.reference.ideal import Ideal, trace_of
from mavcal.calib.gap.reference.signal import Signal
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

_SMOOTH_S = 2.0  # over which a residual is averaged, for its slow part
_FASTER = 1.5  # times the rate of the other, from which on a unit is looked at when that has samples
_EDGE_S = 0.5  # from the ends of a trajectory, where the filters of the units reach beyond it


def differences(real: Recording, ideal: Ideal | None, single: tuple[Trace, ...]) -> tuple[Trace, ...]:
    """Every instance of a sensor that has several, against the one that is most like its reference.

    That one is found from the `single` traces; without them it is the one that is nearest to all others. Of two
    without a single trace nothing says which is at fault: the first is compared with the second.
    """
    made: list[Trace] = []
    for sensor in TRIADS:
        channels = comparable(real, sensor)
        if len(channels) < 2:
            continue
        base = _best(channels, _misfit(sensor, single))
        made += [_difference(c, channels[base], ideal, real) for i, c in sorted(channels.items()) if i != base]
    return tuple(trace for trace in made if trace.observed.sum() > 1)


def _difference(channel: Channel, base: Channel, ideal: Ideal | None, real: Recording) -> Trace:
    reading = Signal.of(base)
    assert reading is not None
    if _rate(channel) > _FASTER * _rate(base) and (faster := Signal.of(channel)) is not None:
        # Between the samples of a slow unit nobody knows how the vehicle moved.
        within = base.between(float(channel.t[0]), float(channel.t[-1]))
        channel = dataclasses.replace(channel, t=within.t, values=faster.at(within.t), zero_bin=None)
    trace = dataclasses.replace(trace_of(channel, reading, ideal, real), against=base.instance)
    if ideal is None:
        return _beside_movement(trace, channel, base, real)
    return dataclasses.replace(trace, observed=trace.observed & ~_contradicted(channel.sensor, ideal, trace.t))


def _beside_movement(trace: Trace, channel: Channel, base: Channel, real: Recording) -> Trace:
    """`trace` with the movement in the readings of `base` as ideal, and the same residual.

    Its own noise is in the residual too: what follows such a reading would seem to explain it.
    """
    found = denoised(base)
    if found is None:
        return trace
    moving = trace_of(channel, found.signal, None, real)
    if len(moving.t) != len(trace.t):
        return trace
    measured = moving.ideal + trace.residual
    return dataclasses.replace(trace, ideal=moving.ideal, measured=measured, ideal_sd=error_sd(found.noise))


def _rate(channel: Channel) -> float:
    return 1.0 / max(float(np.median(np.diff(channel.t))), 1e-9)


def _contradicted(sensor: Sensor, ideal: Ideal, t: Array) -> NDArray[np.bool_]:
    """Where a re-estimated trajectory does not believe its own inertial unit: in a crash no unit is a reference."""
    own = ideal.readings.get(sensor)
    if own is None or ideal.attitude is None or math.isinf(ideal.info.bandwidth_hz) or sensor is Sensor.MAG:
        return np.zeros(len(t), dtype=np.bool_)
    within = (t > ideal.attitude.t[0] + _EDGE_S) & (t < ideal.attitude.t[-1] - _EDGE_S)
    return np.asarray(within & ~own.known(t))


def _misfit(sensor: Sensor, single: tuple[Trace, ...]) -> dict[int, float]:
    """Mean square of the slow part of every instance's residual."""
    return {t.instances[0]: _slow_square(t.residual[t.observed], t.fs) for t in single if t.sensor == sensor}


def _slow_square(residual: Array, fs: float) -> float:
    smooth = uniform_filter1d(residual, max(1, round(_SMOOTH_S * fs)), axis=0)
    return float(np.mean(smooth**2))


def _best(channels: Mapping[int, Channel], misfit: Mapping[int, float]) -> int:
    if all(i in misfit for i in channels):
        return min(channels, key=lambda i: misfit[i])
    if len(channels) == 2:
        return max(channels)
    return min(channels, key=lambda i: sum(_apart(channels[i], other) for other in channels.values()))


def _apart(a: Channel, b: Channel) -> float:
    reading = Signal.of(b)
    assert reading is not None
    return float(np.mean(np.abs(reading.at(a.t) - a.values)))
