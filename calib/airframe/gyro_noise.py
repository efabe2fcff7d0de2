"""White noise of the gyroscope in the measured angular acceleration, and the gyroscope's filter."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from mavcal.calib.airframe.flown import FlownFlight
from mavcal.calib.airframe.signals import kept_power
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

TORQUE_BAND_HZ: Final = 20.0
"""Highest frequency, Hz, at which torque is judged. Source: AIRFRAME 5.3; above are vibration and the firmware's
filters."""
_LEAST_BINS: Final = 8
"""Least number of bins in a band. Chosen, not measured: the mean power of eight has an error of one half."""
_NOISE_BANDS, _NOISE_HZ = 4, 30.0
"""The quietest of these bands, from `TORQUE_BAND_HZ` to `_NOISE_HZ`, is taken for the gyroscope's noise. Chosen, not
measured: vibration of the rotors fills some bands, and the grid's own filter removes what lies above."""
_QUIETEST: Final = 1.03
"""Standard deviations by which the least of four equal bands lies below their mean. Source: normal order statistics."""
_CORNERS_HZ: Final = (12.0, 15.0, 17.0, 20.0, 23.0, 26.0, 30.0, 35.0, 40.0, 50.0, 60.0)
_PLAINER: Final = 5.0
"""Cutoffs, Hz, that are tried where the log states none, and nats by which one must beat no filter. Source: usual
settings; half the logarithm of the number of bins, for one fitted parameter."""


@dataclass(frozen=True, eq=False)
class GyroNoise:
    """White noise of the gyroscope in one flight.

    `hz` (N,) are the frequencies of cosine bins, `turns` (N, 3) the measured angular acceleration,
    rad/s2, zero where it is not used.
    """

    flight: FlownFlight
    hz: Array
    turns: Array

    @cached_property
    def of_white(self) -> Array:
        """Power (N,) of the angular acceleration on the grid for white noise of power 1 of the gyroscope."""
        return self._unfiltered * _passed(self.hz, self._corner_hz)

    @cached_property
    def _unfiltered(self) -> Array:
        flight = self.flight
        w = 2.0 * np.pi * self.hz / flight.inertial_hz
        slope = flight.inertial_hz * 3.0 * np.sin(w) / (2.0 + np.cos(w))  # of the cubic spline through the rates
        return np.asarray(slope**2 * kept_power(self.hz, flight.inertial_hz, flight.fs))

    @cached_property
    def _noise_edges(self) -> NDArray[np.intp]:
        """Edges, in bins, of the bands of the gyroscope's noise; empty if the bands do not fit."""
        highest = min(0.45 * self.flight.inertial_hz, _NOISE_HZ)
        edges = np.searchsorted(self.hz, np.linspace(TORQUE_BAND_HZ, highest, _NOISE_BANDS + 1))
        roomy = highest >= 1.5 * TORQUE_BAND_HZ and (np.diff(edges) >= _LEAST_BINS).all()
        return edges if roomy else edges[:0]

    @cached_property
    def _by_white(self) -> Array:
        """Power (N, 3) of the measured turns over that of unfiltered white noise."""
        return np.asarray(dct(self.turns, axis=0, norm="ortho") ** 2 / np.maximum(self._unfiltered, 1e-12)[:, None])

    @cached_property
    def _corner_hz(self) -> float:
        """Cutoff of the gyroscope's filter: as logged, or else the one that makes the noise whitest; 0: no filter."""
        stated, edges = self.flight.cutoff_hz.get(Sensor.GYRO, 0.0), self._noise_edges
        if stated > 0.0 or not len(edges):
            return stated
        rows = slice(edges[0], edges[-1])
        power, hz = self._by_white[rows], self.hz[rows]

        def loglik(corner: float) -> float:
            passed = _passed(hz, corner)[:, None]
            level = np.maximum((power / passed).mean(axis=0), 1e-300)
            return float(-0.5 * (np.log(passed).sum() * 3.0 + len(hz) * np.log(level).sum()))

        best = max(_CORNERS_HZ, key=loglik)
        return best if loglik(best) > loglik(0.0) + _PLAINER else 0.0

    @cached_property
    def power(self) -> Array:
        """Power (3,) of the gyroscope's white noise, from the quietest band above the judged ones; 0 without one."""
        edges = self._noise_edges
        if not len(edges):
            return np.zeros(3)
        white = self._by_white / _passed(self.hz, self._corner_hz)[:, None]
        bands = [white[low:high].mean(axis=0) for low, high in itertools.pairwise(edges)]
        by_chance = 1.0 - _QUIETEST * math.sqrt(2.0 / float(np.diff(edges).mean()))
        return np.asarray(np.min(bands, axis=0) / by_chance / max(float(self.flight.usable.mean()), 1e-9))


def _passed(hz: Array, corner: float) -> Array:
    """Power gain of a second-order filter; corner 0: one."""
    return 1.0 / (1.0 + (hz / corner) ** 4) if corner > 0.0 else np.ones_like(hz)
