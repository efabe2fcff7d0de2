"""The whole preflight: every check on one snapshot, causes before consequences."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mavcal.calib.firmware.in_force.needed import needed
from mavcal.calib.firmware.plan import Value
from mavcal.calib.preflight import compass, history, inertial, self_report
from mavcal.calib.preflight.check import Check, CheckId, Report, Snapshot, Verdict, VerifiedCalibration, unknown
from mavcal.calib.preflight.installed import WORDS, Announced, Key, announced
from mavcal.calib.preflight.liveness import Census, census, sensors_heard
from mavcal.calib.preflight.movement import movement
from mavcal.calib.preflight.rest import Mean, Silent, mean_at_rest, moved
from mavcal.calib.recording import Array, Recording, Sensor

_ABOUT = {
    Sensor.GYRO: (CheckId.GYRO_REST, CheckId.GYRO_NOISE),
    Sensor.ACCEL: (CheckId.ACCEL_FORCE,),
    Sensor.MAG: (CheckId.COMPASS_FIELD, CheckId.COMPASS_DIRECTION),
}
_MOVED_BY = {s: checks if s == Sensor.MAG else (*checks, CheckId.ATTITUDE) for s, checks in _ABOUT.items()}
"""Checks that may fail when a sensor reads differently. The attitude depends on gyroscopes and accelerometers."""
_FOLLOWS = {
    CheckId.COMPASS_FIELD: (CheckId.COMPASS_DIRECTION,),  # what disturbs one compass reaches the others
    CheckId.GYRO_NOISE: (CheckId.GYRO_REST, CheckId.ATTITUDE),
    CheckId.GYRO_REST: (CheckId.ATTITUDE,),
    CheckId.ACCEL_FORCE: (CheckId.ATTITUDE,),
    CheckId.SENSORS_HEARD: (CheckId.ATTITUDE,),
}
"""Checks whose failure explains that of others, whichever sensor it is."""
_MEND = f"Mend {CheckId.SENSORS_HEARD} first, then check again."
_FOLLOW = "It read one value all the time and may be frozen: turn the vehicle by 20 deg and see whether it follows."
_SUBJECTS = (inertial.SUBJECT, compass.SUBJECT, history.SUBJECT, self_report.SUBJECT)


def preflight(snapshot: Snapshot) -> Report:
    """The report with every check; a consequence of another failure is not a failure of its own."""
    autopilot, parameters = snapshot.identity.autopilot or "", snapshot.parameters
    installed, turning = announced(autopilot, parameters, snapshot.stated), movement(snapshot.recording)
    there = census(snapshot, installed, turning)
    gyros, accels, compasses = (_means(snapshot, there, kind) for kind in (Sensor.GYRO, Sensor.ACCEL, Sensor.MAG))
    place, field = compass.place_of(snapshot.recording), compass.field_of(snapshot)
    motion = moved(gyros.means, accels.means) or turning.text
    ground = None if place is None else (place[0], place[2])
    rest = inertial.gyro_rest(gyros.means, gyros.silent, motion, installed=gyros.installed)
    followed = _followed(autopilot, parameters, installed)
    upright = _upright(snapshot, accels.means, astray=_astray(there, rest, followed))
    found = [
        sensors_heard(there, installed, complete=snapshot.complete),
        rest,
        inertial.gyro_noise(gyros.means, gyros.silent, motion, installed=gyros.installed),
        inertial.accel_force(accels.means, accels.silent, motion, ground, installed=accels.installed),
        compass.compass_field(compasses.means, compasses.silent, field, installed=compasses.installed),
        compass.compass_direction(
            compasses.means,
            upright,
            field,
            motion,
            installed=compasses.installed,
            declination=compass.set_declination(autopilot, parameters, field),
            followed=followed,
        ),
        inertial.attitude(snapshot, accels.means, motion),
        *(check(snapshot) for subject in _SUBJECTS for check in subject.checks),
    ]
    found.sort(key=lambda check: list(CheckId).index(check.id))
    found = _attributed(snapshot, _still(there, _without_sensor(there, _undisturbed(snapshot, found))))
    failed = [check.id for check in found if check.verdict == Verdict.FAIL]
    found.append(self_report.vehicle_prearm(snapshot.view, autopilot, snapshot.parameters, failed))
    return Report(tuple(found))


def looked_up(autopilot: str, known: Mapping[str, Value], history: Iterable[VerifiedCalibration]) -> set[str]:
    """Names of the parameters that the checks use; call again with the values read until there are no new names."""
    found = {name for entry in history for name in entry.parameters} | needed(autopilot, _ABOUT, known, drift=False)
    return found | {name for subject in _SUBJECTS for name in subject.parameters.get(autopilot, ())}


def _without_sensor(there: Census, found: list[Check]) -> list[Check]:
    """Results of checks that lack a sensor: a link failure is not a sensor's, and a dead sensor is reported once."""
    reasons: dict[CheckId, tuple[str, str]] = {}
    for kind, checks in _ABOUT.items():
        dead = [why for (of, _), why in there.dead.items() if of == kind]
        thin = [why for (of, _), why in there.thin.items() if of == kind]
        if there.of(kind) or not (dead or thin):
            continue
        reason = f"No {WORDS[kind][0]} could be judged: {'; '.join([*dead, *thin])}."
        if dead:
            cause = (f"{reason} This follows from {CheckId.SENSORS_HEARD}, which failed.", _MEND)
        else:
            cause = (f"{reason} That is the link's fault.", "Check again over a better link.")
        reasons |= dict.fromkeys(checks, cause)
    return [unknown(c.id, *reasons[c.id]) if c.id in reasons and c.verdict == Verdict.UNKNOWN else c for c in found]


def _still(there: Census, found: list[Check]) -> list[Check]:
    """The checks, where a wrong compass with a constant reading must first be shown to be live."""
    still = {f"{WORDS[kind][0]} {i + 1}" for kind, i in there.constant if kind == Sensor.MAG}
    compasses = _ABOUT[Sensor.MAG]
    return [
        dataclasses.replace(c, remedy=f"{_FOLLOW} {c.remedy}") if c.id in compasses and still & set(c.suspects) else c
        for c in found
    ]


def _astray(there: Census, rest: Check, followed: int) -> bool:
    """Whether the vehicle's heading cannot serve as a reference, as its gyroscope or compass failed."""
    dead = any(kind == Sensor.GYRO for kind, _ in there.dead)
    return rest.verdict in (Verdict.FAIL, Verdict.WARN) or dead or (Sensor.MAG, followed) in there.dead


def _followed(autopilot: str, parameters: Mapping[str, Value], installed: Mapping[Key, Announced]) -> int:
    """The compass that the vehicle's heading follows: ArduPilot's first in use, PX4's of the highest priority."""
    used = sorted(instance for kind, instance in installed if kind == Sensor.MAG)
    if autopilot != "px4" or not used:
        return used[0] if used else 0
    rows = {i: installed[Sensor.MAG, i].by.partition("_ID")[0] for i in used}
    return max(used, key=lambda i: (parameters.get(f"{rows[i]}_PRIO", -1), -i))


def _undisturbed(snapshot: Snapshot, found: list[Check]) -> list[Check]:
    """The checks without a verdict on sensors that were recalibrated meanwhile, as by PX4 at rest."""
    changed: dict[CheckId, str] = {}
    for name in snapshot.rewritten:
        sensor = history.sensor_of(name)
        if sensor is not None:
            changed |= dict.fromkeys(_ABOUT[sensor], f"{name} changed while the vehicle was looked at.")
    bad = (Verdict.FAIL, Verdict.WARN, Verdict.UNKNOWN)
    return [unknown(c.id, changed[c.id], "Check again.") if c.id in changed and c.verdict in bad else c for c in found]


def _attributed(snapshot: Snapshot, found: list[Check]) -> list[Check]:
    """The checks, with failures attributed to the failed check that explains them.

    Until that is repaired, their sensor cannot be judged.
    """
    failed = {check.id for check in found if check.verdict == Verdict.FAIL}
    causes: dict[CheckId, CheckId] = {}
    for cause, sensors in _explaining_checks(snapshot):
        if cause in failed:
            causes |= {of: cause for sensor in sensors for of in _MOVED_BY[sensor]}
    for cause, follows in _FOLLOWS.items():
        if cause in failed:
            for of in follows:
                causes.setdefault(of, cause)
    bad = (Verdict.FAIL, Verdict.WARN)
    causes = {of: cause for of, cause in causes.items() if of != cause}
    return [c.because_of(causes[c.id]) if c.id in causes and c.verdict in bad else c for c in found]


def _explaining_checks(snapshot: Snapshot) -> tuple[tuple[CheckId, Iterable[Sensor]], ...]:
    """Checks that explain readings, with the affected sensors; the last failed one counts."""
    changed = {change.sensor for change in history.changes(snapshot) if change.sensor is not None}
    return (
        (CheckId.TEMPERATURE, (Sensor.GYRO, Sensor.ACCEL)),
        (CheckId.VIBRATION, (Sensor.GYRO, Sensor.ACCEL)),
        (CheckId.PARAMETERS_CHANGED, changed),
        (CheckId.SENSOR_IDS, history.ids_changed(snapshot)),
        (CheckId.ONBOARD_CALIBRATION, _ABOUT),
    )


@dataclass(frozen=True)
class _Kind:
    """Every sensor of one kind."""

    means: dict[int, Mean]
    silent: tuple[str, ...]
    """Sentences on those that cannot be judged."""
    installed: int


def _means(snapshot: Snapshot, there: Census, sensor: Sensor) -> _Kind:
    """Means of every living instance, and sentences on the others."""
    means: dict[int, Mean] = {}
    silent = [why for texts in (there.dead, there.thin) for (kind, _), why in sorted(texts.items()) if kind == sensor]
    for instance in sorted(there.of(sensor)):
        mean = mean_at_rest(snapshot.recording, sensor, instance)
        if isinstance(mean, Silent):
            silent.append(mean.why)
        else:
            means[instance] = mean
    return _Kind(means, tuple(silent), there.installed[sensor])


def _upright(snapshot: Snapshot, accels: dict[int, Mean], *, astray: bool) -> compass.Upright | None:
    """Down from the median of the accelerometers; north from the vehicle's own attitude, unless that is `astray`."""
    if not accels:
        return None
    force = np.median([mean.value for mean in accels.values()], axis=0)
    length = float(np.linalg.norm(force))
    if length < 1.0:
        return None
    down = -force / length
    heading = None if snapshot.heading is None else math.radians(snapshot.heading)
    return compass.Upright(down, None if astray else _north(snapshot.recording), heading)


def _north(recording: Recording) -> Array | None:
    """True north in the body frame by the vehicle's attitude."""
    found = recording.find(Sensor.ATTITUDE)
    if not found:
        return None
    w, x, y, z = np.median(found[0].values, axis=0)
    north = np.array([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)])
    length = float(np.linalg.norm(north))
    return north / length if 0.9 < length < 1.1 else None
