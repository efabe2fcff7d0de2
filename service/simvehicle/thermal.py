"""Temperatures of the sensors as a function of vehicle time: constant, or a warm-up curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mavcal.service.simvehicle.rotation import Array


@dataclass(frozen=True)
class Curve:
    """T(t) = end − (end − start)·exp(−(t − t0)/tau): a warm-up; constant where start equals end. Units °C and s."""

    start: float
    end: float
    tau: float = 60.0
    t0: float = 0.0

    def at(self, t: Array) -> Array:
        """Temperature at vehicle times t (N,)."""
        elapsed = np.maximum(t - self.t0, 0.0)
        return np.asarray(self.end - (self.end - self.start) * np.exp(-elapsed / self.tau))


class Thermal:
    """The board's temperature, and each IMU's own: an offset, and a lag of first order where configured."""

    def __init__(self, start: float, offsets: Array, lag_s: float = 0.0) -> None:
        self._curve = Curve(start, start)
        self._offsets = offsets
        self._lag = lag_s
        self._lagged = start
        self._lagged_at = 0.0

    def board(self, t: Array) -> Array:
        """Board temperature at times t, °C."""
        return self._curve.at(t)

    def imu(self, instance: int, t: Array) -> Array:
        """Temperature of one IMU at times t, °C."""
        return np.asarray(self._core(t) + self._offsets[instance])

    def _core(self, t: Array) -> Array:
        if self._lag <= 0:
            return self._curve.at(t)
        # Response of a first-order lag to an exponential: exact, from the state kept at the last change of curve.
        c, dt = self._curve, np.maximum(t - self._lagged_at, 0.0)
        span = c.start - c.end
        if abs(c.tau - self._lag) < 1e-9:
            forced = span * (dt / self._lag) * np.exp(-dt / self._lag)
        else:
            forced = span * c.tau / (c.tau - self._lag) * (np.exp(-dt / c.tau) - np.exp(-dt / self._lag))
        return np.asarray(c.end + forced + (self._lagged - c.end) * np.exp(-dt / self._lag))

    def warm_up(self, t: float, start: float, end: float, tau_s: float) -> None:
        """Begin a warm-up curve now; every IMU that lags keeps the temperature it has."""
        self._remember(t)
        self._curve = Curve(start, end, max(tau_s, 1e-6), t)

    def hold(self, t: float, value: float) -> None:
        """Hold the board at this temperature from now on."""
        self._remember(t)
        self._curve = Curve(value, value, t0=t)

    def _remember(self, t: float) -> None:
        self._lagged, self._lagged_at = float(self._core(np.array([t]))[0]), t

    def restart(self, elapsed: float) -> None:
        """Vehicle time begins again at zero after `elapsed` seconds; the temperature goes on."""
        c = self._curve
        self._curve = Curve(c.start, c.end, c.tau, c.t0 - elapsed)
        self._lagged_at -= elapsed
