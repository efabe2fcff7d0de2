"""Series on one grid: anti-aliased sampling, and filters by their frequency response.

A firmware's filter at 400 Hz differs from the same filter designed for 100 Hz: at its corner it is late by a quarter of
a row. Differences of neighbours and delays by interpolation err likewise. Frequency responses are exact.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

Array = NDArray[np.float64]
Response = NDArray[np.complex128]

PASSED: Final = 0.35
"""Pass band as a fraction of the grid's rate. Source: torque is judged up to a fifth of it."""
_FASTER: Final = 1.2
"""Rate, relative to the grid's, above which a series is low-passed first. Chosen, not measured: loops jitter by
less."""
_PADDED_S: Final = 2.0
"""Padding at either end of a series, s. Source: ten lags of 0.2 s, the longest of a small vehicle (AIRFRAME 2)."""


def kept_below(values: Array, rate: float, grid_hz: float) -> Array:
    """`values` (N, k) at `rate` Hz, low-passed with zero phase against aliasing on a grid of `grid_hz`."""
    corner = PASSED * grid_hz
    if rate < _FASTER * grid_hz or len(values) < 50:
        return values
    return np.asarray(sosfiltfilt(butter(4, corner, fs=rate, output="sos"), values, axis=0))


def kept_power(hz: Array, rate: float, grid_hz: float) -> Array:
    """Power gain of :func:`kept_below` at `hz`."""
    if rate < _FASTER * grid_hz:
        return np.ones_like(hz)
    return np.asarray((1.0 + (hz / (PASSED * grid_hz)) ** 8) ** -2.0)


def spline(stamps: Array, values: Array) -> CubicSpline:
    """A spline through `values` (N, k) at `stamps` (N,); stamps that do not increase are dropped."""
    new = np.concatenate([[True], np.diff(np.maximum.accumulate(stamps)) > 0.0])
    return CubicSpline(stamps[new], values[new])


class Grid:
    """Filters for series of `rows` rows at `fs` Hz, which begin settled at their first value."""

    def __init__(self, rows: int, fs: float) -> None:
        self._rows, self._lead = rows, round(_PADDED_S * fs)
        self._size = next_fast_len(rows + 2 * self._lead, real=True)
        self._s = 2j * np.pi * rfftfreq(self._size, 1.0 / fs)

    def spectrum(self, values: Array) -> Response:
        """Spectrum of a series (N, k), padded back to its first value, so that its end does not wrap around."""
        left = self._size - self._rows - self._lead
        back = 0.5 + 0.5 * np.cos(np.pi * (np.arange(left) + 0.5) / left)
        after = values[:1] + back[:, None] * (values[-1:] - values[:1])
        return np.asarray(rfft(np.vstack([np.repeat(values[:1], self._lead, axis=0), values, after]), axis=0))

    def series(self, spectrum: Response, response: Response | None = None) -> Array:
        """The series (N, k) of a spectrum, through `response`."""
        whole = irfft(spectrum if response is None else spectrum * response[:, None], n=self._size, axis=0)
        return np.asarray(whole[self._lead : self._lead + self._rows])

    def through(self, values: Array, response: Response | None) -> Array:
        """`values` (N, k) through a filter; None changes nothing."""
        return values if response is None else self.series(self.spectrum(values), response)

    def butterworth(self, corner_hz: float) -> Response | None:
        """Response of the firmwares' ``LowPassFilter2p``; None without a filter, or with a corner above Nyquist."""
        if not 0.0 < corner_hz < 0.5 * self._s[-1].imag / np.pi:
            return None
        s = self._s / (2.0 * np.pi * corner_hz)
        return np.asarray(1.0 / (s**2 + np.sqrt(2.0) * s + 1.0))

    def behind(self, delay: float, tau: float) -> Response:
        """Response of a delay, s, and a lag of the first order; a negative `tau` is a lead."""
        lag = 1.0 / (1.0 + tau * self._s) if tau >= 0.0 else 1.0 - tau * self._s
        return np.asarray(np.exp(-delay * self._s) * lag)
