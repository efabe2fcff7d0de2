"""A simulator's readings as a reference: their movement without noise, and their mean error.

Noise in the reference is an error in the regressors (Fuller, Measurement Error Models, 1987). It attenuates every
column and enters the difference with the opposite sign, so that a filter or a delay seems to explain it. The best
estimate of the movement avoids that. The part that a Wiener filter removes is uncorrelated with the part that it passes
(regression calibration; Carroll et al., Measurement Error in Nonlinear Models, 2006). At a frequency that the filter
passes by ``g``, noise of power ``s^2`` leaves ``g s^2`` in the reference.

Mean errors of a simulated flight against its own ideal reading belong to the simulator.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.special import chdtri

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.noise import ResidualSpectrum, learned_spectrum, spectrum_at
from mavcal.calib.gap.reference.signals import Signal, grid_of, interpolated
from mavcal.calib.recording import Channel, Sensor

Array = NDArray[np.float64]

_LOWEST = 1 / 8
"""Fraction of the Nyquist frequency above which the noise floor is sought; vehicles move below. Chosen, not measured:
12 Hz at a rate of 200."""
_BLOCKS = 16
"""Blocks of the coefficients above that, at most. Chosen, not measured: enough to tell a floor from a slope."""
_FEWEST = 128
"""Coefficients in a block. Chosen, not measured: its power is known to 13 % (sqrt(2/128))."""
_FEWEST_BLOCKS = 3
"""Blocks that must agree on the noise floor. Chosen, not measured: two agree by chance."""
_MOST = 0.5
"""Fraction of all blocks that must agree: power that falls with frequency is movement, or filtered noise. Chosen, not
measured: the floor is what most of them have."""
_BY_CHANCE = 4.0
"""Standard deviations by which blocks of one floor may differ. Chosen, not measured: one in 16 000 differs by more."""
_SURE = 3.0
"""Standard deviations by which a band must be above the floor to hold movement. Chosen, not measured: one in 740 is
above it by chance."""
_STEP = 1.08
"""Ratio of the edges of bands. Chosen, not measured: nine to an octave."""
_NARROWEST = 8
"""Coefficients in a band. Chosen, not measured: its power is known to 50 % (sqrt(2/8))."""
_LINES = (1, 3, 9, 27)
"""Widths, in coefficients, of lines and drifting lines that stand out of a band. Chosen, not measured: a factor of
three from one to the next."""
_RARE = 0.1
"""Mean number of false lines in a recording of noise, by width. Chosen, not measured: one in ten recordings has one."""


@dataclasses.dataclass(frozen=True, eq=False)
class Denoised:
    """The movement in readings, and the noise (variance of one sample) of a sensor like it beside that movement."""

    signal: Signal
    noise: ResidualSpectrum


def denoised(channel: Channel) -> Denoised | None:
    """The readings of `channel` without white noise; None if noise and movement cannot be separated."""
    grid = grid_of(channel)
    n = len(grid.t)
    values = interpolated(grid.stamps, channel.values[grid.sample], grid.t)
    values[grid.point] = channel.values[grid.sample]
    spectrum = dct(values, axis=0, norm="ortho")
    power = spectrum[1:] ** 2 / grid.observed.mean()
    white = [_white_power(column) for column in power.T]
    if any(level is None for level in white):
        return None
    floor = np.array(white, dtype=np.float64)
    edges = _edges(n)
    count = np.diff(edges).astype(np.float64)
    mean = np.add.reduceat(power, edges[:-1] - 1, axis=0) / count[:, None]
    seen = mean > floor * (1.0 + _SURE * np.sqrt(2.0 / count))[:, None]
    gain = np.repeat(np.where(seen, 1.0 - floor / np.maximum(mean, floor), 0.0), np.diff(edges), axis=0)
    gain = np.maximum(gain, _line_gains(power / floor))
    passed = np.vstack([np.ones((1, 3)), gain])
    gain = np.add.reduceat(gain, edges[:-1] - 1, axis=0) / count[:, None]
    smooth = idct(spectrum * passed, axis=0, norm="ortho")[grid.point]
    fs = (n - 1) / float(grid.t[-1] - grid.t[0])
    hz = np.sqrt(edges[:-1] * (edges[1:] - 1.0)) * fs / (2.0 * n)
    return Denoised(Signal(grid.stamps, smooth), ResidualSpectrum(hz, floor * (1.0 + gain), count, fs, smooth=True))


def _line_gains(ratio: Array) -> Array:
    """Gains (n - 1, 3) at narrow lines of power `ratio` over the floor: a vibrating frame."""
    gain = np.zeros_like(ratio)
    for width in _LINES:
        mean = uniform_filter1d(ratio, width, axis=0, mode="nearest")
        together = np.broadcast_to(mean.mean(axis=1, keepdims=True), mean.shape)
        for power, dof in ((mean, width), (together, 3 * width)):
            limit = float(chdtri(dof, _RARE / len(ratio))) / dof
            found = maximum_filter1d(np.where(power > limit, power, 0.0), width, axis=0)
            gain = np.maximum(gain, np.where(found > 0.0, 1.0 - 1.0 / np.maximum(found, 1.0), 0.0))
    return gain


def with_reference_error(own: ResidualSpectrum, noise: ResidualSpectrum) -> ResidualSpectrum:
    """The noise `own` of a sensor with the reference's error from `noise`."""
    error = dataclasses.replace(noise, psd=np.maximum(_error_power(noise), 1e-9 * noise.psd))
    return dataclasses.replace(own, psd=own.psd + spectrum_at(error, own.hz, own.fs, own.low_pass_hz))


def error_sd(noise: ResidualSpectrum) -> float:
    """Standard deviation of the noise left in the reference, of the noisiest axis."""
    return float(np.sqrt((noise.dof @ _error_power(noise) / noise.dof.sum()).max()))


def _error_power(noise: ResidualSpectrum) -> Array:
    """Power of the noise left in the reference, zero in the band where the filter is closed."""
    return np.asarray(noise.psd - noise.psd.min(axis=0))


def _white_power(power: Array) -> float | None:
    """White noise power in coefficients (n - 1,), from the lowest blocks that agree."""
    high = power[int(_LOWEST * len(power)) :]
    blocks = np.array_split(high, max(1, min(_BLOCKS, len(high) // _FEWEST)))
    means = np.sort([block.mean() for block in blocks])
    if not means[0] > 0.0:
        return None
    agree = means < means[0] * (1.0 + 2.0 * _BY_CHANCE * math.sqrt(2.0 / len(blocks[0])))
    return float(means[agree].mean()) if agree.sum() >= max(_FEWEST_BLOCKS, _MOST * len(blocks)) else None


def _edges(n: int) -> NDArray[np.intp]:
    """First coefficients of bands of some equal ratio, from 1 to `n`."""
    edges = [1]
    while edges[-1] < n:
        edges.append(max(edges[-1] + _NARROWEST, round(_STEP * edges[-1])))
    starts = [e for e in edges if e <= n - _NARROWEST]
    return np.array([*starts, n] if starts else [1, n], dtype=np.intp)


_SURE_OF_MEAN = 5.0
"""Standard errors above which a mean is significant. Chosen, not measured: a level by chance would be a false
offset."""


def mean_deviations(single: Sequence[Trace]) -> dict[tuple[Sensor, int], Array]:
    """Significant mean (3,) of the simulator's residuals by sensor and instance, else zero.

    The firmware's calibration causes one: a simulated sensor without errors is wrong by the correction.
    """
    found: dict[tuple[Sensor, int], Array] = {}
    for trace in single:
        noise = learned_spectrum(trace)
        if noise is None:
            continue
        mean = trace.residual[trace.observed].mean(axis=0)
        error = np.sqrt(noise.psd[0] / trace.observed.sum())
        found[trace.sensor, trace.instances[0]] = np.where(np.abs(mean) > _SURE_OF_MEAN * error, mean, 0.0)
    return found


def with_simulated_offset(trace: Trace, found: Mapping[tuple[Sensor, int], Array]) -> Trace:
    """`trace` against the simulator's sensor with its mean error; a missing instance takes that of the first."""
    offset = found.get((trace.sensor, trace.instances[0]), found.get((trace.sensor, 0)))
    if offset is None or trace.against is not None or not offset.any():
        return trace
    measured = np.where(trace.observed[:, None], trace.measured, trace.measured + offset)
    return dataclasses.replace(trace, ideal=trace.ideal + offset, measured=measured)
