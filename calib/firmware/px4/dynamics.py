"""What a PX4 log says of the flight itself: filtered inertial streams, set-points, battery, height, trajectory.

==========================  ==========================================================================================
vehicle_acceleration        specific force after ``IMU_ACCEL_CUTOFF``
vehicle_angular_velocity    after ``IMU_GYRO_CUTOFF``
vehicle_torque_setpoint     roll, pitch and yaw that the allocation is given, -1..1; with the thrust: CONTROL
battery_status              VOLTAGE
distance_sensor             HEIGHT
vehicle_air_data            AIR
==========================  ==========================================================================================

Source: AIRFRAME 3.2 (``logged_topics.cpp``).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mavcal.calib.firmware.px4.topics import Topics, columns, has, instances_of, sample_time, triple
from mavcal.calib.recording import Channel, Sensor, Stage

_DOWNWARD = 25
"""``orientation`` of a distance sensor that looks down. Source: MAV_SENSOR_ORIENTATION."""


def dynamics_channels(topics: Topics) -> Iterator[Channel]:
    """CONTROL, VOLTAGE, HEIGHT, AIR, filtered ACCEL and GYRO, and the estimator's ATTITUDE, VELOCITY and PLACE."""
    for name, sensor, unit in (
        ("vehicle_acceleration", Sensor.ACCEL, "m/s2"),
        ("vehicle_angular_velocity", Sensor.GYRO, "rad/s"),
    ):
        topic = topics.get((name, 0))
        if topic is not None and has(topic, "xyz[0]", "xyz[1]", "xyz[2]"):
            yield Channel(sensor, 0, sample_time(topic), triple(topic, "xyz"), unit, Stage.FILTERED, name)
    yield from _control(topics)
    for _, topic in instances_of(topics, "battery_status"):
        if "voltage_v" in topic:
            volts = columns(topic, "voltage_v")
            yield Channel(Sensor.VOLTAGE, 0, sample_time(topic), volts, "V", Stage.RAW, "battery_status")
            break
    yield from _height(topics)
    yield from _air(topics)
    yield from _estimates(topics)


def _control(topics: Topics) -> Iterator[Channel]:
    torque, thrust = topics.get(("vehicle_torque_setpoint", 0)), topics.get(("vehicle_thrust_setpoint", 0))
    axes = ("xyz[0]", "xyz[1]", "xyz[2]")
    if torque is None or thrust is None or not (has(torque, *axes) and has(thrust, *axes)):
        return
    t, lift = sample_time(torque), -triple(thrust, "xyz")[:, 2]
    last = np.clip(np.searchsorted(sample_time(thrust), t, side="right") - 1, 0, len(lift) - 1)
    values = np.column_stack([triple(torque, "xyz"), lift[last]])
    good = np.isfinite(values).all(axis=1)
    yield Channel(Sensor.CONTROL, 0, t[good], values[good], "1", Stage.RAW, "vehicle_torque_setpoint")


def _height(topics: Topics) -> Iterator[Channel]:
    for _, topic in instances_of(topics, "distance_sensor"):
        if has(topic, "current_distance", "orientation"):
            down = topic["orientation"] == _DOWNWARD
            metres = columns(topic, "current_distance")[down]
            yield Channel(Sensor.HEIGHT, 0, sample_time(topic)[down], metres, "m", Stage.RAW, "distance_sensor")
            return


def _air(topics: Topics) -> Iterator[Channel]:
    topic = topics.get(("vehicle_air_data", 0))
    warm = ("baro_temp_celcius", "ambient_temperature")  # PX4's own spelling; the other one since v1.16
    name = None if topic is None else next((n for n in warm if n in topic), None)
    if topic is not None and name is not None and "baro_pressure_pa" in topic:
        values = columns(topic, "baro_pressure_pa", name)
        good = np.isfinite(values).all(axis=1)
        yield Channel(Sensor.AIR, 0, sample_time(topic)[good], values[good], "Pa degC", Stage.RAW, "vehicle_air_data")


def _estimates(topics: Topics) -> Iterator[Channel]:
    topic = topics.get(("vehicle_attitude", 0))
    if topic is not None and has(topic, *(f"q[{k}]" for k in range(4))):
        q = columns(topic, *(f"q[{k}]" for k in range(4)))
        size = np.linalg.norm(q, axis=1)
        good = np.isfinite(size) & (size > 0.5)
        q = q[good] / size[good, None]
        yield Channel(Sensor.ATTITUDE, 0, sample_time(topic)[good], q, "1", Stage.RAW, "vehicle_attitude")
    topic = topics.get(("vehicle_local_position", 0))
    for sensor, fields, unit in ((Sensor.VELOCITY, ("vx", "vy", "vz"), "m/s"), (Sensor.PLACE, ("x", "y", "z"), "m")):
        if topic is not None and has(topic, *fields):
            values = columns(topic, *fields)
            good = np.isfinite(values).all(axis=1)
            t = sample_time(topic)[good]
            yield Channel(sensor, 0, t, values[good], unit, Stage.RAW, "vehicle_local_position")
