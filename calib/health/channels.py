"""Samples of a sensor as the autopilot uses them, with the calibration in force; and whether it has any."""

from __future__ import annotations

import dataclasses

import numpy as np

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.names import OFFSET, SCALE, Role
from mavcal.calib.firmware.px4.parameters import calibration_in_force
from mavcal.calib.firmware.slots import px4_calibration_names
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

_UNITS = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}
NOT_PHYSICAL = "no samples in physical units with the calibration in force: nothing can be said"
_ESTIMATED = "all of its samples have an estimator's bias taken out: nothing can be said of its own"


def why_unjudged(recording: Recording, sensor: Sensor, instance: int) -> str:
    """Reason why :func:`judged_channel` is None."""
    stages = {c.stage for c in recording.find(sensor, instance)}
    return _ESTIMATED if stages == {Stage.DEBIASED} else NOT_PHYSICAL


def judged_channel(recording: Recording, sensor: Sensor, instance: int) -> Channel | None:
    """The best channel in physical units with the calibration applied; None: the recording has none.

    A table's numbers are taken as they are. PX4 logs some sensors before their calibration only: theirs is applied
    here, as after a boot with the last parameters of the log.
    """
    found = [c for c in recording.find(sensor, instance) if c.stage != Stage.DEBIASED and c.unit == _UNITS[sensor]]
    corrected = [c for c in found if c.stage != Stage.RAW]
    if corrected or recording.identity.autopilot is None:
        return min(corrected or found, key=lambda c: (c.quantum, -len(c) * c.window, -len(c)), default=None)
    raw = max(found, key=len, default=None)
    if raw is None or recording.identity.autopilot != "px4":
        return None
    parameters = recording.parameters.final()
    try:
        if not parameters.get(px4_calibration_names(parameters, sensor, instance)[Role.ID]):
            return None  # a sensor without a row: its mounting is not known either
        model = calibration_in_force(parameters, sensor, instance)
    except CalibError:  # the log has no parameters, or none for so many sensors
        return None
    warm = next(iter(recording.find(Sensor.TEMPERATURE, instance)), None)
    if model.polynomial is not None and warm is None:
        return None
    temperature = None if model.polynomial is None or warm is None else np.interp(raw.t, warm.t, warm.values[:, 0])
    return dataclasses.replace(raw, values=model.apply(raw.values, temperature), stage=Stage.CORRECTED)


def never_calibrated(recording: Recording, sensor: Sensor, instance: int) -> bool:
    """Whether its parameters are in the log and all have the value of an uncalibrated sensor."""
    parameters = recording.parameters.final()
    try:
        if recording.identity.autopilot == "px4":
            roles = px4_calibration_names(parameters, sensor, instance)
        elif sensor == Sensor.MAG:
            roles = names.ardupilot_compass_names(instance, instance)
        else:
            roles = names.ardupilot_imu_names(sensor, instance)
    except CalibError:  # no parameters for so many sensors
        return False
    offsets = [parameters.get(roles[role]) for role in OFFSET]
    scales = [parameters.get(roles[role], 1.0) for role in SCALE if role in roles]
    return all(value == 0.0 for value in offsets) and all(value in (0.0, 1.0) for value in scales)


def in_use(recording: Recording, sensor: Sensor, instance: int) -> bool:
    """Whether the vehicle uses that sensor; True where its parameters do not say."""
    parameters = recording.parameters.final()
    if recording.identity.autopilot == "px4":
        return True
    if sensor in (Sensor.ACCEL, Sensor.GYRO):
        row = names.ardupilot_imu_names(sensor, instance) if instance < names.ARDUPILOT_IMU_SLOTS else {}
        return bool(parameters.get(row.get(names.Role.USE, ""), 1))
    if sensor != Sensor.MAG or instance >= names.ARDUPILOT_COMPASS_SLOTS:
        return True
    use = parameters.get(names.ardupilot_compass_names(instance, instance)[names.Role.USE], 1)
    return bool(use) and bool(parameters.get("COMPASS_ENABLE", parameters.get("MAG_ENABLE", 1)))
