"""Derivatives of a recorded pose, up to the frequency where its own noise takes over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.interpolate import CubicSpline

from mavcal.calib.gap.reference.signal import Signal

Array = NDArray[np.float64]

_OPEN = 0.9  # cut-offs beyond this share of the Nyquist frequency are none
_LOWEST_HZ = 1.0  # of a cut-off
_STEEP = 8
"""Steepness of the filter's edge: half an octave below its cut-off it takes away 4 %, an octave below 0.3 %.

A Gaussian (2) takes 16 % there, and every sensor would look louder than its reference.
"""


@dataclass(frozen=True, eq=False)
class SmoothedSignal:
    """Values (N, k) and their first two derivatives on a uniform grid `t`; `cutoff_hz` is None if nothing was smoothed.

    `noise` (k,) is the standard deviation of what was left out.
    """

    t: Array
    values: Array
    first: Array
    second: Array
    cutoff_hz: float | None
    noise: Array


def smoothed(signal: Signal, cutoff_hz: float | None = None) -> SmoothedSignal:
    """Low-passed at `cutoff_hz`; None: as it is.

    The filter has no phase, is flat up to its edge and at half amplitude at the cut-off.
    """
    step = float(np.median(np.diff(signal.t)))
    t = signal.t[0] + step * np.arange(int(np.floor((signal.t[-1] - signal.t[0]) / step + 1e-6)) + 1)
    values = signal.at(t)
    noise = np.zeros(values.shape[1])
    if cutoff_hz is not None:
        line = values[0] + (values[-1] - values[0]) * ((t - t[0]) / max(t[-1] - t[0], step))[:, None]
        spectrum = dct(values - line, axis=0, norm="ortho")
        hz = np.arange(len(t)) / (2.0 * step * len(t))
        kept = spectrum * np.exp2(-((hz / cutoff_hz) ** _STEEP))[:, None]
        noise = np.sqrt(((spectrum - kept) ** 2).sum(axis=0) / len(t))
        values = line + idct(kept, axis=0, norm="ortho")
    spline = CubicSpline(t, values, axis=0)
    return SmoothedSignal(t, values, spline(t, 1), spline(t, 2), cutoff_hz, noise)


def bandwidth(t: Array, derived: Array, measured: Array) -> float | None:
    """Frequency up to which `derived` (N, 3), uniform in `t`, tells of `measured` (N, 3) more than noise; None: all.

    A band of it helps where ``|m - d|^2 < |m|^2``: the cut-off is where the sum of what is gained is largest. What the
    sensor adds of its own raises both sides alike.
    """
    d, m = (dct(x - x.mean(axis=0), axis=0, norm="ortho") for x in (derived, measured))
    gained = np.cumsum((2.0 * m * d - d**2).sum(axis=1))
    hz = np.arange(len(t)) / (2.0 * (t[1] - t[0]) * len(t))
    best = float(hz[int(np.argmax(gained))])
    return None if best > _OPEN * hz[-1] else max(best, _LOWEST_HZ)
