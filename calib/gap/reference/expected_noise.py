"""Noise that a recording is expected to have because it flies differently from the nominal recordings.

Motors: ArduPilot's SITL shakes the vehicle by a random force proportional to the throttle (``Aircraft::add_noise``).
Its inertial units sample that force at different times. The power of their difference is proportional to the square of
the throttle, and zero on the ground.

Movement: a pose errs by a fraction of the movement. Time-stamp jitter, flexible markers and a bending body leave a
residual proportional to the movement at each frequency, without a fixed phase. Example: 2 ms of jitter are 6 % of a
movement at 5 Hz. A nominal recording shows that share, together with the sensor's own noise.

Age of samples: a log writes the latest sample of every unit under one time stamp. Each is older by up to a period of
its own driver (SITL runs its inertial units at 1000 and 760 Hz). The difference of two units then has noise in
proportion to the rate of change of the reading, which no stationary spectrum describes. A nominal recording shows the
variance of that age. Samples in which it exceeds the other noise are left out; in the others it is expected. A single
unit beside the trajectory of its vehicle has the same noise, with the spectrum of the driver's beats.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from mavcal.calib.gap.likelihood import AmplitudeFit, fit_amplitudes
from mavcal.calib.gap.problem import ReferenceInfo, Trace
from mavcal.calib.gap.reference.noise import (
    FEWEST,
    UNSTEADY,
    ResidualSpectrum,
    learned_spectrum,
    noise_frequencies,
    own_psd_at,
    pooled,
    psd_at,
    spectrum_at,
    squared_residuals,
    with_added_variance,
)
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]


def with_sway_noise(trace: Trace, nominal: Sequence[Trace]) -> Trace:
    """The difference of two instances, with the noise expected because it moves faster than the `nominal` ones.

    At most the whole nominal noise is movement between sample times, which bounds the expected noise. The movement is
    the common part of both instances. A calmer recording keeps its noise.
    """
    before, now = [_common_movement(n) for n in nominal], _common_movement(trace)
    if trace.against is None or not before:
        return trace
    nominal_movement = np.maximum(np.mean(before, axis=0), np.maximum(1e-12 * now, np.finfo(float).tiny))
    left = np.mean([squared_residuals(n).mean(axis=0) for n in nominal], axis=0)
    known = trace.observed[1:] & trace.observed[:-1]
    there = 0.5 * (np.diff(trace.residual, axis=0)[known] ** 2).mean(axis=0)
    return with_added_variance(trace, np.clip(there - left, 0.0, left * np.maximum(now / nominal_movement - 1.0, 0.0)))


def _common_movement(trace: Trace) -> Array:
    """Fast movement that both instances of a difference show, (3,), from second differences.

    Manoeuvres dominate first differences.
    """
    known = trace.observed[2:] & trace.observed[1:-1] & trace.observed[:-2]
    if not known.any():
        return np.zeros(3)
    one, other = (np.diff(reading, 2, axis=0)[known] * trace.fs**2 for reading in (trace.measured, trace.ideal))
    return np.asarray(np.maximum((one * other).mean(axis=0), 0.0))


@dataclasses.dataclass(frozen=True, eq=False)
class MotorNoise:
    """Noise of the difference of two instances: variance (3,) at motor power one, and the mean power in the flight."""

    variance: Array
    power: float


def motor_power(trace: Trace) -> Array | None:
    """Square of the mean motor output or else of the throttle, (N,); None without either."""
    if trace.motors is not None:
        return np.asarray((np.maximum(trace.motors, 0.0) ** 2).mean(axis=1))
    return None if trace.throttle is None else np.asarray(np.maximum(trace.throttle, 0.0) ** 2)


def motor_noise_of(nominal: Sequence[Trace]) -> dict[Sensor, MotorNoise]:
    """Motor noise by sensor, from differences of instances in `nominal` recordings."""
    found: dict[Sensor, list[MotorNoise]] = {}
    for trace in nominal:
        if trace.against is not None and (one := _motor_noise(trace)) is not None:
            found.setdefault(trace.sensor, []).append(one)
    return {
        sensor: MotorNoise(np.mean([d.variance for d in each], axis=0), float(np.mean([d.power for d in each])))
        for sensor, each in found.items()
    }


def _motor_noise(trace: Trace) -> MotorNoise | None:
    power = motor_power(trace)
    rows = trace.observed
    if power is None or rows.sum() < FEWEST or not power[rows].any():
        return None
    mean = float(power[rows].mean())
    residual = trace.residual[rows]
    return MotorNoise(
        np.array([_variance_with_power(column, power[rows] / mean) / mean for column in residual.T]), mean
    )


def _variance_with_power(residual: Array, power: Array) -> float:
    """Part of the variance of `residual` (N,) that follows `power` (N,) of mean one; 0 if not significant."""
    squares = (residual - np.median(residual)) ** 2
    unit = float(squares.mean())
    if unit == 0.0:
        return 0.0
    none, ones = np.zeros(len(squares)), np.ones(len(squares))
    steady = fit_amplitudes(squares / unit, ones, none, [ones])
    both = fit_amplitudes(squares / unit, ones, none, [ones, power])
    follows = chdtrc(1, max(steady.deviance - both.deviance, 0.0)) < UNSTEADY
    return unit * float(both.amplitudes[1]) if follows else 0.0


def with_motor_noise(trace: Trace, found: Mapping[Sensor, MotorNoise]) -> Trace:
    """`trace` with the noise expected of more motor power than in the nominal recordings."""
    driven, power = found.get(trace.sensor), motor_power(trace)
    if driven is None or power is None:
        return trace
    instances = 2.0 if trace.against is None else 1.0  # of a difference, two sensors have a half each
    more = driven.variance / instances * max(float(power[trace.observed].mean()) - driven.power, 0.0)
    return with_added_variance(trace, more) if more.any() else trace


_ABOUT = 0.3
"""Half width of a running median, relative to the frequency: a rotor line of varying speed fills less than half of it.
Chosen, not measured: speeds differ by as much between hover and climb."""
_REST_S, _EXCESS = 2.0, 2.0
"""Least time, s, with the motors off to judge noise, and the ratio by which it must exceed the expected noise. Chosen,
not measured: a rest of two seconds has some hundred samples, whose power is known to 15 %."""
_BODY_HZ = 10.0
"""Frequency, Hz, up to which a vehicle moves as a rigid body: attitude controllers end there, rotors begin beyond.
Chosen, not measured: the bandwidth of usual attitude controllers."""


def movement_of(traces: Sequence[Trace]) -> dict[Sensor, ResidualSpectrum]:
    """By sensor, the mean spectrum of the ideal readings in `traces`, without short ones."""
    found: dict[Sensor, list[ResidualSpectrum]] = {}
    for trace in traces:
        if (spectrum := _movement_spectrum(trace)) is not None:
            found.setdefault(trace.sensor, []).append(spectrum)
    return {sensor: pooled(spectra) for sensor, spectra in found.items()}


def _movement_spectrum(trace: Trace) -> ResidualSpectrum | None:
    everywhere = np.ones(len(trace.t), dtype=bool)  # no holes: their edges would be movement
    return learned_spectrum(
        dataclasses.replace(trace, measured=trace.ideal, ideal=0.0 * trace.ideal, observed=everywhere)
    )


def with_movement_noise(trace: Trace, nominal: Mapping[Sensor, ResidualSpectrum]) -> Trace:
    """`trace` with the noise expected because it moves more than the `nominal` recordings.

    The nominal noise is taken as a share of movement and noise together, so more movement adds that share. A calmer
    recording keeps its noise.
    """
    if trace.against is not None or trace.sensor not in nominal or (trace.psd is None and trace.sigma is None):
        return trace
    own = _movement_spectrum(trace)
    if own is None:
        return trace
    before = nominal[trace.sensor]
    hz = np.unique(np.concatenate([own.hz, before.hz[before.hz < 0.5 * trace.fs], noise_frequencies(trace)]))
    psd = psd_at(trace, hz)
    was, now = (spectrum_at(spectrum, hz, trace.fs, trace.low_pass_hz) for spectrum in (before, own))
    expected = psd * (1.0 + np.maximum(now - was, 0.0) / (was + psd))
    return dataclasses.replace(trace, psd=expected, psd_hz=hz, own_psd=own_psd_at(trace, hz))


def with_heave_noise(trace: Trace, reference: ReferenceInfo) -> Trace:
    """A single unit's `trace` with the noise expected above the bandwidth of its reference.

    Up to the frequencies of rigid-body motion, a unit measures gusts that differ from flight to flight. Above, it
    measures vibration, unless it is as loud at rest; rotor lines are excluded.
    """
    bandwidth = {Sensor.ACCEL: reference.bandwidth_hz, Sensor.GYRO: reference.turns_hz}.get(trace.sensor, math.inf)
    if trace.against is not None or trace.psd is None or math.isinf(bandwidth):
        return trace
    own = learned_spectrum(trace)
    if own is None:
        return trace
    hz = np.unique(np.concatenate([noise_frequencies(trace), own.hz]))
    psd, felt = psd_at(trace, hz), spectrum_at(own, hz, trace.fs, trace.low_pass_hz)
    heaves, shakes = (hz > bandwidth) & (hz < _BODY_HZ), hz > max(bandwidth, _BODY_HZ)
    psd[heaves] = np.maximum(psd[heaves], felt[heaves])
    if not _exceeds_at_rest(trace, hz, psd):
        between_lines = np.exp(_local_median(hz, np.log(felt)))
        psd[shakes] = np.maximum(psd[shakes], between_lines[shakes])
    return dataclasses.replace(trace, psd=psd, psd_hz=hz, own_psd=own_psd_at(trace, hz))


def _exceeds_at_rest(trace: Trace, hz: Array, psd: Array) -> bool:
    """Whether fast noise exceeds the expected noise with the motors off; False without such a time."""
    power = motor_power(trace)
    if power is None:
        return False
    still = trace.observed & (power <= 0.0)
    pairs = still[1:] & still[:-1]
    if pairs.sum() < _REST_S * trace.fs:
        return False
    steps = (np.diff(trace.residual, axis=0)[pairs] ** 2).mean(axis=0)
    omega = 2.0 * np.pi * np.minimum(hz / trace.fs, 0.5)
    # variance of successive differences: the spectrum times 4 sin^2(w/2), averaged over frequency
    expected = np.trapezoid(psd * (4.0 * np.sin(0.5 * omega) ** 2)[:, None], hz, axis=0) / (0.5 * trace.fs)
    return bool((steps > _EXCESS * expected).any())


def _local_median(hz: Array, values: Array) -> Array:
    """Medians of `values` (K, 3) over neighbouring frequencies, to exclude lines."""
    low, high = np.searchsorted(hz, hz * (1.0 - _ABOUT)), np.searchsorted(hz, hz * (1.0 + _ABOUT))
    return np.array([np.median(values[a : max(b, a + 1)], axis=0) for a, b in zip(low, high, strict=True)])


def slopes_squared(trace: Trace) -> Array:
    """Square of the rate of change of the reading, (N, 3), averaged over the steps on either side."""
    known = trace.observed[1:] & trace.observed[:-1]
    steps = np.where(known[:, None], (np.diff(trace.measured, axis=0) * trace.fs) ** 2, 0.0)
    total = np.vstack([steps, np.zeros(3)]) + np.vstack([np.zeros(3), steps])
    return np.asarray(total / np.maximum(np.convolve(known, [1.0, 1.0]), 1.0)[:, None])


def age_of(nominal: Sequence[Trace]) -> float:
    """Largest variance (s2) of the sample age among the `nominal` differences; zero if noise does not depend on it."""
    return max((_age_variance(trace) for trace in nominal if trace.observed.sum() >= FEWEST), default=0.0)


def _age_variance(trace: Trace, change: Array | None = None) -> float:
    """Variance of the age from the squares (N, 3) of a rate of `change`; None: that of the readings."""
    squares = slopes_squared(trace) if change is None else change
    slopes = squares[trace.observed].T.ravel()
    steady = _fitted_variances(trace, np.zeros(len(slopes)), ())
    if not slopes.any() or steady is None:
        return 0.0
    unit = float(squared_residuals(trace).mean() / slopes.mean())
    aged = _fitted_variances(trace, np.zeros(len(slopes)), (unit * slopes,))
    if aged is None or chdtrc(1, max(steady.deviance - aged.deviance, 0.0)) > UNSTEADY:
        return 0.0
    return unit * float(aged.amplitudes[3])


def _fitted_variances(trace: Trace, base: Array, more: Sequence[Array]) -> AmplitudeFit | None:
    """Fitted stationary noise of each axis, in units of its mean square, beside `base` and `more`, all (3 n,)."""
    squares = squared_residuals(trace)
    if not squares.any(axis=0).all():
        return None
    steady = np.kron(np.diag(squares.mean(axis=0)), np.ones(len(squares)))
    return fit_amplitudes(squares.T.ravel(), np.ones(squares.size), base, [*steady, *more])


def without_aged_samples(trace: Trace, age: float) -> Trace:
    """`trace` without samples in which the noise of an `age` variance (s2) exceeds the rest."""
    expected = age * slopes_squared(trace)
    rest = _fitted_variances(trace, expected[trace.observed].T.ravel(), ())
    if rest is None:
        return trace
    noise = rest.amplitudes * squared_residuals(trace).mean(axis=0)
    return dataclasses.replace(trace, observed=trace.observed & ~(expected > noise).any(axis=1))


def with_age_noise(trace: Trace, age: float, nominal: Sequence[Trace]) -> Trace:
    """`trace` with the noise of sample age expected because it moves faster than the `nominal` ones."""
    nominal_slopes = np.mean([slopes_squared(n)[n.observed].mean(axis=0) for n in nominal], axis=0)
    more = age * np.maximum(slopes_squared(trace)[trace.observed].mean(axis=0) - nominal_slopes, 0.0)
    return with_added_variance(trace, more)


@dataclasses.dataclass(frozen=True, eq=False)
class AgeNoise:
    """Noise of sample age in another flight.

    `density` (K,) at `hz` (K,) is the power of a bin for each square of the rate of change, s2; `change` (3,) its mean
    square.
    """

    hz: Array
    density: Array
    change: Array


def age_noise_of(nominal: Sequence[Trace]) -> dict[tuple[Sensor, bool], AgeNoise]:
    """Noise of sample age in `nominal` flights, by sensor and whether against the trajectory (True) or a unit (False).

    The age is the same on every axis, so an axis without movement gets that of the others.
    """
    found: dict[tuple[Sensor, bool], list[AgeNoise]] = {}
    for trace in nominal:
        if trace.rate_known and (one := _age_noise(trace)) is not None:
            found.setdefault((trace.sensor, trace.against is None), []).append(one)
    return {kind: max(each, key=lambda one: float(one.density.mean())) for kind, each in found.items()}


def _age_noise(trace: Trace) -> AgeNoise | None:
    spectrum = learned_spectrum(trace)
    ideal = dataclasses.replace(trace, measured=trace.ideal)
    if spectrum is None or trace.observed.sum() < FEWEST or not (age := _age_variance(trace, slopes_squared(ideal))):
        return None
    change = slopes_squared(ideal)[trace.observed].mean(axis=0)
    there = spectrum.psd.sum(axis=1)
    size = float(spectrum.dof @ there / spectrum.dof.sum())
    return AgeNoise(spectrum.hz, there / size * min(age, size / float(change.sum())), change)


def with_aged_noise(trace: Trace, found: Mapping[tuple[Sensor, bool], AgeNoise]) -> Trace:
    """`trace` with the noise of sample age expected because it changes faster than in other flights.

    A calmer recording keeps its noise.
    """
    aged = found.get((trace.sensor, trace.against is None))
    if aged is None or (trace.psd is None and trace.sigma is None):
        return trace
    now = slopes_squared(dataclasses.replace(trace, measured=trace.ideal))[trace.observed].mean(axis=0)
    faster = np.maximum(now - aged.change, 0.0)
    if not faster.any():
        return trace
    hz = np.unique(np.concatenate([noise_frequencies(trace), aged.hz[aged.hz < 0.5 * trace.fs]]))
    more = np.interp(hz, aged.hz, aged.density)[:, None] * faster
    own = own_psd_at(trace, hz)
    return dataclasses.replace(
        trace, psd=psd_at(trace, hz) + more, psd_hz=hz, own_psd=None if own is None else own + more
    )
