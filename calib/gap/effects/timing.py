"""Timing effects: delay, low-pass filter, clock drift.

The ideal reading itself is shifted and filtered, not expanded: at 5 ms and 5 Hz the first order is already wrong by a
percent. A quintic spline through its samples is exact to 1e-4 up to half of the Nyquist frequency.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.interpolate import BSpline

from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, EffectShape, MeanEffect, Missing
from mavcal.calib.gap.effects.parts import TRIADS
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.remembered import remembered
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_SPLINE = 5
"""Degree of the splines through the ideal reading. Chosen, not measured: a higher degree follows faster movement, and
five is quick."""
_EDGE = 12
"""Samples beyond which a spline no longer feels an end. Source: the slowest pole of the quintic filter, 0.43, is 4e-5
after so many."""
_KNOT = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
"""Basis function of that degree, about its middle. Source: seven knots for degree five."""
_LONGEST = 0.5
"""Longest delay, s. Chosen, not measured: more than half a second is a different fault."""
_SHORTEST = 0.125
"""Shortest delay on the grid, samples. Chosen, not measured: refinement reaches shorter ones."""
_DELAYS = 4
"""Delays of each sign on the grid. Chosen, not measured: it bounds the time, and refinement goes between."""
_CUTOFFS = 9
"""Cut-offs that are tried. Chosen, not measured: it bounds the time, and refinement goes between."""
_FASTEST = 8.0
"""Largest cut-off over the sampling rate. Chosen, not measured: a faster filter hardly changes a sample."""
_FOLDS = 20
"""Number of aliases of a faster rate's noise that are summed: the rest is flat. Chosen, not measured: terms fall as the
square of the fold."""
_DRIFTS = 3
"""Drifts of each sign on the grid. Chosen, not measured: it bounds the time, and refinement goes between."""
_LARGEST_DRIFT = 5e-3
"""Largest relative drift of a clock. Chosen, not measured: clocks without a crystal are off by some tenths of a
percent."""
_LEAST_SHIFT = 1e-3
"""Shift at the end of the recording, s, of the smallest drift to try. Chosen, not measured: less than a sample at most
rates."""

_SLOPE = {Sensor.ACCEL: 0.5, Sensor.GYRO: 0.05, Sensor.MAG: 1.0}
"""Rms slope of the ideal reading, unit/s, above which some milliseconds show. Chosen, not measured: 5 ms then show
2.5 mm/s2, 0.25 mrad/s or 5 nT."""
_SHAKE = "a fast shake or a yaw jerk"


@remembered(12)
def splines_of(trace: Trace) -> Array:
    """Coefficients (3, N + 2 _EDGE) of the splines through the ideal reading.

    Beyond either end it continues with its last slope, because a recording may begin during a movement. A sudden stop
    would change the first sample by more than all noise.
    """
    longer = np.pad(trace.ideal, ((_EDGE, _EDGE), (0, 0)), mode="reflect", reflect_type="odd")
    return np.stack([ndimage.spline_filter1d(column, _SPLINE, mode="nearest") for column in longer.T])


def shifted_ideal(trace: Trace, samples: float) -> Array:
    """The ideal reading (N, 3) delayed by `samples`; the ends are held."""
    whole = math.floor(-samples)
    at = -samples - whole + np.arange(2, -4, -1)  # from each of the six knots about a sample
    values = ndimage.correlate1d(splines_of(trace), _KNOT(at), axis=1, mode="nearest", origin=-1)
    count = values.shape[1]
    inside = np.arange(_EDGE, count - _EDGE) + whole
    return np.ascontiguousarray(values[:, np.clip(inside, 0, count - 1)].T)


def stretched_ideal(trace: Trace, drift: float) -> Array:
    """The ideal reading (N, 3) at ``n (1 - drift)``: its clock runs slow by `drift`."""
    at = np.arange(len(trace.ideal)) * (1.0 - drift) + _EDGE
    columns = [
        ndimage.map_coordinates(c, at[None, :], order=_SPLINE, mode="nearest", prefilter=False)
        for c in splines_of(trace)
    ]
    return np.stack(columns, axis=1)


def delay_column(trace: Trace, delay: float) -> Array:
    """``ideal(t - delay) - ideal(t)``."""
    return (shifted_ideal(trace, delay * trace.fs) - trace.ideal)[None]


def drift_column(trace: Trace, ppm: float) -> Array:
    """``ideal(t - drift (t - t_0)) - ideal(t)``."""
    return (stretched_ideal(trace, 1e-6 * ppm) - trace.ideal)[None]


def low_pass_column(trace: Trace, cutoff: float) -> Array:
    """Filtered less ideal reading, with the number of poles that fits the residual better."""
    changes = _filtered_less_ideal(trace, cutoff)
    return changes[_better_order(trace, changes)][None]


def low_pass_gain(trace: Trace, omega: Array, cutoff: float) -> Array:
    """``|H|^2`` (2, K) at `omega` (rad per sample): for noise at the log rate, and for aliased noise of a faster rate.

    A sensor that filters at a higher rate than the log's aliases the noise beyond the Nyquist frequency of the log.
    """
    order = 1 + _better_order(trace, _filtered_less_ideal(trace, cutoff))
    folds = 2.0 * np.pi * np.arange(-_FOLDS, _FOLDS + 1)[:, None]
    ratio = np.abs(omega + folds) * trace.fs / (2.0 * np.pi * cutoff)
    gains = 1.0 / (1.0 + ratio ** (2 * order))
    return np.stack([gains[_FOLDS], gains.sum(axis=0)])


@remembered(4)
def _filtered_less_ideal(trace: Trace, cutoff: float) -> tuple[Array, Array]:
    """Change by one pole (a package, an analogue stage) and by a Butterworth of two (ArduPilot's, PX4's, most chips').

    ``H = 1/(1 + s)`` and ``1/(1 + sqrt(2) s + s^2)`` at ``s = j f/fc``, by Fourier transform. A lead-in of eight time
    constants lets the filter settle: the end ramps to the extrapolated start.
    """
    x = trace.ideal
    lead = min(len(x) - 1, max(64, int(8.0 * trace.fs / (2.0 * np.pi * cutoff)))) // 2
    before = 2.0 * x[0] - x[lead:0:-1]
    ramp = (np.arange(lead) / max(lead, 1))[:, None]
    padded = np.vstack([x[-1] + ramp * (before[:1] - x[-1]), before, x])
    size = fft.next_fast_len(len(padded), real=True)
    padded = np.vstack([np.repeat(x[-1:], size - len(padded), axis=0), padded])
    spectrum = fft.rfft(padded, axis=0)
    s = 1j * fft.rfftfreq(size, 1.0 / trace.fs)[:, None] / cutoff
    one, two = 1.0 / (1.0 + s), 1.0 / (1.0 + np.sqrt(2.0) * s + s * s)
    return (_change_in_time(spectrum * one, size, x), _change_in_time(spectrum * two, size, x))


def _change_in_time(spectrum: NDArray[np.complex128], size: int, x: Array) -> Array:
    return np.asarray(fft.irfft(spectrum, size, axis=0)[-len(x) :] - x, dtype=np.float64)


def _better_order(trace: Trace, changes: tuple[Array, Array]) -> int:
    """Index of the change that leaves the smaller residual about its mean."""
    residual, seen = trace.residual, trace.observed
    one, two = (_squares_about_mean((residual - change)[seen]) for change in changes)
    return int(two < one)


def _squares_about_mean(series: Array) -> float:
    """Sum of squares of a series (N, 3) about its mean."""
    about = series - np.full(len(series), 1.0 / max(len(series), 1)) @ series
    return float(np.vdot(about, about))


def delays(trace: Trace) -> Array:
    """Delays to try, s; negative if the reference is late."""
    sizes = np.geomspace(_SHORTEST / trace.fs, max(_LONGEST, 8.0 / trace.fs), _DELAYS)
    return np.concatenate([-sizes[::-1], sizes])


def cutoffs(trace: Trace) -> Array:
    """Cut-offs to try, Hz; far beyond half the sampling rate a filter still delays by tenths of a millisecond."""
    return np.geomspace(min(0.5, 0.02 * trace.fs), _FASTEST * trace.fs, _CUTOFFS)


def drifts(trace: Trace) -> Array:
    """Clock drifts to try, millionths, of either sign."""
    duration = float(trace.t[-1] - trace.t[0])
    smallest = min(_LEAST_SHIFT / max(duration, 1.0), 0.1 * _LARGEST_DRIFT)
    sizes = 1e6 * np.geomspace(smallest, _LARGEST_DRIFT, _DRIFTS)
    return np.concatenate([-sizes[::-1], sizes])


def rms_slope(trace: Trace) -> float:
    """Rms slope of the ideal reading on its fastest axis, unit/s."""
    steps = np.diff(trace.ideal, axis=0)[trace.observed[1:] & trace.observed[:-1]]
    return float(np.sqrt((steps**2).mean(axis=0).max()) * trace.fs) if len(steps) else 0.0


def _missing_rotation(trace: Trace) -> tuple[str, str] | None:
    """What is missing for a clock drift; rotation shows it for every sensor, since all share one clock.

    A trajectory re-estimated from the recording itself runs on the clock in question.
    """
    if not trace.rate_known:
        return "the re-estimated reference has the clock of the recording", "a reference with a clock of its own"
    if trace.spin is None or trace.sensor == Sensor.GYRO:
        return _missing_movement(trace.sensor)(trace)
    found, least = float(np.sqrt((trace.spin[trace.observed] ** 2).mean(axis=0).max())), _SLOPE[Sensor.GYRO]
    if found >= least:
        return None
    return f"the angular rate changes by {found:.2g} rad/s2 rms", f">= {least:g} rad/s2: {_SHAKE}"


def _missing_movement(sensor: Sensor) -> Missing:
    def missing(trace: Trace) -> tuple[str, str] | None:
        if not trace.rate_known:
            return "the re-estimated reference does not follow fast changes", "a log at a higher rate, or a pose"
        found, least = rms_slope(trace), _SLOPE[sensor]
        if found >= least:
            return None
        unit = f"{trace.unit}/s"
        return f"the ideal reading changes by {found:.2g} {unit} rms", f">= {least:g} {unit}: {_SHAKE}"

    return missing


def _effects_of(sensor: Sensor) -> tuple[CatalogueEffect, ...]:
    return (
        MeanEffect(
            f"{sensor}_delay",
            sensor,
            (),
            "fast movement",
            _SHAKE,
            _missing_movement(sensor),
            EffectShape(EffectParameter("delay_s", "s"), delays),
            columns=delay_column,
            fixed=True,
            plain="readings that are late",
            rivals=(f"{sensor}_low_pass", "clock_drift"),
            traits=frozenset({Trait.STEADY, Trait.LATE}),
        ),
        MeanEffect(
            f"{sensor}_low_pass",
            sensor,
            (),
            "fast movement; its own noise",
            _SHAKE,
            _missing_movement(sensor),
            EffectShape(EffectParameter("cutoff_hz", "Hz"), cutoffs),
            columns=low_pass_column,
            fixed=True,
            noise_gain=low_pass_gain,
            plain="a slower filter",
            rivals=(f"{sensor}_delay", f"{sensor}_noise"),
            traits=frozenset({Trait.STEADY}),
        ),
    )


CLOCK_DRIFT = MeanEffect(
    "clock_drift",
    Sensor.GYRO,
    (),
    "fast movement throughout a long recording",
    "a shake at the beginning and another at the end",
    _missing_rotation,
    EffectShape(EffectParameter("drift_ppm", "ppm"), drifts),
    shared=True,
    columns=drift_column,
    fixed=True,
    plain="clocks that run at different speeds",
    rivals=tuple(f"{sensor}_delay" for sensor in TRIADS),
    traits=frozenset({Trait.STEADY}),
)

EFFECTS: tuple[CatalogueEffect, ...] = (*(effect for sensor in TRIADS for effect in _effects_of(sensor)), CLOCK_DRIFT)
