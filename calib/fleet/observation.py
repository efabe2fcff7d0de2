"""A measured bias of one sensor, and its limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from mavcal.calib.preflight import limits
from mavcal.calib.preflight.limits import Limit
from mavcal.calib.recording import Sensor

Triple = tuple[float, float, float]


class ObservationSource(StrEnum):
    """Where a measurement comes from."""

    JOB = "job"  # a calibration that succeeded
    PREFLIGHT = "preflight"  # a gyroscope at rest, read under the calibration in force then


@dataclass(frozen=True)
class BiasObservation:
    """The bias of a sensor as it was measured once, raw: whatever was corrected then is taken out.

    Parameters
    ----------
    at
        Wall-clock time, s since 1970.
    bias, sd
        Along the sensor's axes, with their standard deviations, in m/s2, rad/s or uT.
    temperature
        Temperature of the sensor, degC; None: not known.
    applied
        Whether the sensor is corrected by this very bias from then on.
    """

    at: float
    bias: Triple
    sd: Triple
    temperature: float | None = None
    applied: bool = True


@dataclass(frozen=True)
class BiasLimit:
    """How far a bias may wander from what corrects it, and the unit in which people read that."""

    limit: Limit
    per_unit: float
    """What one unit of the domain (m/s2, rad/s, uT) is in the unit of the limit."""

    @property
    def value(self) -> float:
        """The limit in the unit of the domain."""
        return self.limit.value / self.per_unit


BIAS_LIMITS: Final[Mapping[Sensor, BiasLimit]] = MappingProxyType(
    {
        Sensor.GYRO: BiasLimit(limits.GYRO_REST, math.degrees(1.0)),
        Sensor.ACCEL: BiasLimit(limits.ACCEL_FORCE, 1.0),
        Sensor.MAG: BiasLimit(limits.COMPASS_FIELD, 1.0),
    }
)
"""Those of the preflight: beyond it, the preflight of the vehicle would fail or warn."""
