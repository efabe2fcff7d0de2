"""Measured biases of one sensor from jobs and preflights, their limits, and the history of each part."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from mavcal.calib.firmware.device_ids import decode_device_id
from mavcal.calib.fit import OFFSETS, FitResult
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.history import Covered
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
    """How far a bias may drift from the correction in force, and the unit for display."""

    limit: Limit
    per_unit: float
    """Factor from the domain's unit (m/s2, rad/s, uT) to the unit of the limit."""

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
"""Limits of the preflight: beyond them, the preflight of the vehicle would fail or warn."""


@dataclass(frozen=True)
class SensorRecord:
    """One sensor as it was measured once.

    Parameters
    ----------
    unit
        Whose sensor it is.
    device_id
        0: not known.
    source, source_id
        A job or a preflight.
    what
        Kind of the job; for a preflight ``rest``.
    applied
        Whether the sensor is corrected by this from then on: written, or found in agreement.
    proved
        Whether the stream showed it after the write, or agreed with it before.
    bias, sd
        Raw, in m/s2, rad/s or uT; None: it was not measured absolutely.
    norm
        What a preflight read: rate or specific force under the calibration in force, in the same units.
    covered
        The temperatures that the calibration covers; None: not known.
    by_itself
        Whether the vehicle calibrates this sensor by itself, say at every start.
    """

    unit: str
    autopilot: str
    sensor: Sensor
    instance: int
    device_id: int
    at: float
    source: ObservationSource
    source_id: str
    what: str
    applied: bool = False
    proved: bool = False
    bias: Triple | None = None
    sd: Triple | None = None
    norm: float | None = None
    temperature: float | None = None
    covered: Covered | None = None
    by_itself: bool = False

    @property
    def type(self) -> str:
        """Name of the part; empty: its device id is not known."""
        if not self.device_id:
            return ""
        return decode_device_id(self.autopilot, self.sensor, self.device_id).type

    @property
    def observation(self) -> BiasObservation | None:
        """The observation for a trend; None: no bias was measured, or it was not proved."""
        if self.bias is None or self.sd is None or not self.proved:
            return None
        return BiasObservation(self.at, self.bias, self.sd, self.temperature, self.applied)


def bias_of(fit: FitResult) -> tuple[Triple, Triple] | None:
    """Bias and standard deviation of a fit; None: it is relative, or an axis is undetermined."""
    if fit.relative or not fit.determined(*OFFSETS):
        return None
    (x, y, z), (sx, sy, sz) = fit.model.offset.tolist(), fit.sd[:3].tolist()
    return ((x, y, z), (sx, sy, sz)) if min(sx, sy, sz) > 0.0 else None  # 0: held fixed


Place = tuple[Sensor, int]


def newest_by_place(records: Iterable[SensorRecord]) -> Mapping[Place, SensorRecord]:
    """The newest record of every sensor of one unit: the parts fitted now."""
    return {(r.sensor, r.instance): r for r in sorted(records, key=lambda r: r.at)}


def history_of_part(records: Iterable[SensorRecord], of: SensorRecord) -> tuple[SensorRecord, ...]:
    """Every record of the same part as `of`, oldest first: a swapped board begins a new history."""
    same = [r for r in records if (r.unit, r.sensor, r.device_id) == (of.unit, of.sensor, of.device_id)]
    if not of.device_id:
        same = [r for r in same if r.instance == of.instance]
    return tuple(sorted(same, key=lambda r: r.at))
