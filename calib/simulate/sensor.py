"""The forward model of a three-axis sensor: what it reads of the truth.

``y = (1 + s (T - t_ref)) * (M x + b + p(T) + G f + noise)``, then clipped to the range, then made discrete: the order
of MATLAB's ``imuSensor``. With ``s = 0`` and ``G = 0`` that is the sensor equation of :mod:`calib.triad`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Rounding
from mavcal.calib.simulate.noise import flicker, random_walk, white
from mavcal.calib.triad import ThermalPolynomial, TriadModel

_PER_AXIS = ("bias", "noise_density", "bias_instability", "random_walk", "temperature_scale")


@dataclass(frozen=True, eq=False)
class SensorErrors:
    """Errors of a sensor; the defaults are an ideal one. Units are the sensor's.

    Parameters
    ----------
    bias : shape (3,)
        Reading of a true zero at `t_ref`; the magnetometer's hard iron.
    matrix : shape (3, 3)
        ``M``: scale on the diagonal, misalignment beside it; the magnetometer's soft iron.
    noise_density : shape (3,)
        ``N`` of the Allan deviation ``N / sqrt(tau)``, unit per root hertz; a sample has ``N sqrt(rate)``.
    bias_instability : shape (3,)
        ``B`` of flicker noise, whose Allan deviation is flat at ``0.664 B``.
    instability_poles : shape (k,) or None
        Denominator of the filter that colours the flicker (its numerator is 1); None: flicker over all scales.
    random_walk : shape (3,)
        ``K`` of the Allan deviation ``K sqrt(tau / 3)``, unit times root hertz.
    temperature : shape (3, k)
        Bias per degC, per degC^2 ..., of ``T - t_ref``, not clamped.
    temperature_scale : shape (3,)
        Relative change per degC of all the above.
    g_sensitivity : shape (3, 3)
        ``G``: rad/s per m/s2 of specific force, for gyroscopes.
    thermal_lag : float
        Seconds by which the thermometer lags the die: ``T_die = T + lag dT/dt``.
    full_scale : float
        Largest reading of either sign; infinite where there is none.
    resolution, rounding
        Step of the numbers (0: none), and how they are rounded.
    """

    bias: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    matrix: Array = dataclasses.field(default_factory=lambda: np.eye(3))
    noise_density: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    bias_instability: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    instability_poles: Array | None = None
    random_walk: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    t_ref: float = 25.0
    temperature: Array = dataclasses.field(default_factory=lambda: np.zeros((3, 0)))
    temperature_scale: Array = dataclasses.field(default_factory=lambda: np.zeros(3))
    g_sensitivity: Array = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))
    thermal_lag: float = 0.0
    full_scale: float = np.inf
    resolution: float = 0.0
    rounding: Rounding = Rounding.NEAREST

    def __post_init__(self) -> None:
        for name in _PER_AXIS:
            object.__setattr__(self, name, _shaped(name, getattr(self, name), (3,)))
        for name in ("matrix", "g_sensitivity"):
            object.__setattr__(self, name, _shaped(name, getattr(self, name), (3, 3)))
        columns = np.asarray(self.temperature, dtype=np.float64)
        degree = columns.shape[-1] if columns.ndim == 2 else 1
        object.__setattr__(self, "temperature", _shaped("temperature", columns, (3, degree)))
        if self.instability_poles is not None:
            poles = _shaped("instability_poles", self.instability_poles, np.shape(self.instability_poles))
            if poles.ndim != 1 or not len(poles) or poles[0] == 0.0:
                raise InvalidInputError("the poles of the bias instability are a row of numbers, the first not zero")
            object.__setattr__(self, "instability_poles", poles)
        self._check()

    def _check(self) -> None:
        for name in ("noise_density", "bias_instability", "random_walk"):
            if (getattr(self, name) < 0.0).any():
                raise InvalidInputError(f"{name} is a size and not negative: {getattr(self, name)}")
        if not (self.full_scale > 0.0 and self.resolution >= 0.0 and np.isfinite(self.resolution)):
            raise InvalidInputError(
                f"the range is positive and the resolution not negative: {self.full_scale} and {self.resolution}"
            )
        if not (np.isfinite(self.t_ref) and np.isfinite(self.thermal_lag)):
            raise InvalidInputError("t_ref and thermal_lag are finite numbers")
        if not np.linalg.cond(self.matrix) < 1e6:
            raise InvalidInputError("the matrix of a sensor has an inverse: its axes lie in one plane")

    @property
    def drift(self) -> ThermalPolynomial | None:
        """``p(T)``, not clamped; None where temperature has no effect on the bias."""
        if not self.temperature.any():
            return None
        return ThermalPolynomial(self.t_ref, -np.inf, np.inf, self.temperature)

    @property
    def correction(self) -> TriadModel:
        """The correction that a perfect calibration finds at constant scale: ``M^-1 (y - b - p(T))``."""
        return TriadModel(self.bias, np.asarray(np.linalg.inv(self.matrix), dtype=np.float64), self.drift)

    def systematic(self, truth: Array, temperature: Array | None = None, force: Array | None = None) -> Array:
        """The reading (N, 3) of `truth` (N, 3) before noise, range and resolution.

        Parameters
        ----------
        truth : shape (N, 3)
            What an ideal sensor reads.
        temperature : shape (N,) or None
            Temperature of the die, degC; None: `t_ref` throughout.
        force : shape (N, 3) or None
            Specific force, m/s2; None: none.
        """
        y = truth @ self.matrix.T + self.bias
        if temperature is not None and self.drift is not None:
            y = y + self.drift(temperature)
        if force is not None:
            y = y + force @ self.g_sensitivity.T
        return y * self._growth(temperature)

    def random(self, count: int, rate: float, rng: np.random.Generator) -> Array:
        """Noise (count, 3) of samples at `rate` per second, drawn in the order white, flicker, walk."""
        return np.asarray(
            white(rng, count, self.noise_density, rate)
            + flicker(rng, count, self.bias_instability, self.instability_poles)
            + random_walk(rng, count, self.random_walk, rate),
            dtype=np.float64,
        )

    def read(
        self,
        truth: Array,
        rate: float,
        rng: np.random.Generator,
        *,
        temperature: Array | None = None,
        force: Array | None = None,
    ) -> SimulatedReadings:
        """Readings of the sensor: :meth:`systematic` with noise, clipped and made discrete."""
        noise = self.random(len(truth), rate, rng) * self._growth(temperature)
        return self.discrete(self.systematic(truth, temperature, force) + noise)

    def discrete(self, values: Array) -> SimulatedReadings:
        """`values` (N, 3) clipped to the range and rounded; truncated ones become the middles of their bins."""
        clipped = np.clip(values, -self.full_scale, self.full_scale)
        if self.resolution == 0.0 or self.rounding == Rounding.NONE:
            return SimulatedReadings(clipped, None)
        if self.rounding == Rounding.NEAREST:
            return SimulatedReadings(self.resolution * _nearest(clipped / self.resolution), None)
        k = np.trunc(clipped / self.resolution)
        return SimulatedReadings(self.resolution * (k + 0.5 * np.sign(k)), np.asarray(k == 0.0))

    def _growth(self, temperature: Array | None) -> Array:
        if temperature is None:
            return np.ones((1, 3))
        growth = 1.0 + self.temperature_scale * (np.asarray(temperature)[:, None] - self.t_ref)
        return np.asarray(growth, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SimulatedReadings:
    """Samples (N, 3) of a sensor; `zero_bin` (N, 3) is True where truncation left a double-width bin, None: nowhere."""

    values: Array
    zero_bin: NDArray[np.bool_] | None


def _nearest(x: Array) -> Array:
    """Nearest integers with halves away from zero, as in hardware and MATLAB; numpy rounds halves to even."""
    return np.asarray(np.sign(x) * np.floor(np.abs(x) + 0.5), dtype=np.float64)


def _shaped(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        array = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), shape))
    except (TypeError, ValueError):
        raise InvalidInputError(f"{name} of a sensor has shape {shape}, not {np.shape(value)}") from None
    if not np.isfinite(array).all():
        raise InvalidInputError(f"{name} of a sensor is finite: {array.tolist()}")
    return array
