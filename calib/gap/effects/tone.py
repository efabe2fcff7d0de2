"""A line at one constant frequency: a supply's ripple, a pump, a fan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, EffectShape, MeanEffect
from mavcal.calib.gap.effects.parts import TRIADS, axiswise, per_axis
from mavcal.calib.gap.effects.traits import Trait
from mavcal.calib.gap.problem import UNIT, Trace
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

_PERIODS = 5
"""Least number of periods in a recording: slower waves are drift. Chosen, not measured: a polynomial follows fewer as
well."""
_CANDIDATES = 4
"""Frequencies that are tried. Chosen, not measured: it bounds the time; the strongest are the likeliest."""
_AROUND = 201
"""Number of bins whose geometric mean is the background. Chosen, not measured: one line of any strength hardly changes
it."""


def tone_signals(trace: Trace, frequency: float) -> Array:
    """Cosine and sine (2, N) of `frequency` (Hz), with phase zero at the first sample.

    The amplitude is that of the sensor: the firmware's two-pole filter, if known, attenuates and delays the wave.
    """
    phase = 2.0 * np.pi * frequency * (trace.t - trace.t[0])
    if trace.low_pass_hz is not None:
        s = 1j * frequency / trace.low_pass_hz
        left = 1.0 / (1.0 + np.sqrt(2.0) * s + s * s)
        wave = left * np.exp(1j * phase)
        return np.stack([wave.real, wave.imag])
    return np.stack([np.cos(phase), np.sin(phase)])


def tone_frequencies(trace: Trace) -> Array:
    """Frequencies that a recording of this length resolves, Hz."""
    n = len(trace.t)
    k = np.arange(min(_PERIODS, max(1, n // 2 - 2)), max(n // 2, 3))
    return np.asarray(k * (trace.fs / n), dtype=np.float64)


def strongest_bins(trace: Trace, residual: Array) -> Array:
    """The frequencies of :func:`tone_frequencies` with most power of `residual` (N, 3) above their surroundings."""
    grid = tone_frequencies(trace)
    y = np.where(trace.observed[:, None], residual, 0.0)
    power = np.abs(np.fft.rfft(y - y.mean(axis=0), axis=0)) ** 2
    power[0] = power[min(1, len(power) - 1)]  # the mean is gone; its logarithm would drown its neighbours
    around = np.exp(uniform_filter1d(np.log(power + np.finfo(float).tiny), _AROUND, axis=0))
    first = round(float(grid[0]) * len(y) / trace.fs)
    ratio = (power / around).sum(axis=1)[first : first + len(grid)]
    return np.sort(grid[np.argsort(ratio)[-_CANDIDATES:]])


def _effect_of(sensor: Sensor) -> CatalogueEffect:
    unit = UNIT[sensor]
    return MeanEffect(
        f"{sensor}_tone",
        sensor,
        per_axis("cos", unit) + per_axis("sin", unit),
        "any recording",
        "sweep the rotor speed: a tone stays, a vibration follows",
        shape=EffectShape(EffectParameter("frequency_hz", "Hz"), tone_frequencies, strongest_bins),
        columns=axiswise(tone_signals),
        signals=tone_signals,
        repeatable=True,
        traits=frozenset({Trait.TONAL}),
        plain="a steady tone",
        rivals=(f"{sensor}_vibration", f"{sensor}_aliasing") if sensor != Sensor.MAG else ("mag_step",),
    )


EFFECTS: tuple[CatalogueEffect, ...] = tuple(_effect_of(sensor) for sensor in TRIADS)
