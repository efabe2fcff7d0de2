"""Status of a unit: its sensors, their trends and ages, and why it should be calibrated again.

Each axis is also compared with the median of its type in the fleet, in robust standard deviations (1.4826 times the
median distance from it). In 1 of 100 healthy groups of any size the oddest axis exceeds the limit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from functools import cached_property
from types import MappingProxyType
from typing import Final

import numpy as np
import scipy

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fleet.record import BIAS_LIMITS, BiasObservation, SensorRecord, history_of_part, newest_by_place
from mavcal.calib.fleet.trend import DAY_S, Leaving, Open, Quantity, Trend, bias_trend
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import CheckId, Verdict
from mavcal.calib.preflight.history import Covered
from mavcal.calib.recording import Array, Sensor

NAMES: Final = MappingProxyType({Sensor.ACCEL: "accelerometer", Sensor.GYRO: "gyroscope", Sensor.MAG: "compass"})
TREATED: Final[Mapping[CheckId, tuple[Sensor, ...]]] = MappingProxyType(
    {
        CheckId.GYRO_REST: (Sensor.GYRO,),
        CheckId.ACCEL_FORCE: (Sensor.ACCEL,),
        CheckId.COMPASS_FIELD: (Sensor.MAG,),
        CheckId.COMPASS_DIRECTION: (Sensor.MAG,),
        CheckId.TEMPERATURE: (Sensor.ACCEL, Sensor.GYRO),
        CheckId.SENSOR_IDS: (),
        CheckId.PARAMETERS_CHANGED: (),
    }
)
"""Preflight checks that a calibration repairs, with the sensors whose newer calibration makes a failure obsolete."""
ALIKE: Final = frozenset({"", "DroneCAN"})
"""Type names that do not identify a part; sensors under them are not compared."""
TrendOf = Callable[[tuple[BiasObservation, ...], float], Trend]
FALSE_ALARMS: Final = 0.01
"""Fraction of healthy groups in which a sensor is called odd."""
LEAST = 6
"""Least number of sensors in a group that show its spread."""
FARTHEST: Final = 1e9
"""Distance given to a sensor that differs from a group whose other members are equal."""
_MAD = 1.4826
_SIZES: Final = (*range(LEAST, 22), 25, 31, 41, 51, 75, 101, 151, 201, 501, 1001)
_LIMITS: Final = (
    *(14.46, 15.67, 10.76, 11.36, 8.93, 9.03, 7.95, 8.01, 7.28, 7.28, 6.73, 6.77, 6.40, 6.48, 6.23, 6.20),
    *(5.77, 5.47, 5.17, 5.00, 4.77, 4.63, 4.62, 4.57, 4.66, 4.72),
)
"""Limit by size of the group, simulated by ``bench.fleet``; a test repeats some of the simulations."""


class ReasonCode(StrEnum):
    """Why a unit should be calibrated again."""

    NEVER = "never"  # no verified calibration is known
    AGE = "age"  # the calibration is older than its limit
    DRIFT = "drift"  # the bias may have left its limit, by its trend
    PREFLIGHT = "preflight"  # the last preflight failed a check that a calibration mends


@dataclass(frozen=True)
class Reason:
    """Why a unit should be calibrated again."""

    code: ReasonCode
    sensor: Sensor | None
    """None: the unit as a whole."""
    instance: int | None
    """0 for the first of its kind; None: all of them."""
    text: str


@dataclass(frozen=True)
class FailedCheck:
    """A check of the last preflight that did not pass."""

    id: CheckId
    verdict: Verdict
    reason: str


@dataclass(frozen=True)
class LastPreflight:
    """The last preflight of a unit."""

    at: float
    verdict: Verdict
    failed: tuple[FailedCheck, ...] = ()


@dataclass(frozen=True)
class SensorStanding:
    """One sensor now. Slopes and limit are in the unit of the bias: m/s2, rad/s or uT."""

    newest: SensorRecord
    measured: SensorRecord | None
    """The newest record that has a bias; None: there is none."""
    calibrated_at: float | None
    """Time of the last verified calibration; None: none is known."""
    job: str | None
    covered: Covered | None
    trending: Callable[[], Trend] = field(repr=False, compare=False)
    """Computes the trend on demand: it costs more than everything else, and only one page of a fleet is viewed."""
    oddness: Oddness | None = None
    """None: too few sensors of its type are known."""

    @cached_property
    def trend(self) -> Trend:
        """Its drift; computed where it is asked for."""
        return self.trending()

    @property
    def name(self) -> str:
        """Display name, with the type of the part."""
        kind = f" ({self.newest.type})" if self.newest.type else ""
        return f"{NAMES[self.newest.sensor]} {self.newest.instance + 1}{kind}"


@dataclass(frozen=True)
class UnitStanding:
    """One unit now."""

    unit: str
    sensors: tuple[SensorStanding, ...]
    preflight: LastPreflight | None
    now: float

    @cached_property
    def reasons(self) -> tuple[Reason, ...]:
        """Why it should be calibrated again; empty: it need not be. Rests on the trends."""
        return reasons(self.sensors, self.preflight, self.now)

    @property
    def leaving(self) -> Leaving | None:
        """The prediction of the sensor that leaves its limit first; None: no trend predicts it."""
        found = [s.trend.leaving for s in self.sensors if s.trend.leaving is not None]
        return min(found, key=lambda one: (_or_never(one.earliest), _or_never(one.middle)), default=None)


def _or_never(at: float | None) -> float:
    return float("inf") if at is None else at


def fleet_standing(
    records: Mapping[str, Sequence[SensorRecord]],
    preflights: Mapping[str, LastPreflight],
    now: float,
    trend_of: TrendOf = bias_trend,
) -> dict[str, UnitStanding]:
    """Every unit, compared with all others; `records` have an entry for each. `now`: wall clock, s since 1970."""
    sensors = {unit: _sensors(known, trend_of) for unit, known in records.items()}
    odd = _compared([s for found in sensors.values() for s in found])
    standings = {}
    for unit, found in sensors.items():
        compared = tuple(dataclasses.replace(s, oddness=odd.get(id(s))) for s in found)
        preflight = preflights.get(unit)
        standings[unit] = UnitStanding(unit, compared, preflight, now)
    return standings


def reasons(sensors: Sequence[SensorStanding], preflight: LastPreflight | None, now: float) -> tuple[Reason, ...]:
    """Why a unit with these sensors should be calibrated again, by the limits of the preflight."""
    if not any(s.calibrated_at is not None for s in sensors):
        found = [Reason(ReasonCode.NEVER, None, None, "No verified calibration of this vehicle is known here.")]
    else:
        found = [reason for s in sensors for reason in _of_sensor(s, now)]
    return (*found, *(_of_preflight(sensors, preflight) if preflight is not None else ()))


def _of_sensor(sensor: SensorStanding, now: float) -> list[Reason]:
    place = (sensor.newest.sensor, sensor.newest.instance)
    if sensor.calibrated_at is None:
        text = f"No verified calibration of {sensor.name} is known here."
        return [Reason(ReasonCode.NEVER, *place, text)]
    found = []
    age, limit = (now - sensor.calibrated_at) / DAY_S, limits.CALIBRATION_AGE
    if age > limit.value:
        text = f"The calibration of {sensor.name} is {age:.0f} d old, limit {limit.value:g} d."
        found.append(Reason(ReasonCode.AGE, *place, text))
    leaving = sensor.trend.leaving
    if leaving is not None and leaving.earliest is not None and leaving.earliest <= now:
        found.append(Reason(ReasonCode.DRIFT, *place, _left(sensor, leaving)))
    return found


def _left(sensor: SensorStanding, leaving: Leaving) -> str:
    limit = BIAS_LIMITS[sensor.newest.sensor].limit
    first = day(leaving.earliest)
    last = "later than ten years" if leaving.latest is None else day(leaving.latest)
    return (
        f"The bias of {sensor.name} may have left its limit of {limit.value:g} {limit.unit}: by its trend it does so "
        f"between {first} and {last} (90 %)."
    )


def day(at: float | None) -> str:
    """A date in UTC; None: beyond ten years."""
    return "beyond ten years" if at is None else datetime.fromtimestamp(at, UTC).strftime("%Y-%m-%d")


def _of_preflight(sensors: Sequence[SensorStanding], preflight: LastPreflight) -> list[Reason]:
    """Failed checks that a calibration repairs, unless one was made since."""
    found = []
    for check in preflight.failed:
        if check.verdict != Verdict.FAIL or check.id not in TREATED:
            continue
        about = [s for s in sensors if not TREATED[check.id] or s.newest.sensor in TREATED[check.id]]
        since = [s for s in about if s.calibrated_at is not None and s.calibrated_at > preflight.at]
        if about and len(since) == len(about):
            continue
        kinds = TREATED[check.id]
        text = f"The preflight of {day(preflight.at)} failed {check.id}: {check.reason}"
        found.append(Reason(ReasonCode.PREFLIGHT, kinds[0] if len(kinds) == 1 else None, None, text))
    return found


def _sensors(records: Sequence[SensorRecord], trend_of: TrendOf) -> tuple[SensorStanding, ...]:
    return tuple(_standing(records, newest, trend_of) for _, newest in sorted(newest_by_place(records).items()))


def _standing(records: Sequence[SensorRecord], newest: SensorRecord, trend_of: TrendOf) -> SensorStanding:
    history = history_of_part(records, newest)
    applied = [r for r in history if r.applied]
    seen = tuple(o for r in history if (o := r.observation) is not None)

    def trending() -> Trend:
        trend = trend_of(seen, BIAS_LIMITS[newest.sensor].value)
        if newest.by_itself and trend.leaving is not None:
            why = "The vehicle calibrates this sensor by itself, so that its bias leaves no limit."
            return dataclasses.replace(trend, leaving=None, open=(*trend.open, Open(Quantity.LEAVING, why)))
        return trend

    last = applied[-1] if applied else None
    measured = [r for r in history if r.bias is not None]
    return SensorStanding(
        newest,
        measured[-1] if measured else None,
        None if last is None else last.at,
        None if last is None else last.source_id,
        None if last is None else last.covered,
        trending,
    )


def _compared(sensors: Sequence[SensorStanding]) -> dict[int, Oddness]:
    """How odd each sensor is among those of its type, by the id of the object."""
    groups: dict[tuple[Sensor, str], list[SensorStanding]] = {}
    for sensor in sensors:
        kind = sensor.newest.type
        if kind not in ALIKE and sensor.measured is not None:
            family = sensor.newest.autopilot if kind.startswith("type ") else ""
            groups.setdefault((sensor.newest.sensor, f"{family} {kind}"), []).append(sensor)
    found: dict[int, Oddness] = {}
    for group in groups.values():
        measured = [s.measured for s in group if s.measured is not None]
        biases = [r.bias for r in measured if r.bias is not None]
        spread = [max(r.sd) for r in measured if r.sd is not None]
        for sensor, one in zip(group, oddness(biases, spread), strict=True):
            if one is not None:
                found[id(sensor)] = one
    return found


@dataclass(frozen=True)
class Oddness:
    """How far a sensor is from the middle of its type, in robust standard deviations of its worst axis."""

    distance: float
    limit: float
    axis: int
    group: int
    """Sensors in the group."""

    @property
    def odd(self) -> bool:
        """Whether it is farther than the limit."""
        return self.distance > self.limit


def distances(values: Array, floor: float = 0.0) -> Array:
    """Robust distance from the median, shape of `values` (..., n, 3); `floor` is the least spread."""
    away = np.abs(values - np.median(values, axis=-2, keepdims=True))
    spread = np.maximum(_MAD * np.median(away, axis=-2, keepdims=True), floor)
    return np.asarray(np.divide(away, spread, out=np.where(away > 0.0, FARTHEST, 0.0), where=spread > 0.0))


def limit_of(n: int) -> float:
    """The limit for a group of `n`, at least six: that of the next smaller size of the table, which is no stricter.

    Beyond the table, the limit for `n` normally distributed numbers of known spread counts if it is larger.
    """
    known = _LIMITS[int(np.searchsorted(_SIZES, n, side="right")) - 1]
    return max(known, float(-scipy.special.ndtri(FALSE_ALARMS / (6.0 * n)))) if n > _SIZES[-1] else known


def oddness(biases: Sequence[Sequence[float]], sd: Sequence[float]) -> tuple[Oddness | None, ...]:
    """How odd each sensor of one type is; None: there are fewer than six of them.

    `biases` are (n, 3); `sd` are standard deviations of a measurement, whose median is the least spread.

    Raises
    ------
    InvalidInputError
        If a number is not finite.
    """
    n = len(biases)
    if n < LEAST:
        return (None,) * n
    values = np.array(biases, dtype=np.float64)
    if not (np.isfinite(values).all() and np.isfinite(sd).all()):
        raise InvalidInputError("biases and standard deviations that are compared must be finite")
    found = distances(values, float(np.median(sd)))
    limit = limit_of(n)
    worst = found.argmax(axis=1)
    return tuple(Oddness(float(row[axis]), limit, int(axis), n) for row, axis in zip(found, worst, strict=True))
