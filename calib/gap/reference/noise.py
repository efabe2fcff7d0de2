"""Noise of nominal recordings: white, or a spectrum."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.special import chdtr, chdtrc

from mavcal.calib.gap.likelihood import fit_amplitudes, flicker, random_walk
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.channels import filter_gain

Array = NDArray[np.float64]

_BANDS = 28
"""Edges of bands, before wide ones are divided. Chosen, not measured: some eight to a decade of frequency."""
_COLOURED = 1e-4
"""P-value of the band furthest from white, below which noise is not white. Chosen, not measured: a recording has some
ten series to test."""
_OFF = 1e-3
"""P-value of a band under white noise, walk and flicker, below which the measured power is kept. Chosen, not measured:
a spectrum has some tens of bands."""
_FLOOR = 1e-9
"""Least power of a band, relative to the mean. Source: it guards a division and a logarithm."""
_SINGLE = 2.0**-24
"""Relative error of a single-precision number. Source: IEEE 754, half a unit of 24 bits."""
_CLEANED = 6
"""Rounds of line removal. Chosen, not measured: it bounds the time; each removes the strongest remaining lines."""
_PARTS = 16
"""Parts of a recording in which its noise should be the same. Chosen, not measured: some seconds each in a recording of
a minute."""
_CORNERS = 6
"""Spacing, in bands, of the corner frequencies of drifts. Chosen, not measured: five corners over the whole range."""
_SHRUNK = 12.0
"""Weight of the smooth model, in coefficients, against those of a differing band. Chosen, not measured: a band of as
many gets half the weight."""
FEWEST = 64
"""Least samples of a recording to estimate noise, and coefficients of a band that is not divided further. Chosen, not
measured: a variance of as many is known to 18 % (sqrt(2/64))."""
UNSTEADY = 1e-4
"""P-value below which noise depends on the motor power, or on the change of a reading. Chosen, not measured: a
recording has some ten series to test."""
_WHOLE = 0.9
"""Share of the samples observed, above which a recording has few holes. Chosen, not measured: a tenth of the power is
lost at most."""
LINE_HZ = 1.0
"""Width of a rotor line, Hz, from telemetry error and wandering within a second. Chosen, not measured: speeds in hover
wander by about as much."""
_HOVERS = 0.08
"""Relative difference of the speeds of rotors from flight to flight. Chosen, not measured: battery, load and air change
a hover by some percent."""
LOWEST_ROTOR_HZ = 5.0
"""Speed, Hz, below which no rotor turns. Chosen, not measured: 300 revolutions a minute carry nothing."""
_LEAST = 6
"""Least number of coefficients in the lowest band. Chosen, not measured: a power of as many is known to 58 %
(sqrt(2/6))."""
_SEEN = 5.0
"""Frequency relative to the filter's cut-off beyond which the attenuation cannot be inverted. Chosen, not measured: a
filter of second order leaves 4 % of the amplitude there."""


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """Spectrum of the residual of nominal recordings per DCT bin: `psd` (K, 3) in variance of one sample on `hz` (K,).

    `dof` (K,) are the squared coefficients that each band was averaged from; `fs` their sampling rate, `low_pass_hz`
    the firmware's filter that is in it. `smooth`: its shape is known, and only its size was learned. `steady`: it is
    stationary; a simulator's noise may stop with the motors.
    """

    hz: Array
    psd: Array
    dof: Array
    fs: float
    low_pass_hz: float | None = None
    smooth: bool = False
    steady: bool = True

    @property
    def sigma(self) -> Array:
        """Noise of one sample, if it is white, (3,)."""
        return np.asarray(np.sqrt(self.dof @ self.psd / self.dof.sum()))

    @property
    def white(self) -> bool:
        """Whether every band agrees with the mean of all, and the noise is stationary."""
        if self.smooth:
            return self.steady and bool(np.ptp(self.psd, axis=0).max() == 0.0)
        chance = two_sided_chances(self.psd / self.sigma**2, self.dof)
        return self.steady and bool(chance.min() * chance.size > _COLOURED)

    def smoothed(self) -> ResidualSpectrum:
        """The spectrum as a sum of white noise, flicker, walks and Gauss-Markov drifts.

        Its lowest bands have few coefficients. A band that differs significantly from that sum is kept, shrunk a little
        towards it.
        """
        if self.smooth:
            return self
        omega = 2.0 * np.pi * self.hz / self.fs
        gain = filter_gain(self.hz, self.low_pass_hz) ** 2
        level = [1.0 / (1.0 / random_walk(omega) + corner**2) for corner in omega[::_CORNERS]]
        shapes = [gain * shape for shape in (np.ones_like(omega), random_walk(omega), flicker(omega), *level)]
        made = np.empty_like(self.psd)
        for c, column in enumerate(self.psd.T):
            scale = max(float(self.dof @ column / self.dof.sum()), np.finfo(float).tiny)
            measured = np.maximum(column / scale, _FLOOR)
            model = _smooth_model(measured, self.dof, shapes)
            ratio = measured / model
            shrunk = (self.dof * ratio + _SHRUNK) / (self.dof + _SHRUNK)
            made[:, c] = scale * model * np.where(two_sided_chances(ratio[:, None], self.dof)[:, 0] < _OFF, shrunk, 1.0)
        return dataclasses.replace(self, psd=made)

    def widened(self) -> ResidualSpectrum:
        """The spectrum with rotor lines widened to the speeds of other flights."""
        if self.smooth:
            return self
        near = np.abs(np.log(self.hz[:, None] / self.hz)) <= _HOVERS
        near &= (np.minimum(self.hz[:, None], self.hz) > LOWEST_ROTOR_HZ) | np.eye(len(self.hz), dtype=bool)
        gain = (filter_gain(self.hz, self.low_pass_hz) ** 2)[:, None]
        psd = np.where(near[:, :, None], (self.psd / gain)[None], 0.0).max(axis=1)
        return dataclasses.replace(self, psd=psd * gain)


def _smooth_model(measured: Array, dof: Array, shapes: Sequence[Array]) -> Array:
    """The sum of `shapes` that fits `measured` (K,), without lines."""
    quiet = np.ones(len(measured), dtype=bool)
    model = measured
    for _ in range(_CLEANED):
        rows = [shape[quiet] for shape in shapes]
        fit = fit_amplitudes((dof * measured)[quiet], dof[quiet], np.zeros(int(quiet.sum())), rows)
        model = np.maximum(fit.amplitudes @ np.asarray(shapes), _FLOOR)
        loud = (measured > model) & (two_sided_chances((measured / model)[:, None], dof)[:, 0] < _OFF)
        if not (loud & quiet).any() or (quiet & ~loud).sum() < len(shapes) + 2:
            break
        quiet &= ~loud
    return np.asarray(model)


def two_sided_chances(ratio: Array, dof: Array) -> Array:
    """Two-sided chance of means (K, k) of `dof` (K,) squares of variance one at `ratio`."""
    total = ratio * dof[:, None]
    return np.asarray(2.0 * np.minimum(chdtrc(dof[:, None], total), chdtr(dof[:, None], total)))


def learned_spectrum(trace: Trace) -> ResidualSpectrum | None:
    """The noise spectrum of the residual of a nominal `trace`; None if it is too short.

    Few holes are filled with zeros; a series with many is joined, as in the likelihood.
    """
    residual = trace.residual - trace.residual[trace.observed].mean(axis=0)
    if trace.observed.mean() < _WHOLE:
        residual = residual[trace.observed]
    n = len(residual)
    if trace.observed.sum() < FEWEST:
        return None
    seen = np.broadcast_to(trace.observed if n == len(trace.t) else np.True_, n)
    residual[~seen] = 0.0
    power = dct(residual, axis=0, norm="ortho")[1:] ** 2 / seen.mean()
    bins = np.arange(1, n)
    edges = _edges(n, trace.fs)
    group = np.searchsorted(edges, bins, side="right") - 1
    count = np.bincount(group).astype(np.float64)
    mean = np.column_stack([np.bincount(group, weights=column) for column in power.T]) / count[:, None]
    centre = np.exp(np.bincount(group, weights=np.log(bins)) / count) * trace.fs / (2.0 * n)
    steady = _is_stationary(residual[seen])
    return ResidualSpectrum(
        centre, np.maximum(mean, digit_variance(trace)), count, trace.fs, trace.low_pass_hz, steady=steady
    )


def _is_stationary(residual: Array) -> bool:
    """Whether the differences of successive rows of `residual` (N, 3) have the same size throughout."""
    squares = np.diff(residual, axis=0)[::2] ** 2
    width = len(squares) // _PARTS
    if width < 2 or not squares.any(axis=0).all():
        return True
    parts = squares[: width * _PARTS].reshape(_PARTS, width, 3).mean(axis=1)
    ratio = np.maximum(parts / parts.mean(axis=0), _FLOOR)
    scatter = width * (ratio - 1.0 - np.log(ratio)).sum(axis=0) / (1.0 + 1.0 / (3.0 * width))  # Bartlett
    return bool(chdtrc(_PARTS - 1, scatter).min() * len(scatter) > _COLOURED)


def digit_variance(trace: Trace) -> float:
    """Variance of single-precision rounding, the least noise: instances of a simulator may agree to the last digit."""
    return max((_SINGLE * float(np.abs(trace.measured).max())) ** 2, float(np.finfo(float).tiny))


def _edges(n: int, fs: float) -> NDArray[np.intp]:
    """First coefficients of the bands, evenly spaced in the logarithm and at most as wide as a rotor line."""
    widest = max(FEWEST, round(LINE_HZ * 2.0 * n / fs))
    even = np.unique(np.rint(np.geomspace(_LEAST, n, _BANDS)))
    narrow = np.diff(even) < widest
    first = int(even[narrow.argmin()]) if not narrow.all() else n
    return np.concatenate([[1], even[even < first], np.arange(first, n, widest)]).astype(np.intp)


def pooled(noises: Sequence[ResidualSpectrum]) -> ResidualSpectrum:
    """The mean of several spectra on the bands of the first."""
    first = noises[0]
    if len(noises) == 1:
        return first
    steady = all(n.steady for n in noises)
    brought = [first.psd, *(spectrum_at(n, first.hz, first.fs, first.low_pass_hz) for n in noises[1:])]
    return dataclasses.replace(first, psd=np.mean(brought, axis=0), dof=first.dof * len(noises), steady=steady)


def with_noise(trace: Trace, total: ResidualSpectrum | None, own: ResidualSpectrum | None) -> Trace:
    """`trace` with declared noise.

    Parameters
    ----------
    trace
        Against a reference, or against another instance.
    total
        Residual spectrum of such a trace in nominal recordings, the reference's error included.
    own
        Spectrum of the difference of their instances: twice the sensor's own noise.
    """
    alone = trace.against is None
    if alone and own is not None:
        own = dataclasses.replace(own, psd=0.5 * own.psd)
    whole = total if alone else own
    white = own if own is not None else total
    if whole is None or white is None:
        return trace
    whole, white = (
        dataclasses.replace(n, psd=np.maximum(n.psd, _quantisation_variance(trace))) for n in (whole, white)
    )
    close = abs(math.log(trace.fs / white.fs)) < 0.02 and trace.low_pass_hz == white.low_pass_hz
    if close:
        trace = dataclasses.replace(trace, sigma=white.sigma, sigma_dof=float(white.dof.sum()))
    if whole.white and close and not (alone and own is not None):
        return trace
    whole, own = whole.smoothed().widened(), None if own is None else own.smoothed().widened()
    hz = np.geomspace(trace.fs / (2.0 * len(trace.t)), trace.fs / 2.0, 3 * _BANDS)
    hz = np.unique(np.concatenate([hz, whole.hz[whole.hz < 0.5 * trace.fs]]))
    trace = dataclasses.replace(trace, psd=spectrum_at(whole, hz, trace.fs, trace.low_pass_hz), psd_hz=hz)
    if own is not None:
        own = dataclasses.replace(own, psd=np.maximum(own.psd, _quantisation_variance(trace)))
    return (
        dataclasses.replace(trace, own_psd=spectrum_at(own, hz, trace.fs, trace.low_pass_hz))
        if own is not None
        else trace
    )


def with_added_variance(trace: Trace, variance: Array) -> Trace:
    """`trace` with additional noise of `variance` (3,), which is not stationary: a spectrum."""
    if trace.sigma is None and trace.psd is None:
        return trace
    psd, hz = trace.psd, trace.psd_hz
    if psd is None or hz is None:
        assert trace.sigma is not None
        psd, hz = np.tile(trace.sigma**2, (2, 1)), np.array([0.0, 0.5 * trace.fs])
    return dataclasses.replace(
        trace,
        sigma=None if trace.sigma is None else np.sqrt(trace.sigma**2 + variance),
        psd=psd + variance,
        psd_hz=hz,
        own_psd=None if trace.own_psd is None else trace.own_psd + variance,
    )


def _quantisation_variance(trace: Trace) -> float:
    """Variance of the rounding, twice for a difference: the least possible noise."""
    return trace.quantum**2 / 12.0 * (1.0 if trace.against is None else 2.0)


def spectrum_at(noise: ResidualSpectrum, hz: Array, fs: float, low_pass_hz: float | None) -> Array:
    """The spectrum at `hz` in samples of rate `fs`, behind the filter `low_pass_hz`.

    It is converted as a density, and to the other filter as far as its own filter passes it; beyond, the nearest band
    is used.
    """
    filtered = low_pass_hz != noise.low_pass_hz
    known = noise.hz <= _SEEN * (noise.low_pass_hz or np.inf) if filtered else np.ones(len(noise.hz), dtype=bool)
    at = noise.hz[known]
    change = (filter_gain(at, low_pass_hz) / filter_gain(at, noise.low_pass_hz)) ** 2 * (fs / noise.fs)
    logs = np.log(noise.psd[known] * change[:, None])
    return np.asarray(np.exp(np.column_stack([np.interp(np.log(hz), np.log(at), column) for column in logs.T])))


def noise_frequencies(trace: Trace) -> Array:
    """Frequencies (K,) of the noise spectrum of `trace`; empty if white or unknown."""
    return np.zeros(0) if trace.psd_hz is None else trace.psd_hz


def psd_at(trace: Trace, hz: Array) -> Array:
    """The noise spectrum (K, 3) of `trace` at `hz` (K,); it has a spectrum or a `sigma`."""
    if trace.psd is None:
        assert trace.sigma is not None
        return np.tile(trace.sigma**2, (len(hz), 1))
    return np.column_stack([np.interp(hz, noise_frequencies(trace), column) for column in trace.psd.T])


def own_psd_at(trace: Trace, hz: Array) -> Array | None:
    """The same of the sensor alone; None if unknown."""
    if trace.own_psd is None:
        return None
    return np.column_stack([np.interp(hz, noise_frequencies(trace), column) for column in trace.own_psd.T])


def squared_residuals(trace: Trace) -> Array:
    """Squares (n, 3) of the observed residual about its median."""
    residual = trace.residual[trace.observed]
    return np.asarray((residual - np.median(residual, axis=0)) ** 2)
