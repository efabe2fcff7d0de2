"""Compares parameters with earlier verified calibrations: age, sensors, changes, temperature, motors."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware import calibration_names, sensor_ids
from mavcal.calib.firmware.ardupilot.doubts import learning_warnings
from mavcal.calib.firmware.names import LEVEL, Role
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.values import shown
from mavcal.calib.preflight import limits
from mavcal.calib.preflight.check import Check, CheckId, Measure, Snapshot, Subject, Verdict, judged, unknown
from mavcal.calib.preflight.expected import GYRO_SWITCH, SHARED, ExpectedCalibration, expected, last_of_each
from mavcal.calib.recording import Sensor

_CALIBRATE = "Calibrate here and write it: a calibration counts from its verification on."
_NONE_KNOWN = "No verified calibration of this vehicle is known here."
_DAY_S = 86400.0
_UNKNOWN_TEMPERATURE = -70.0
"""ArduPilot's CALTEMP at or below which the temperature is unknown (its default is -300)."""
_SAME = 1e-6
"""Relative: parameters are float32 on the wire."""


@dataclass(frozen=True)
class Changed:
    """A calibration parameter that differs from its verified value; `now` None: it no longer exists."""

    name: str
    sensor: Sensor | None
    then: Value
    now: Value | None

    @property
    def text(self) -> str:
        """As a line of evidence."""
        now = "not there" if self.now is None else shown(self.now, 6)
        return f"{self.name}: {shown(self.then, 6)} -> {now}"


def calibration_age(snapshot: Snapshot) -> Check:
    """Days since the oldest sensor was verified last."""
    newest = {sensor: entry.at for entry in snapshot.history for sensor in sorted(entry.sensors)}
    if not newest:
        return unknown(CheckId.CALIBRATION_AGE, _NONE_KNOWN, _CALIBRATE)
    limit = limits.CALIBRATION_AGE
    measures = [
        Measure(f"age of the {sensor} calibration", max(snapshot.now - at, 0.0) / _DAY_S, 0.0, limit.value, limit.unit)
        for sensor, at in newest.items()
    ]
    good = f"The oldest verified calibration is {max(m.value for m in measures):.0f} d old."
    notes = _compared(snapshot)
    check = judged(CheckId.CALIBRATION_AGE, measures, good=good, remedy="Calibrate again.", notes=notes)
    if check.verdict != Verdict.FAIL:
        return check
    return Check(**{**vars(check), "verdict": Verdict.WARN})  # age alone makes no sensor wrong


def ids_changed(snapshot: Snapshot) -> dict[Sensor, tuple[str, ...]]:
    """The sensors that differ from those verified last, with the change.

    A device id contains bus, address and type of a part, so an identical board has the same ids: only the autopilot's
    unique id distinguishes them. If all ids are gone, they were reset, which concerns the parameters.
    """
    now: dict[Sensor, set[int]] = {}
    for (sensor, _), device in sensor_ids(snapshot.identity.autopilot, snapshot.parameters).items():
        now.setdefault(sensor, set()).add(device)
    found: dict[Sensor, tuple[str, ...]] = {}
    for sensor, entry in last_of_each(snapshot.history).items():
        then = {device for key, device in entry.device_ids.items() if key.rstrip("0123456789") == sensor}
        there = now.get(sensor, set())
        if not then:
            there = then  # ArduPilot keeps an id only once the calibration is stored: none was known yet
        gone = sorted(then - there) if there and snapshot.complete else []  # an id that was not read is not gone
        texts = [f"{sensor} {device} was verified and is gone" for device in gone]
        texts += [f"{sensor} {device} was never verified" for device in sorted(there - then)]
        if None not in (entry.uid, snapshot.identity.uid) and entry.uid != snapshot.identity.uid:
            texts.append(f"{sensor} was verified on the autopilot {entry.uid}, and this is {snapshot.identity.uid}")
        if texts:
            found[sensor] = tuple(texts)
    return found


_UNCHANGED = {
    "px4": "Every calibration row holds the device id that was calibrated. "
    "Whether that sensor is on board PX4's parameters do not say."
}
"""Sentences for unchanged ids; they mean less where the vehicle does not update them."""


def sensor_check(snapshot: Snapshot) -> Check:
    """Device ids against those of the last verified calibration."""
    if not last_of_each(snapshot.history):
        return unknown(CheckId.SENSOR_IDS, _NONE_KNOWN, _CALIBRATE)
    texts = [line for lines in ids_changed(snapshot).values() for line in lines]
    good = _UNCHANGED.get(snapshot.identity.autopilot or "", "Every sensor is the one that was calibrated.")
    remedy = "Calibrate the sensors that are new: the calibration of another part does not fit them."
    ids = sensor_ids(snapshot.identity.autopilot, snapshot.parameters)
    notes = [f"{sensor} {i + 1} has the device id {device}" for (sensor, i), device in sorted(ids.items())]
    notes.append(f"unique id of the autopilot: {snapshot.identity.uid or 'not said'}")
    notes += _compared(snapshot)
    if not texts and not snapshot.complete:
        reason = "The device ids could not all be read in time, and those that were are as verified."
        return unknown(CheckId.SENSOR_IDS, reason, "Check again on a faster link.", notes)
    return _counted(CheckId.SENSOR_IDS, texts, "sensors", good, remedy, notes)


def changes(snapshot: Snapshot) -> tuple[Changed, ...]:
    """Calibration parameters of unchanged sensors, and of the board, that are not what was verified."""
    found, swapped = [], ids_changed(snapshot)
    for wanted in _expected(snapshot).values:
        sensor = None if wanted.about is None else wanted.about.sensor
        now = snapshot.parameters.get(wanted.name)
        if sensor in swapped:
            continue  # a new part's own calibration is no change of the old one's
        if wanted.role in (Role.ID, Role.PRIORITY) and now:
            continue  # another part is a matter of the sensor's id
        if now is None and not snapshot.complete:
            continue
        if now is None or not math.isclose(float(wanted.value), float(now), rel_tol=_SAME, abs_tol=1e-12):
            found.append(Changed(wanted.name, sensor, wanted.value, now))
    return tuple(found)


def _expected(snapshot: Snapshot) -> ExpectedCalibration:
    if not snapshot.history or snapshot.identity.autopilot not in SHARED:
        return ExpectedCalibration()
    return expected(snapshot.history, snapshot.identity.autopilot, snapshot.parameters)


def parameters_changed(snapshot: Snapshot) -> Check:
    """Parameters changed since the last verified calibration."""
    if not last_of_each(snapshot.history):
        return unknown(CheckId.PARAMETERS_CHANGED, _NONE_KNOWN, _CALIBRATE)
    found = changes(snapshot)
    texts = [change.text for change in found]
    wanted = _expected(snapshot)
    notes = (f"{len(wanted.values)} parameters compared", *wanted.moved, *wanted.missing, *_compared(snapshot))
    if not texts and not snapshot.complete:
        reason = "The parameters could not all be read in time, and those that were are as verified."
        return unknown(CheckId.PARAMETERS_CHANGED, reason, "Check again on a faster link.", notes)
    if found and _levelled(found):
        reason = f"The level was saved on the vehicle since it was verified: {'; '.join(texts)}."
        return Check(
            *(CheckId.PARAMETERS_CHANGED, Verdict.WARN, float(len(texts)), 0.0, 0.0, "", reason),
            "Calibrate the level here to have it verified, or restore the last verified calibration.",
            (*texts, *notes),
        )
    good = "Every calibration parameter is as it was verified."
    remedy = "Restore the last verified calibration, or calibrate again."
    return _counted(CheckId.PARAMETERS_CHANGED, texts, "parameters", good, remedy, notes)


def _levelled(found: Sequence[Changed]) -> bool:
    """Whether only the level was changed in the field; all zeros are a reset."""
    return all(change.name.startswith(LEVEL) for change in found) and any(change.now for change in found)


def _counted(of: CheckId, texts: Sequence[str], what: str, good: str, remedy: str, notes: Sequence[str]) -> Check:
    if not texts:
        return Check(of, Verdict.PASS, 0.0, 0.0, 0.0, "", good, evidence=tuple(notes))
    reason = f"{len(texts)} {what} are not as verified: {'; '.join(texts[:3])}{' …' if len(texts) > 3 else ''}."
    return Check(of, Verdict.FAIL, float(len(texts)), 0.0, 0.0, "", reason, remedy, (*texts, *notes))


def _compared(snapshot: Snapshot) -> tuple[str, ...]:
    """Reference of the comparison, as lines of evidence."""
    last = last_of_each(snapshot.history)
    return tuple(
        f"{sensor}: compared with job {entry.job} of {datetime.fromtimestamp(entry.at, UTC):%Y-%m-%d %H:%M} UTC"
        for sensor, entry in last.items()
    )


def sensor_of(name: str) -> Sensor | None:
    """The sensor that a calibration parameter corrects; None: several, or not a calibration parameter."""
    for sensor, prefixes in _PREFIXES.items():
        if name.startswith(prefixes) or (name[:3] == "INS" and any(f"_{part}" in name for part in _AP[sensor])):
            return sensor
    return None


_PREFIXES = {
    Sensor.ACCEL: ("CAL_ACC", "TC_A"),
    Sensor.GYRO: ("CAL_GYRO", "TC_G"),
    Sensor.MAG: ("COMPASS_", "CAL_MAG"),
}
_AP: Mapping[Sensor, tuple[str, ...]] = {Sensor.ACCEL: ("ACC",), Sensor.GYRO: ("GYR",), Sensor.MAG: ()}


def calibrates_gyros(autopilot: str, parameters: Mapping[str, Value]) -> bool:
    """Whether the vehicle calibrates its gyroscopes by itself, ArduPilot at every start, PX4 at rest."""
    return bool(parameters.get(GYRO_SWITCH.get(autopilot, ""), 1))


# --- temperature


@dataclass(frozen=True)
class Covered:
    """The temperatures that a calibration covers, degC."""

    low: float
    """degC"""
    high: float
    """degC"""
    how: str


def covered(snapshot: Snapshot, instance: int) -> Covered | None:
    """Temperatures that the calibration in force of an accelerometer covers; None: unknown."""
    last = last_of_each(snapshot.history).get(Sensor.ACCEL)
    measured = None if last is None else last.temperatures.get(instance)
    return covered_by(snapshot.identity.autopilot, snapshot.parameters, Sensor.ACCEL, instance, measured)


def covered_by(
    autopilot: str | None, parameters: Mapping[str, Value], sensor: Sensor, instance: int, measured: float | None
) -> Covered | None:
    """Temperatures that these parameters cover; `measured`: that of the verified job, degC. None: unknown."""
    corrected = corrected_by(autopilot, parameters, sensor, instance)
    if corrected is not None:
        return corrected
    at = _value(autopilot, parameters, sensor, instance, Role.TEMPERATURE)
    how = "the temperature of its calibration"
    if at is None or at <= _UNKNOWN_TEMPERATURE:
        at, how = measured, "the temperature of the verified job"
    if at is None:
        return None
    span = limits.TEMPERATURE_SPAN.value
    return Covered(at - span, at + span, f"{how}, {at:.0f} degC, give or take {span:.0f}")


def corrected_by(
    autopilot: str | None, parameters: Mapping[str, Value], sensor: Sensor, instance: int
) -> Covered | None:
    """Range of the temperature calibration in force; None: there is none."""
    low, high, enabled = (
        _value(autopilot, parameters, sensor, instance, role)
        for role in (Role.THERMAL_MIN, Role.THERMAL_MAX, Role.THERMAL_ENABLE)
    )
    if enabled == 1.0 and low is not None and high is not None and low < high:
        return Covered(low, high, "the temperature calibration in force")
    return None


def _value(
    autopilot: str | None, parameters: Mapping[str, Value], sensor: Sensor, instance: int, role: Role
) -> float | None:
    try:
        name = calibration_names(autopilot, parameters, sensor, instance).get(role, "")
    except FirmwareError:
        return None
    value = parameters.get(name)
    return None if value is None else float(value)


def temperature(snapshot: Snapshot) -> Check:
    """Check of every inertial unit's temperature against its calibration; a unit that is learning one does not pass."""
    made, learning = _warmth(snapshot), learning_warnings(snapshot.parameters)
    if not learning or made.verdict == Verdict.FAIL:
        return made
    remedy = "Let it finish: start cold and leave the vehicle alone until it is warm. Or set the parameter to 0."
    return dataclasses.replace(
        made,
        verdict=Verdict.WARN,
        reason=f"{'; '.join(learning)}.",
        remedy=remedy,
        evidence=(made.reason, *made.evidence),
    )


def _warmth(snapshot: Snapshot) -> Check:
    """Temperature of every inertial unit against what its calibration covers."""
    measures, notes = [], []
    for instance in snapshot.recording.instances(Sensor.TEMPERATURE):
        channel = snapshot.recording.channel(Sensor.TEMPERATURE, instance)
        now = float(np.median(channel.values[:, 0]))
        notes.append(f"unit {instance + 1}: {len(channel)} readings over {channel.t[-1] - channel.t[0]:.1f} s")
        span = covered(snapshot, instance)
        if span is None:
            notes.append(f"unit {instance + 1} is at {now:.1f} degC; nothing says what its calibration covers")
            continue
        middle, half = 0.5 * (span.low + span.high), 0.5 * (span.high - span.low)
        name = (
            f"temperature of unit {instance + 1} ({now:.1f} degC) from the middle of {span.low:.0f} to {span.high:.0f}"
        )
        measures.append(Measure(name, abs(now - middle), limits.TEMPERATURE_SD, half, "degC"))
        notes.append(f"unit {instance + 1}: {span.how}")
    if not measures:
        why = (
            "; ".join(note for note in notes if "nothing says" in note)
            or "no temperature of an inertial unit was heard"
        )
        return unknown(CheckId.TEMPERATURE, f"{why[:1].upper()}{why[1:]}.", _CALIBRATE, notes)
    remedy = "Let the vehicle come to these temperatures, or calibrate over temperature."
    good = "Every inertial unit is inside the temperatures that its calibration covers."
    return judged(CheckId.TEMPERATURE, measures, good=good, remedy=remedy, notes=notes)


SUBJECT = Subject((temperature, calibration_age, sensor_check, parameters_changed))
