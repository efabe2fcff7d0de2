"""State of a sensor's calibration by the vehicle's parameters."""

from __future__ import annotations

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.names import OFFSET, SCALE
from mavcal.calib.firmware.slots import px4_calibration_names
from mavcal.calib.recording import Recording, Sensor


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
