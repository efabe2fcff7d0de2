"""Known drift of a sensor's raw reading with temperature, with uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib.firmware import losses
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import ThermalPolynomial

Temperature = float | None
"""degC; None: not streamed."""

DRIFT_PER_DEGC: Final = {Sensor.ACCEL: 5e-3, Sensor.GYRO: 5e-4, Sensor.MAG: 0.0}
"""Offset change per degC where no polynomial is known: 0.5 mg and 0.03 deg/s, data sheets of the IMUs in use."""
UNKNOWN_TEMPERATURE: Final = 5.0  # degC of change that is allowed for where none was streamed


@dataclass(frozen=True, eq=False)
class KnownDrift:
    """A polynomial (None: none is known) with the covariance (3k, 3k) of its coefficients, axis by axis.

    `open_axes`: axes whose drift was not determined, or that have no polynomial.
    """

    sensor: Sensor
    polynomial: ThermalPolynomial | None
    covariance: Array
    open_axes: tuple[bool, bool, bool]

    def shift(self, then: Temperature, now: Sequence[Temperature]) -> Array:
        """Change (K, 3) of the raw reading from `then` to each of `now`; zero where it is not known."""
        if self.polynomial is None or then is None:
            return np.zeros((len(now), 3))
        return self.polynomial(self._filled(then, now)) - self.polynomial(then)

    def jacobian(self, then: Temperature, now: Sequence[Temperature]) -> Array:
        """Derivative (K, 3, 3k) of :meth:`shift` with respect to the coefficients."""
        degree = 0 if self.polynomial is None else self.polynomial.coefficients.shape[1]
        result = np.zeros((len(now), 3, 3 * degree))
        if self.polynomial is None or then is None:
            return result
        steps = self._powers(self._filled(then, now)) - self._powers(np.array([then]))
        for axis in range(3):
            result[:, axis, axis * degree : (axis + 1) * degree] = steps
        return result

    def allowance(self, then: Temperature, now: Sequence[Temperature]) -> Array:
        """Standard deviation (K,) to allow for an axis whose drift is not known."""
        change = [UNKNOWN_TEMPERATURE if then is None or t is None else abs(t - then) for t in now]
        return DRIFT_PER_DEGC[self.sensor] * np.array(change)

    def uncertainty(self, then: Temperature, now: Sequence[Temperature], weights: Array) -> Array:
        """Covariance (3G, 3G) of the weighted means ``weights @ shift``, `weights` of shape (G, K)."""
        size = 3 * len(weights)
        jacobian = np.einsum("gk,kap->gap", weights, self.jacobian(then, now)).reshape(size, -1)
        moved = weights @ self.allowance(then, now)
        opened = np.diag(np.array(self.open_axes, dtype=np.float64))
        return np.asarray(jacobian @ self.covariance @ jacobian.T + np.kron(np.outer(moved, moved), opened))

    def staleness(self, now: Sequence[Temperature], sds: Sequence[float], weights: Array) -> Array:
        """Covariance (3G, 3G) of ``weights @ shift`` by thermometers that are off by `sds` (K,), degC, all one way."""
        if self.polynomial is None:
            return np.zeros((3 * len(weights), 3 * len(weights)))
        heat = self._filled(self.polynomial.t_ref, now)
        moved = weights @ (self.polynomial(heat + np.array(sds)) - self.polynomial(heat))
        return np.diag(moved.ravel() ** 2)

    def _filled(self, then: float, now: Sequence[Temperature]) -> Array:
        return np.array([then if t is None else t for t in now])

    def _powers(self, t: Array) -> Array:
        assert self.polynomial is not None
        d = np.clip(t, self.polynomial.t_min, self.polynomial.t_max) - self.polynomial.t_ref
        return d[:, None] ** np.arange(1, self.polynomial.coefficients.shape[1] + 1)


def known_drift(sensor: Sensor, fit: FitResult | None, in_force: ThermalPolynomial | None) -> KnownDrift:
    """The drift of `fit` (a thermal one), else the one in force, which is taken as exact, else none."""
    if fit is not None and fit.model.polynomial is not None:
        degree = fit.degree
        opened = tuple(not fit.determined(*(f"poly{j + 1}_{a}" for j in range(degree))) for a in AXES)
        return KnownDrift(
            sensor,
            fit.model.polynomial,
            fit.covariance[losses.POLYNOMIAL :, losses.POLYNOMIAL :],
            (opened[0], opened[1], opened[2]),
        )
    degree = 0 if in_force is None else in_force.coefficients.shape[1]
    unknown = in_force is None
    return KnownDrift(sensor, in_force, np.zeros((3 * degree, 3 * degree)), (unknown, unknown, unknown))
