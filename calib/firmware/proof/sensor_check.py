"""Checks the readings after a write: zero of a gyroscope at rest, gravity of an accelerometer, level of a level board.

The check of the parameters (:mod:`calib.firmware.proof.check`) tests whether they act. Parameters of another, identical
vehicle act as well, but leave the sensors wrong. Here the stream itself is judged. A limit covers all legitimate
causes. Noise and the uncertainty of the fit count with :data:`SURE` standard deviations of both together. Two bounds
are added: possible drift of the sensor since the fit, and the announced losses of the firmware.

A reading can be disturbed, if somebody touches or turns the vehicle, whereas a wrong offset shows in every reading. So
the best of several readings in one pose at one temperature counts, and a sensor is wrong only if all of them are. The
worst pose or temperature decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.fitted import Pair, offset_at
from mavcal.calib.firmware.losses import MATRIX, OFFSETS
from mavcal.calib.firmware.plan import SensorCheck, SensorCheckId, SensorVerdict, WritePlan
from mavcal.calib.firmware.proof.check import ALL_APPLIED, Corrections, within
from mavcal.calib.firmware.proof.discrepancy import BIAS_WALK, EARTH_RATE, MOST_BIAS_WALK, STABILITY, TEMPERATURE_STEP
from mavcal.calib.firmware.proof.evidence import StillMean, StreamEvidence
from mavcal.calib.firmware.proof.force import Force
from mavcal.calib.firmware.proof.known_drift import DRIFT_PER_DEGC, UNKNOWN_TEMPERATURE
from mavcal.calib.fit import AXES, FitResult
from mavcal.calib.recording import Array, Sensor

SURE: Final = 5.0
"""Standard deviations: one false alarm in a million on one axis, so that a healthy write is not taken back."""
SINCE_FIT_S: Final = 120.0
"""Time, s, of gyroscope drift since its fit: an operator may read a plan that long."""
DRIFT_FACTOR: Final = 2.0
"""Allowed drift per degC, as a multiple of the data sheet's typical value."""
MOST_DRIFT: Final = {Sensor.ACCEL: 0.1, Sensor.GYRO: MOST_BIAS_WALK}
"""Largest error, m/s2 and rad/s (0.25 deg/s), from any cause; beyond it a sensor needs a fit at this temperature."""
MISFIT: Final = {Sensor.ACCEL: 0.02, Sensor.GYRO: np.radians(0.05)}
"""Allowed residual of a polynomial over its range, m/s2 and rad/s: the goal of a thermal job."""
LOCAL_GRAVITY: Final = 0.03
"""m/s2 by which gravity differs from 9.80665 between the poles and the equator."""
APART: Final = np.radians(2.0)
"""rad between two accelerometers of one board after both were calibrated: twice what level jobs warn of."""
FAR: Final = 0.5
"""Limit, m/s2, above which a check is meaningless."""
_ANY_RATE: Final = 1.0  # rad/s, sd of an axis that the fit leaves open
_NO_READING: Final = 1e-3
"""Reading, m/s2, below which an accelerometer at rest has no direction: it streams zeros."""
SAME_POSE: Final = 0.966
"""Cosine within which readings count as one pose (15 deg)."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """Error of one reading, its limit, and its standard deviation."""

    reading: StillMean
    value: float
    limit: float
    sd: float
    words: str = ""

    @property
    def ratio(self) -> float:
        """The value as a multiple of its limit."""
        return self.value / self.limit


def sensor_checks(
    plan: WritePlan, pairs: Mapping[Subject, Pair], now: StreamEvidence, force: Force
) -> tuple[SensorCheck, ...]:
    """Judge every inertial sensor whose offset the plan changes and the fit determines."""
    written = {
        about: pair.absolute
        for about, pair in pairs.items()
        if pair.absolute is not None
        and about not in now.raw
        and about in now.readings
        and any((c.sensor, c.instance) == (about.sensor, about.instance) for c in plan.changes)
    }
    found = []
    for about, fit in written.items():
        judge = {Sensor.ACCEL: _gravity, Sensor.GYRO: _zero}.get(about.sensor)
        if judge is not None:
            corrections = Corrections(force, about)
            readings = _usable(about, corrections, pairs[about], now)
            found.append(_summarised(about, judge(PlannedSensor(plan, corrections, fit, pairs[about]), readings)))
    return (*found, *_directions([about for about in written if about.sensor == Sensor.ACCEL], now))


def _usable(about: Subject, corrections: Corrections, pair: Pair, now: StreamEvidence) -> tuple[StillMean, ...]:
    drift = None if pair.drift is None else pair.drift.model.polynomial
    in_force = corrections.model(ALL_APPLIED).polynomial
    readings = corrections.readable(now.readings[about])
    return within(drift, within(in_force, readings))


@dataclass(frozen=True, eq=False)
class PlannedSensor:
    """One sensor under a plan, with its correction and its fits."""

    plan: WritePlan
    corrections: Corrections
    fit: FitResult
    pair: Pair

    @property
    def about(self) -> Subject:
        """The sensor."""
        return self.corrections.about


def _zero(given: PlannedSensor, readings: Sequence[StillMean]) -> tuple[Deviation, ...]:
    """Deviations of a gyroscope at rest, on its worst determined axis."""
    about, fit = given.about, given.fit
    matrix = given.corrections.model(ALL_APPLIED).matrix
    opened = np.diag([_ANY_RATE**2 * (not fit.determined(f"offset_{a}")) for a in AXES])
    found = []
    for reading in readings:
        fixed = _bounds(given, reading) + 2.0 * EARTH_RATE + BIAS_WALK * SINCE_FIT_S
        covariance = reading.covariance + matrix @ (_offset(fit, reading)[1] + opened) @ matrix.T
        sds = np.sqrt(np.diag(covariance) + STABILITY[about.sensor] ** 2)
        every = [
            Deviation(
                reading,
                abs(float(reading.mean[k])),
                fixed + SURE * float(sds[k]),
                float(sds[k]),
                f"{about} reads {math.degrees(reading.mean[k]):+.3f} deg/s about {AXES[k]} at rest",
            )
            for k in range(3)
            if sds[k] < _ANY_RATE / SURE
        ]
        if every:
            found.append(max(every, key=lambda d: d.ratio))
    return tuple(found)


def _gravity(given: PlannedSensor, readings: Sequence[StillMean]) -> tuple[Deviation, ...]:
    """Deviations of the length of an accelerometer's readings at rest."""
    fit, matrix = given.fit, given.fit.model.matrix
    found = []
    for reading, raw in zip(readings, given.corrections.raw(ALL_APPLIED, readings), strict=True):
        offset, spread = _offset(fit, reading)
        covariance = fit.covariance[:12, :12].copy()
        covariance[OFFSETS, OFFSETS] = spread
        if not np.any(np.diag(covariance)[MATRIX]) and not _as_fitted(fit, raw):
            continue  # the scale was not measured, so the offset holds in the pose of the fit alone
        covariance += np.diag([FAR**2 * (name in fit.undetermined) for name in fit.names[:12]])
        true = matrix @ (raw - offset)
        normal = true / np.linalg.norm(true)
        row = np.concatenate((-normal @ matrix, np.kron(normal, raw - offset)))
        size = float(np.linalg.norm(reading.mean))
        seen = reading.mean / max(size, _NO_READING)
        misfit = fit.residual_rms if np.isfinite(fit.residual_rms) else 0.0
        variance = float(seen @ reading.covariance @ seen + row @ covariance @ row)
        sd = math.sqrt(variance + misfit**2 + STABILITY[Sensor.ACCEL] ** 2)
        limit = SURE * sd + _bounds(given, reading) + LOCAL_GRAVITY
        words = f"{given.about} reads {size - STANDARD_GRAVITY:+.3f} m/s2 beside gravity at rest"
        if limit <= FAR:
            found.append(Deviation(reading, abs(size - STANDARD_GRAVITY), limit, sd, words))
    return tuple(found)


def _offset(fit: FitResult, reading: StillMean) -> tuple[Array, Array]:
    """Offset of the fit at the reading's temperature, with its covariance."""
    polynomial = fit.model.polynomial
    if polynomial is None or reading.temperature is None:
        return fit.model.offset, fit.covariance[OFFSETS, OFFSETS]
    return offset_at(fit, reading.temperature)


def _as_fitted(fit: FitResult, raw: Array) -> bool:
    mean = np.array(fit.native.get("mean", np.zeros(3)), dtype=np.float64)
    return float(mean @ raw) > SAME_POSE * float(np.linalg.norm(mean) * np.linalg.norm(raw)) > 0.0


def _bounds(given: PlannedSensor, reading: StillMean) -> float:
    """Error that temperature and the firmware's limits may leave, in the unit of the stream."""
    about, pair = given.about, given.pair
    left = math.fsum(
        loss.cost
        for loss in given.plan.losses
        if (loss.sensor, loss.instance) == (about.sensor, about.instance)
        and loss.unit == ("m/s2" if about.sensor == Sensor.ACCEL else "rad/s")
        and loss.what != "mounting"  # turns the vector and keeps its length
    )
    if pair.drift is not None:
        return left + float(MISFIT[about.sensor])
    fit = pair.at_rest
    reference = None if fit is None else fit.temperature
    away = UNKNOWN_TEMPERATURE
    if reference is not None and reading.temperature is not None:
        away = abs(reading.temperature - reference)
    drift = float(DRIFT_FACTOR * DRIFT_PER_DEGC[about.sensor] * away)
    return left + min(drift, float(MOST_DRIFT[about.sensor]))


def _directions(written: Sequence[Subject], now: StreamEvidence) -> tuple[SensorCheck, ...]:
    """Deviations between the directions of down of accelerometers on one board that were calibrated together."""
    found = []
    for k, about in enumerate(written[1:], start=1):
        first = written[0]
        deviations = []
        for mine, other in _together(now.readings[about], now.readings[first]):
            if min(np.linalg.norm(r.mean) for r in (mine, other)) < _NO_READING:
                continue  # a unit that reads zero points nowhere; gravity tells that it is wrong
            a, b = (r.mean / np.linalg.norm(r.mean) for r in (mine, other))
            angle = float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
            sd = math.sqrt(max(np.trace(mine.covariance) + np.trace(other.covariance), 0.0)) / STANDARD_GRAVITY
            words = f"{about} and {first} differ by {math.degrees(angle):.1f} deg about which way is down"
            deviations.append(Deviation(mine, angle, APART + SURE * sd, sd, words))
        found.append(_summarised(written[k], tuple(deviations), id_=SensorCheckId.ACCEL_DIRECTION))
    return tuple(found)


def _together(a: Sequence[StillMean], b: Sequence[StillMean]) -> Iterable[tuple[StillMean, StillMean]]:
    for mine in a:
        same = [r for r in b if abs(r.t - mine.t) < 0.5]
        if same:
            yield mine, same[0]


_IDS: Final = {Sensor.ACCEL: SensorCheckId.ACCEL_GRAVITY, Sensor.GYRO: SensorCheckId.GYRO_ZERO}
_UNITS: Final[Mapping[SensorCheckId, tuple[str, Callable[[float], str]]]] = {
    SensorCheckId.GYRO_ZERO: ("rad/s", lambda v: f"{math.degrees(v):.3f} deg/s"),
    SensorCheckId.ACCEL_GRAVITY: ("m/s2", lambda v: f"{v:.3f} m/s2"),
    SensorCheckId.ACCEL_DIRECTION: ("rad", lambda v: f"{math.degrees(v):.1f} deg"),
    SensorCheckId.LEVEL: ("rad", lambda v: f"{math.degrees(v):.2f} deg"),
}


def _summarised(about: Subject, deviations: Sequence[Deviation], id_: SensorCheckId | None = None) -> SensorCheck:
    name = id_ or _IDS[about.sensor]
    unit, words = _UNITS[name]
    if not deviations:
        text = f"{about} was not at rest in a pose and at a temperature that can be judged"
        return SensorCheck(
            name, about.sensor, about.instance, None, None, unit, None, SensorVerdict.NOT_OBSERVABLE, text
        )
    worst = max((min(g, key=lambda d: d.ratio) for g in _groups(deviations, about)), key=lambda d: d.ratio)
    wrong = worst.ratio > 1.0
    text = f"{worst.words}; {'at most' if wrong else 'the limit is'} {words(worst.limit)}"
    text += " is explained by noise, drift and the fit" if wrong else ""
    verdict = SensorVerdict.WRONG if wrong else SensorVerdict.RIGHT
    return SensorCheck(name, about.sensor, about.instance, worst.value, worst.limit, unit, worst.sd, verdict, text)


def _groups(deviations: Sequence[Deviation], about: Subject) -> list[list[Deviation]]:
    """Deviations that saw the same: one temperature and, for an accelerometer, one pose."""
    groups: list[list[Deviation]] = []
    for deviation in deviations:
        for group in groups:
            if _alike(group[0].reading, deviation.reading, about.sensor):
                group.append(deviation)
                break
        else:
            groups.append([deviation])
    return groups


def _alike(a: StillMean, b: StillMean, sensor: Sensor) -> bool:
    if (
        a.temperature is not None
        and b.temperature is not None
        and abs(a.temperature - b.temperature) > TEMPERATURE_STEP
    ):
        return False
    if sensor != Sensor.ACCEL:
        return True
    return float(a.mean @ b.mean) > SAME_POSE * float(np.linalg.norm(a.mean) * np.linalg.norm(b.mean))
