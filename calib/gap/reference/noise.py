"""Noise that a nominal recording shows: white, or a spectrum."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from calib.gap.problem import Trace
from calib.gap.reference.calibrated import filter_gain

Array = NDArray[np.float64]

_BANDS = 28
_COLOURED = 6.0  # standard deviations by which the band furthest from white must be off
_FEWEST = 64
_SEEN = 5.0  # times the filter's cut-off, beyond which too little is left to be brought back


@dataclass(frozen=True, eq=False)
class Noise:
    """Spectrum of the residual of nominal recordings per DCT bin: `psd` (K, 3) in variance of one sample on `hz` (K,).

    `dof` (K,) are the squared coefficients that each band was averaged from; `fs` their sampling rate, `low_pass_hz`
    the firmware's filter that is in it.
    """

    hz: Array
    psd: Array
    dof: Array
    fs: float
    low_pass_hz: float | None = None

    @property
    def sigma(self) -> Array:
        """Of one sample, if it is white, (3,)."""
        return np.asarray(np.sqrt(self.dof @ self.psd / self.dof.sum()))

    @property
    def white(self) -> bool:
        """Whether every band agrees with the mean of all."""
        off = np.abs(self.psd / self.sigma**2 - 1.0) * np.sqrt(self.dof / 2.0)[:, None]
        return bool(off.max() < _COLOURED)


def learned(trace: Trace) -> Noise | None:
    """The noise in the residual of a nominal `trace`; None if it is too short or has too many holes."""
    n = len(trace.t)
    if n < _FEWEST or trace.observed.mean() < 0.9:
        return None
    residual = trace.residual - trace.residual[trace.observed].mean(axis=0)
    residual[~trace.observed] = 0.0
    power = dct(residual, axis=0, norm="ortho")[1:] ** 2 / trace.observed.mean()
    bins = np.arange(1, n)
    edges = np.unique(np.concatenate([np.rint(np.geomspace(1.0, n, _BANDS + 1))])).astype(np.intp)
    group = np.searchsorted(edges, bins, side="right") - 1
    count = np.bincount(group).astype(np.float64)
    mean = np.column_stack([np.bincount(group, weights=column) for column in power.T]) / count[:, None]
    centre = np.exp(np.bincount(group, weights=np.log(bins)) / count) * trace.fs / (2.0 * n)
    return Noise(centre, np.maximum(mean, np.finfo(float).tiny), count, trace.fs, trace.low_pass_hz)


def with_noise(trace: Trace, noise: Noise) -> Trace:
    """`trace` with that noise declared: its standard deviation if it is white, else its spectrum too.

    A noise of another sampling rate is carried over as a density, and one of a filtered channel is brought to the
    trace's own filter as far as it was still to be seen; where it says nothing, the nearest band holds.
    """
    same = abs(math.log(trace.fs / noise.fs)) < 0.02 and trace.low_pass_hz == noise.low_pass_hz
    dof = float(noise.dof.sum())
    if noise.white:
        return dataclasses.replace(trace, sigma=noise.sigma, sigma_dof=dof) if same else trace
    hz = np.geomspace(trace.fs / (2.0 * len(trace.t)), trace.fs / 2.0, 3 * _BANDS)
    known = noise.hz <= _SEEN * (noise.low_pass_hz or np.inf) if not same else np.ones(len(noise.hz), dtype=bool)
    at = noise.hz[known]
    change = (filter_gain(at, trace.low_pass_hz) / filter_gain(at, noise.low_pass_hz)) ** 2 * (trace.fs / noise.fs)
    logs = np.log(noise.psd[known] * change[:, None])
    psd = np.exp(np.column_stack([np.interp(np.log(hz), np.log(at), column) for column in logs.T]))
    return dataclasses.replace(trace, sigma=noise.sigma if same else None, sigma_dof=dof, psd=psd, psd_hz=hz)
