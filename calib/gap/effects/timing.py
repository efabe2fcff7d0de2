"""Effects on time: the sensor is late, slow, or its clock runs differently.

The ideal reading itself is moved and filtered (a quintic spline through its samples, which is exact to 1e-4 up to half
of the Nyquist frequency), not expanded: at 5 ms and 5 Hz the first order is already wrong by a percent.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.signal import butter, lfilter, lfilter_zi

from calib.gap.effects.base import Effect, MeanEffect, Missing, Parameter, Shape
from calib.gap.effects.parts import TRIADS, lagged
from calib.gap.problem import Trace
from calib.recording import Sensor

Array = NDArray[np.float64]

_SPLINE = 5
_LONGEST = 0.5  # s, delay
_SHORTEST = 0.125  # samples, delay
_DELAYS = 9  # of each sign
_CUTOFFS = 14
_DRIFTS = 8  # of each sign
_LARGEST_DRIFT = 5e-3  # clocks without a crystal
_LEAST_SHIFT = 1e-3  # s at the end of the recording, of the smallest drift to try

_SLOPE = {Sensor.ACCEL: 0.5, Sensor.GYRO: 0.05, Sensor.MAG: 1.0}
"""Rms slope of the ideal reading, unit/s, from which on some milliseconds show."""
_SHAKE = "a fast shake or a yaw jerk"


def shifted(values: Array, samples: float) -> Array:
    """`values` (N, k), uniform in time, `samples` later; what lies outside is held."""
    columns = [ndimage.shift(column, samples, order=_SPLINE, mode="nearest") for column in values.T]
    return np.stack(columns, axis=1)


def stretched(values: Array, drift: float) -> Array:
    """`values` (N, k) read at ``n (1 - drift)``: the clock of the reading runs slow, by `drift`, from the first on."""
    at = np.arange(len(values)) * (1.0 - drift)
    columns = [ndimage.map_coordinates(c, at[None, :], order=_SPLINE, mode="nearest") for c in values.T]
    return np.stack(columns, axis=1)


def delay_column(trace: Trace, delay: float) -> Array:
    """``ideal(t - delay) - ideal(t)``."""
    return (shifted(trace.ideal, delay * trace.fs) - trace.ideal)[None]


def drift_column(trace: Trace, ppm: float) -> Array:
    """``ideal(t - drift (t - t_0)) - ideal(t)``."""
    return (stretched(trace.ideal, 1e-6 * ppm) - trace.ideal)[None]


def low_pass_column(trace: Trace, cutoff: float) -> Array:
    """The filtered ideal reading less the ideal one."""
    return (_filtered(trace, cutoff, _order(trace, cutoff)) - trace.ideal)[None]


def low_pass_gain(trace: Trace, omega: Array, cutoff: float) -> Array:
    """``|H|^2`` of the filter at `omega`, rad per sample."""
    ratio = omega * trace.fs / (2.0 * np.pi * cutoff)
    return np.asarray(1.0 / (1.0 + ratio ** (2 * _order(trace, cutoff))), dtype=np.float64)


def _filtered(trace: Trace, cutoff: float, order: int) -> Array:
    """Through one pole (a package, an analogue stage) or a Butterworth of two (ArduPilot's, PX4's, most chips')."""
    if order == 1:
        return lagged(trace.ideal, 1.0 / trace.fs, 1.0 / (2.0 * np.pi * cutoff))
    b, a = butter(2, min(cutoff, 0.49 * trace.fs), fs=trace.fs)
    start = lfilter_zi(b, a)[:, None] * trace.ideal[:1]
    return np.asarray(lfilter(b, a, trace.ideal, axis=0, zi=start)[0], dtype=np.float64)


def _order(trace: Trace, cutoff: float) -> int:
    """The number of poles, 1 or 2, whose output is nearer to what was measured; constants do not count."""
    residual = trace.residual[trace.observed]
    left = []
    for order in (1, 2):
        change = (_filtered(trace, cutoff, order) - trace.ideal)[trace.observed]
        left.append(float((residual - change).var(axis=0).sum()))
    return 1 if left[0] <= left[1] else 2


def delays(trace: Trace) -> Array:
    """Delays to try, s; negative where the reference is the late one."""
    sizes = np.geomspace(_SHORTEST / trace.fs, max(_LONGEST, 8.0 / trace.fs), _DELAYS)
    return np.concatenate([-sizes[::-1], sizes])


def cutoffs(trace: Trace) -> Array:
    """Cut-offs to try, Hz."""
    return np.geomspace(min(0.5, 0.02 * trace.fs), 0.45 * trace.fs, _CUTOFFS)


def drifts(trace: Trace) -> Array:
    """Drifts to try, millionths, either way."""
    duration = float(trace.t[-1] - trace.t[0])
    smallest = min(_LEAST_SHIFT / max(duration, 1.0), 0.1 * _LARGEST_DRIFT)
    sizes = 1e6 * np.geomspace(smallest, _LARGEST_DRIFT, _DRIFTS)
    return np.concatenate([-sizes[::-1], sizes])


def slope(trace: Trace) -> float:
    """Rms slope over time of the ideal reading's liveliest axis, unit/s."""
    steps = np.diff(trace.ideal, axis=0)[trace.observed[1:] & trace.observed[:-1]]
    return float(np.sqrt((steps**2).mean(axis=0).max()) * trace.fs) if len(steps) else 0.0


def _turns(trace: Trace) -> tuple[str, str] | None:
    """The vehicle's turning decides for every sensor alike: the clock is one."""
    if trace.spin is None or trace.sensor == Sensor.GYRO:
        return _lively(trace.sensor)(trace)
    found, least = float(np.sqrt((trace.spin[trace.observed] ** 2).mean(axis=0).max())), _SLOPE[Sensor.GYRO]
    if found >= least:
        return None
    return f"the angular rate changes by {found:.2g} rad/s2 rms", f">= {least:g} rad/s2: {_SHAKE}"


def _lively(sensor: Sensor) -> Missing:
    def missing(trace: Trace) -> tuple[str, str] | None:
        found, least = slope(trace), _SLOPE[sensor]
        if found >= least:
            return None
        unit = f"{trace.unit}/s"
        return f"the ideal reading changes by {found:.2g} {unit} rms", f">= {least:g} {unit}: {_SHAKE}"

    return missing


def _of(sensor: Sensor) -> tuple[Effect, ...]:
    return (
        MeanEffect(
            f"{sensor}_delay",
            sensor,
            (),
            "fast movement",
            _SHAKE,
            _lively(sensor),
            Shape(Parameter("delay_s", "s"), delays),
            columns=delay_column,
            fixed=True,
            rivals=(f"{sensor}_low_pass", "clock_drift"),
        ),
        MeanEffect(
            f"{sensor}_low_pass",
            sensor,
            (),
            "fast movement; its own noise",
            _SHAKE,
            _lively(sensor),
            Shape(Parameter("cutoff_hz", "Hz"), cutoffs),
            columns=low_pass_column,
            fixed=True,
            noise_gain=low_pass_gain,
            rivals=(f"{sensor}_delay", f"{sensor}_noise"),
        ),
    )


CLOCK_DRIFT = MeanEffect(
    "clock_drift",
    Sensor.GYRO,
    (),
    "fast movement throughout a long recording",
    "a shake at the beginning and another at the end",
    _turns,
    Shape(Parameter("drift_ppm", "ppm"), drifts),
    shared=True,
    columns=drift_column,
    fixed=True,
    rivals=tuple(f"{sensor}_delay" for sensor in TRIADS),
)

EFFECTS: tuple[Effect, ...] = (*(effect for sensor in TRIADS for effect in _of(sensor)), CLOCK_DRIFT)
