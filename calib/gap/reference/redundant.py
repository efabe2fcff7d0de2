"""Instances of one vehicle against each other: a reference that needs neither attitude nor field.

A difference d of two instances does not tell which of them has an error. Their mean s does, without any reference: half
of one instance's error is in s, so ``E[s d] = (var_1 - var_2) / 2``. This is the test of Pitman 1939 and Morgan 1939
for two variances of a correlated pair. The vehicle's movement is in s but not in d. Let X be the power of d above that
in the simulator's recording, in the band of the largest excess. There the excess of ``2 s d / X`` is 1 if the first
instance has the error and -1 if the second has it. It is 0 if both have it equally. In the lowest band, with too few
coefficients, the distance of both from the reference decides.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mavcal.calib.gap.likelihood import transform
from mavcal.calib.gap.problem import FaultyInstances, Trace
from mavcal.calib.gap.reference.channels import FASTER, SAME_RATE, SAME_SAMPLE, TRIADS, comparable_channels, rate_of
from mavcal.calib.gap.reference.ideal import Ideal, trace_of
from mavcal.calib.gap.reference.signals import Signal
from mavcal.calib.gap.reference.simulator import denoised, error_sd
from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]

_SMOOTH_S = 2.0
"""Averaging time, s, for the slow part of a residual. Chosen, not measured: vibration and noise average out."""
_EDGE_S = 0.5
"""Time, s, left out at the ends of a trajectory, where the units' filters reach beyond it. Chosen, not measured:
filters of a vehicle settle within as long."""


def differences(real: Recording, ideal: Ideal | None, single: tuple[Trace, ...]) -> tuple[Trace, ...]:
    """Traces of every instance of a sensor against the one nearest to its reference.

    That one is found from the `single` traces; without them it is the one nearest to all others. Of two instances
    without a single trace the first is compared with the second.
    """
    made: list[Trace] = []
    for sensor in TRIADS:
        channels = comparable_channels(real, sensor)
        if len(channels) < 2:
            continue
        base = _base_instance(channels, _misfit(sensor, single))
        made += [_difference(c, channels[base], ideal, real) for i, c in sorted(channels.items()) if i != base]
    return tuple(trace for trace in made if trace.observed.sum() > 1)


def _difference(channel: Channel, base: Channel, ideal: Ideal | None, real: Recording) -> Trace:
    reading = Signal.of(base)
    assert reading is not None
    if rate_of(channel) > FASTER * rate_of(base) and (faster := Signal.of(channel)) is not None:
        # The movement between the samples of a slow unit is unknown.
        within = base.between(float(channel.t[0]), float(channel.t[-1]))
        channel = dataclasses.replace(channel, t=within.t, values=faster.at(within.t), zero_bin=None)
    trace = dataclasses.replace(trace_of(channel, reading, ideal, real), against=base.instance)
    if ideal is None:
        return _with_movement_as_ideal(trace, channel, base, real)
    return dataclasses.replace(trace, observed=trace.observed & ~_contradicted_rows(channel.sensor, ideal, trace.t))


def _with_movement_as_ideal(trace: Trace, channel: Channel, base: Channel, real: Recording) -> Trace:
    """`trace` with the movement in the readings of `base` as the ideal reading, and the same residual.

    The noise of `base` is in the residual, so an effect in proportion to its noisy readings would seem to explain it.
    """
    found = denoised(base)
    if found is None:
        return trace
    movement = trace_of(channel, found.signal, None, real)
    if len(movement.t) != len(trace.t):
        return trace
    measured = movement.ideal + trace.residual
    return dataclasses.replace(trace, ideal=movement.ideal, measured=measured, ideal_sd=error_sd(found.noise))


def _contradicted_rows(sensor: Sensor, ideal: Ideal, t: Array) -> NDArray[np.bool_]:
    """Where a re-estimated trajectory contradicts its own inertial unit, as in a crash."""
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


def _base_instance(channels: Mapping[int, Channel], misfit: Mapping[int, float]) -> int:
    if all(i in misfit for i in channels):
        return min(channels, key=lambda i: misfit[i])
    if len(channels) == 2:
        return max(channels)
    return min(channels, key=lambda i: sum(_mean_distance(channels[i], other) for other in channels.values()))


def _mean_distance(a: Channel, b: Channel) -> float:
    reading = Signal.of(b)
    assert reading is not None
    return float(np.mean(np.abs(reading.at(a.t) - a.values)))


_SLOW = 8
"""Bins up to which the reference depends on position and field, and not on an inertial unit. Chosen, not measured: four
periods of a recording."""
_NEAR = 1.0 / 16.0
"""Power of an instance's residual, relative to that of the difference, below which it agrees with the reference.
Chosen, not measured: a quarter in amplitude."""
_SIDE, _BEYOND = 0.5, 1.5
"""Excess above which one instance alone has the error, and above which it follows the movement, as a scale error does.
Source: 1 or -1 if one instance has it, 0 if both have; the limits lie half-way."""
_SURE = 4.0
"""Standard errors by which the excess must differ from zero; half of them to conclude that both have it. Chosen, not
measured: one in 16 000 is as far by chance."""
_MORE = 4.0
"""Standard errors by which a band's power must exceed the simulator's. Chosen, not measured: one in 32 000 is as far
above by chance, and many bands are tested."""
_CONTROLLED_HZ = 20.0
"""Frequency, Hz, above which the vehicle does not respond to its gyroscope's noise: below, both units measure the
response. Chosen, not measured: rate controllers of copters have a bandwidth of 5 to 15 Hz."""
_LOUDER = 1.0
"""Least excess power of an instance, relative to the simulator's. Source: `prices.FLIGHT_NOISE_RATIO`, the same."""
_TILTS = 3.0
"""Standard deviations of the reference's tilt that may explain a horizontal difference of two accelerometers. Source:
decision 42 has the rule. Three is chosen, not measured: one in 370 is larger by chance, on one axis."""


def faulty_instances_of(
    real: Sequence[Trace], sim: Sequence[Trace] = (), tilt_sd: float = 0.0
) -> dict[Sensor, FaultyInstances]:
    """By sensor with two instances, which of them has an error; absent if undecided.

    Parameters
    ----------
    real
        Each instance against the reference that both share.
    sim
        The same of a simulator's recording.
    tilt_sd
        Standard deviation of the reference's attitude about an axis, rad, where it was re-estimated; else 0.
    """
    found = {}
    for sensor in dict.fromkeys(t.sensor for t in real):
        pair = _pair(real, sensor)
        if pair is None:
            continue
        fast = _instances_with_excess(pair, _pair(sim, sensor))
        if sensor is Sensor.ACCEL and _tilt_explains_difference(*pair, tilt_sd):
            worse = FaultyInstances(_along_gravity(*pair), fast, certain=True)
        else:
            worse = FaultyInstances(_instance_off_reference(*pair), fast)
        if worse.slow is not None or worse.fast is not None:
            found[sensor] = worse
    return found


def _pair(traces: Sequence[Trace], sensor: Sensor) -> tuple[Trace, Trace] | None:
    own = [t for t in traces if t.sensor is sensor and len(t.instances) == 1]
    return (own[0], own[1]) if len(own) == 2 and _have_same_times(own[0], own[1]) else None


def _have_same_times(one: Trace, other: Trace) -> bool:
    """Whether both were sampled at the same times, with common rows."""
    if len(one.t) != len(other.t) or float(np.abs(one.t - other.t).max(initial=0.0)) > SAME_SAMPLE / one.fs:
        return False
    return bool(_known(one, other).any())


def _instance_off_reference(one: Trace, other: Trace) -> tuple[int, ...] | None:
    """The instance that is off the reference while the other is not."""
    known = _known(one, other)
    return _off_reference((one, other), one.residual[known], other.residual[known])


def _tilt_explains_difference(one: Trace, other: Trace, tilt_sd: float) -> bool:
    """Whether a tilt of the reference may explain the horizontal difference of two accelerometers.

    The attitude follows one of them. If that one is wrong, the other seems to be, with the opposite sign.
    """
    known = _known(one, other)
    apart = one.residual[known] - other.residual[known]
    force = one.ideal[known]
    across = (apart - _along(apart, force)[:, None] * _direction(force)).mean(axis=0)
    return float(np.linalg.norm(across)) < _TILTS * tilt_sd * float(np.linalg.norm(force, axis=1).mean())


def _direction(force: Array) -> Array:
    """Unit vectors along a specific force (n, 3); zero in free fall."""
    size = np.linalg.norm(force, axis=1, keepdims=True)
    return np.asarray(np.divide(force, size, out=np.zeros_like(force), where=size > 0.0))


def _along(series: Array, force: Array) -> Array:
    """Component of a series (n, 3) along the specific force, (n,)."""
    return np.asarray((series * _direction(force)).sum(axis=1))


def _along_gravity(one: Trace, other: Trace) -> tuple[int, ...] | None:
    """The instance that is off the reference along gravity, which a tilt does not change to first order."""
    known = _known(one, other)
    first, second = (_along(t.residual[known], t.ideal[known])[:, None] for t in (one, other))
    return _off_reference((one, other), first, second)


def _off_reference(traces: tuple[Trace, Trace], first_left: Array, second_left: Array) -> tuple[int, ...] | None:
    """The instance with a large slow residual while the other's is small; residuals (n, axes)."""
    first, second = (_spectra(left)[:, :_SLOW] for left in (first_left, second_left))
    apart = float(((first - second) ** 2).sum())
    left = [float((second**2).sum()), float((first**2).sum())]
    for trace, of_other in zip(traces, left, strict=True):
        if of_other < _NEAR * apart:
            return trace.instances
    return None


@dataclass(frozen=True)
class _Band:
    """Two instances in a band: power of mean and difference, their product, and the count."""

    mean: float
    difference: float
    product: float
    count: int


def _instances_with_excess(real: tuple[Trace, Trace], sim: tuple[Trace, Trace] | None) -> tuple[int, ...] | None:
    """The instances with the largest excess of the difference beyond the simulator's recording."""
    if sim is not None and abs(math.log(real[0].fs / sim[0].fs)) > SAME_RATE:
        return None
    bands = _bands(*real)
    nominal_bands = _bands(*sim) if sim is not None else []
    nominal_bands += [_Band(0.0, 0.0, 0.0, 0)] * (len(bands) - len(nominal_bands))
    best, found, also = 0.0, None, False
    for k, (band, before) in enumerate(zip(bands, nominal_bands, strict=False)):
        excess = band.difference - before.difference
        chance = before.difference * math.sqrt(2.0 / band.count)
        if excess > _MORE * chance:
            if (energy := band.count * excess) > best:
                best, found = energy, _owner_of_excess(real, band, before, excess)
            also |= (
                sim is not None and 0.25 * real[0].fs / 2**k > _CONTROLLED_HZ and _quieter_is_louder_too(band, before)
            )
    return tuple(sorted(real[0].instances + real[1].instances)) if found and also else found


def _quieter_is_louder_too(band: _Band, before: _Band) -> bool:
    """Whether the quieter of two instances also has significantly more noise than the simulator's.

    One may have nine tenths of the excess while the other is still ten times too loud.
    """
    excess = band.difference - before.difference
    side = 2.0 * (band.product - before.product) / excess
    error = 2.0 * math.sqrt(band.mean * band.difference / band.count) / excess
    part = 0.5 * (1.0 - abs(side))
    return part > 0.5 * _SURE * error and part * excess > _LOUDER * 0.5 * before.difference


def _owner_of_excess(real: tuple[Trace, Trace], band: _Band, before: _Band, excess: float) -> tuple[int, ...] | None:
    side = 2.0 * (band.product - before.product) / excess
    error = 2.0 * math.sqrt(band.mean * band.difference / band.count) / excess
    if abs(side) > _BEYOND + error:
        return None
    if abs(side) > max(_SIDE, _SURE * error):
        return real[0 if side > 0.0 else 1].instances
    if abs(side) + 0.5 * _SURE * error < _SIDE:
        return tuple(sorted(real[0].instances + real[1].instances))
    return None


def _bands(one: Trace, other: Trace) -> list[_Band]:
    """Octave bands, the highest first."""
    known = _known(one, other)
    first, second = (_spectra(t.measured[known]) for t in (one, other))
    mean, difference = 0.5 * (first + second), first - second
    n = mean.shape[1]
    edges = [n // 2**k for k in range(max(int(math.log2(max(n / _SLOW, 1.0))), 0) + 1)]
    found = []
    for high, low in itertools.pairwise(edges):
        s, d = mean[:, low:high], difference[:, low:high]
        found.append(_Band(float((s**2).mean()), float((d**2).mean()), float((s * d).mean()), s.size))
    return found


def _known(one: Trace, other: Trace) -> NDArray[np.bool_]:
    finite = [np.isfinite(t.residual).all(axis=1) for t in (one, other)]
    return np.asarray(one.observed & other.observed & finite[0] & finite[1])


def _spectra(series: Array) -> Array:
    """Spectra of a series (n, axes), by axis (axes, n)."""
    return transform(np.ascontiguousarray(series.T))
