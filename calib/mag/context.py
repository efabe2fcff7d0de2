"""Facts about sensor and field that a compass fit needs beside the samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.earth import EarthField
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitBuilder
from mavcal.calib.mag.heading import DEFAULT_INCLINATION
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MagContext:
    """Facts about sensor and field, beside the samples.

    Parameters
    ----------
    unit
        Of the samples: ``uT`` or ``counts``.
    noise_sd
        Noise of one axis in that unit, without quantisation; None: from the residuals.
    quantum
        Width of a quantisation bin; its ``q^2/12`` is added to the variance of `noise_sd`.
    field
        The true field: its strength ties the scale, its dip the heading error. None: scale and dip are unknown.
    body_from_sensor
        Mounting rotation (3, 3), for the heading error only; None: the sensor's axes are the vehicle's.
    compensated
        Whether the vehicle has a compensation of the motors' field in force.
    times
        Of the samples, s, (N,), where their residuals are to be searched for blur and lag; None: not known.
    """

    instance: int = 0
    unit: str = "uT"
    noise_sd: float | None = None
    quantum: float = 0.0
    field: EarthField | None = None
    body_from_sensor: Array | None = None
    relative: bool = False
    temperature: float | None = None
    compensated: bool = False
    times: Array | None = None

    def __post_init__(self) -> None:
        if self.noise_sd is not None and not (math.isfinite(self.noise_sd) and self.noise_sd > 0.0):
            raise InvalidInputError(f"noise of a magnetometer must be positive, not {self.noise_sd}")
        if not (math.isfinite(self.quantum) and self.quantum >= 0.0):
            raise InvalidInputError(f"a quantisation bin cannot be {self.quantum} wide")

    def made(self, method: str, n_samples: int, movement: str = "") -> FitBuilder:
        """A builder for the result of a method with this number of samples."""
        return FitBuilder(
            method, Sensor.MAG, self.instance, self.unit, n_samples, self.relative, self.temperature, movement
        )

    @property
    def noise_variance(self) -> float | None:
        """Variance of one axis with quantisation, in the unit of the samples squared; None: not known."""
        return None if self.noise_sd is None else self.noise_sd**2 + self.quantum**2 / 12.0

    @property
    def strength(self) -> float | None:
        """Length of the corrected vectors, uT; None: the mean radius of the ellipsoid."""
        return None if self.field is None else self.field.norm

    @property
    def inclination(self) -> float:
        """Dip of the field, rad."""
        return DEFAULT_INCLINATION if self.field is None else self.field.inclination


class MagFacts(TypedDict, total=False):
    """Keyword arguments of every magnetometer fit: the parameters of :class:`MagContext`."""

    instance: int
    unit: str
    noise_sd: float | None
    quantum: float
    field: EarthField | None
    body_from_sensor: Array | None
    relative: bool
    temperature: float | None
    compensated: bool
    times: Array | None
