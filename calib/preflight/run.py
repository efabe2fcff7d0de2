"""The whole preflight: every check on one snapshot, with consequences told from causes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.earth import EarthField, earth_field
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.preflight import compass, history, inertial, own
from mavcal.calib.preflight.check import Check, CheckId, Report, Verdict, unknown
from mavcal.calib.preflight.motors import motor_compensation
from mavcal.calib.preflight.rest import Mean, Silent, mean_at_rest, moved
from mavcal.calib.preflight.snapshot import Snapshot
from mavcal.calib.recording import Recording, Sensor

Array = NDArray[np.float64]

INSTANCES = (0, 1, 2)
"""What either firmware streams."""
_ABOUT = {
    Sensor.GYRO: (CheckId.GYRO_REST, CheckId.GYRO_NOISE),
    Sensor.ACCEL: (CheckId.ACCEL_FORCE,),
    Sensor.MAG: (CheckId.COMPASS_FIELD, CheckId.COMPASS_DIRECTION),
}
_TYPICAL_FIELD = 50.0


def preflight(snapshot: Snapshot) -> Report:
    """Every check. Whoever reads the report acts on its causes: consequences are not failures of their own."""
    gyros, no_gyros = _means(snapshot, Sensor.GYRO)
    accels, no_accels = _means(snapshot, Sensor.ACCEL)
    compasses, no_compasses = _means(snapshot, Sensor.MAG)
    place, field = _place(snapshot.recording), _field(snapshot)
    motion = moved(gyros, accels)
    ground = None if place is None else (place[0], place[2])
    upright = _upright(snapshot, accels)
    strength = _TYPICAL_FIELD if field is None else field.norm
    autopilot = snapshot.identity.autopilot or ""
    found = [
        inertial.gyro_rest(gyros, no_gyros, motion),
        inertial.gyro_noise(gyros, no_gyros, motion),
        inertial.accel_force(accels, no_accels, motion, ground),
        compass.compass_field(compasses, no_compasses, field),
        compass.compass_direction(compasses, upright, field, motion),
        history.temperature(snapshot),
        history.calibration_age(snapshot),
        history.sensor_check(snapshot),
        history.parameters_changed(snapshot),
        motor_compensation(snapshot, strength),
        own.vibration(snapshot.shaking),
        own.onboard_calibration(snapshot.view),
        own.arming_checks(autopilot, snapshot.parameters, complete=snapshot.complete),
    ]
    found = _attributed(snapshot, _undisturbed(snapshot, found))
    failed = [check.id for check in found if check.verdict == Verdict.FAIL]
    found.append(own.vehicle_prearm(snapshot.view, autopilot, snapshot.parameters, failed))
    return Report(tuple(found))


def _undisturbed(snapshot: Snapshot, found: list[Check]) -> list[Check]:
    """A sensor that was calibrated while it was looked at, say by PX4 at rest, has two readings and no verdict."""
    said: dict[CheckId, str] = {}
    for name in snapshot.rewritten:
        sensor = history.sensor_of(name)
        if sensor is not None:
            said |= dict.fromkeys(_ABOUT[sensor], f"{name} changed while the vehicle was looked at.")
    bad = (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)
    return [unknown(c.id, said[c.id], "Check again.") if c.id in said and c.verdict in bad else c for c in found]


def _attributed(snapshot: Snapshot, found: list[Check]) -> list[Check]:
    """Checks that failed for the cause of another one are left to that one: their sensor cannot be judged yet."""
    failed = {check.id for check in found if check.verdict == Verdict.FAIL}
    causes: dict[CheckId, CheckId] = {}
    for cause, sensors in _reach(snapshot):
        if cause in failed:
            causes |= {of: cause for sensor in sensors for of in _ABOUT[sensor]}
    if CheckId.COMPASS_FIELD in failed:  # what disturbs one compass reaches the others
        causes.setdefault(CheckId.COMPASS_DIRECTION, CheckId.COMPASS_FIELD)
    bad = (Verdict.FAIL, Verdict.WARN)
    return [c.because_of(causes[c.id]) if c.id in causes and c.verdict in bad else c for c in found]


def _reach(snapshot: Snapshot) -> tuple[tuple[CheckId, Iterable[Sensor]], ...]:
    """Checks that explain what sensors read, with these sensors; the last one that failed counts."""
    changed = {change.sensor for change in history.changes(snapshot) if change.sensor is not None}
    return (
        (CheckId.TEMPERATURE, (Sensor.GYRO, Sensor.ACCEL)),
        (CheckId.VIBRATION, (Sensor.GYRO, Sensor.ACCEL)),
        (CheckId.PARAMETERS_CHANGED, changed),
        (CheckId.SENSOR_IDS, history.ids_changed(snapshot)),
        (CheckId.ONBOARD_CALIBRATION, _ABOUT),
    )


def _means(snapshot: Snapshot, sensor: Sensor) -> tuple[dict[int, Mean], tuple[str, ...]]:
    """What every instance read, and sentences on those with too few samples."""
    means: dict[int, Mean] = {}
    silent: list[str] = []
    for instance in snapshot.recording.instances(sensor):
        if instance not in INSTANCES:
            continue
        mean = mean_at_rest(snapshot.recording, sensor, instance)
        if isinstance(mean, Silent):
            silent.append(mean.why)
        else:
            means[instance] = mean
    return means, tuple(silent)


def _place(recording: Recording) -> tuple[float, float, float] | None:
    """Latitude, longitude (deg) and altitude (m) that the vehicle said last."""
    for channel in recording.find(Sensor.POSITION):
        for latitude, longitude, altitude in channel.values[::-1].tolist():
            if latitude or longitude:  # (0, 0) is "no fix"
                return latitude, longitude, altitude
    return None


def _field(snapshot: Snapshot) -> EarthField | None:
    place = _place(snapshot.recording)
    if place is None:
        return None
    when = datetime.fromtimestamp(snapshot.now, UTC)
    try:
        return earth_field(*place, when.year + (when.timetuple().tm_yday - 1) / 365.25)
    except InvalidInputError:
        return None


def _upright(snapshot: Snapshot, accels: dict[int, Mean]) -> compass.Upright | None:
    """Down by the middle of the accelerometers; north by the vehicle's own attitude."""
    if not accels:
        return None
    force = np.median([mean.value for mean in accels.values()], axis=0)
    length = float(np.linalg.norm(force))
    if length < 1.0:
        return None
    down = -force / length
    heading = None if snapshot.heading is None else math.radians(snapshot.heading)
    return compass.Upright(down, _north(snapshot.recording), heading)


def _north(recording: Recording) -> Array | None:
    """True north in the body frame by the vehicle's attitude."""
    found = recording.find(Sensor.ATTITUDE)
    if not found:
        return None
    w, x, y, z = np.median(found[0].values, axis=0)
    north = np.array([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)])
    length = float(np.linalg.norm(north))
    return north / length if 0.9 < length < 1.1 else None
