"""Channels of a PX4 log beside its inertial sensors: pose, place, current, throttle, motors, arming, flight.

==========================  ==========================================================================================
vehicle_acceleration        specific force after ``IMU_ACCEL_CUTOFF``, with the estimator's bias put back
vehicle_angular_velocity    after ``IMU_GYRO_CUTOFF``, likewise
vehicle_torque_setpoint     roll, pitch and yaw that the allocation is given, -1..1; with the thrust: CONTROL
battery_status              VOLTAGE
distance_sensor             HEIGHT
vehicle_air_data            AIR
==========================  ==========================================================================================

Source of the table: AIRFRAME 3.2 (``logged_topics.cpp``); of the bias, ``VehicleAcceleration.cpp`` and
``VehicleAngularVelocity.cpp``, which subtract the latest ``estimator_sensor_bias`` of their sensor. It wanders by
0.2 m/s2 in flights of PX4's SIH.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.firmware.px4.topics import TRUTH, US, Topic, Topics, columns, has, instances_of, sample_time, triple
from mavcal.calib.recording import Array, Channel, Event, Sensor, Stage

FIX_3D: Final = 3
ARMING_STATE_ARMED: Final = 2
MOST_OUTPUTS: Final = 16
PWM_LOW, PWM_NEUTRAL, PWM_SPAN = 1000.0, 1500.0, 1000.0
REVERSIBLE: Final = frozenset(
    {dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_SURFACE_BOAT, dialect.MAV_TYPE_SUBMARINE}
)
WITH_SURFACES: Final = frozenset(
    {dialect.MAV_TYPE_FIXED_WING, *range(dialect.MAV_TYPE_VTOL_DUOROTOR, dialect.MAV_TYPE_VTOL_RESERVED5 + 1)}
)
_DOWNWARD = 25
"""``orientation`` of a distance sensor that looks down. Source: MAV_SENSOR_ORIENTATION."""


def flight_channels(topics: Topics, kind: int | None = None) -> list[Channel]:
    """Attitude, position, velocity, place, current, throttle, motors and rotor speeds; `kind` is the MAV_TYPE."""
    makers = (_attitude, _gps, _local, _current, _throttle, partial(_motors, kind=kind), _rotors)
    return [channel for maker in makers for channel in maker(topics) if len(channel)]


def truth_channels(topics: Topics) -> list[Channel]:
    """Simulator truth from the ``*_groundtruth`` topics: attitude, place, velocity and position."""
    made = (
        *_attitude(topics, "vehicle_attitude" + TRUTH),
        *_local(topics, "vehicle_local_position" + TRUTH),
        *_global(topics, "vehicle_global_position" + TRUTH),
    )
    return [channel for channel in made if len(channel)]


def arming_events(topics: Topics) -> list[Event]:
    """The first state, armed or disarmed, and every change."""
    for name, column, armed in (("actuator_armed", "armed", 1), ("vehicle_status", "arming_state", ARMING_STATE_ARMED)):
        topic = topics.get((name, 0))
        if topic is None or column not in topic or not len(topic["timestamp"]):
            continue
        state = topic[column].astype(np.int64) == armed
        turned = np.flatnonzero(np.diff(state, prepend=not state[0]))
        kinds = ["armed" if state[i] else "disarmed" for i in turned]
        stamps = topic["timestamp"][turned].astype(np.float64) * US
        return [Event(float(t), kind, f"the vehicle was {kind}") for t, kind in zip(stamps, kinds, strict=True)]
    return []


def _finite(sensor: Sensor, instance: int, t: Array, values: Array, unit: str, source: str) -> Channel:
    """A channel of the rows in which every value is a number."""
    good = np.isfinite(values).all(axis=1)
    return Channel(sensor, instance, t[good], values[good], unit, Stage.RAW, source)


def _attitude(topics: Topics, name: str = "vehicle_attitude") -> Iterator[Channel]:
    topic = topics.get((name, 0))
    if topic is None or not has(topic, *(f"q[{k}]" for k in range(4))):
        return
    q = columns(topic, *(f"q[{k}]" for k in range(4)))
    size = np.linalg.norm(q, axis=1)
    good = np.isfinite(size) & (size > 0.5)
    q = q[good] / size[good, None]
    yield Channel(Sensor.ATTITUDE, 0, sample_time(topic)[good], q, "1", Stage.RAW, name)


def _gps(topics: Topics) -> Iterator[Channel]:
    name = "vehicle_gps_position" if ("vehicle_gps_position", 0) in topics else "sensor_gps"
    topic = topics.get((name, 0))
    if topic is None or not has(topic, "timestamp", "fix_type"):
        return
    topic = {field: values[topic["fix_type"] >= FIX_3D] for field, values in topic.items()}
    t = sample_time(topic)
    if has(topic, "latitude_deg", "longitude_deg", "altitude_msl_m"):
        place = columns(topic, "latitude_deg", "longitude_deg", "altitude_msl_m")
        yield _finite(Sensor.POSITION, 0, t, place, "deg deg m", name)
    elif has(topic, "lat", "lon", "alt"):
        place = columns(topic, "lat", "lon", "alt") * np.array([1e-7, 1e-7, 1e-3])
        yield _finite(Sensor.POSITION, 0, t, place, "deg deg m", name)
    if has(topic, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s"):
        yield _finite(Sensor.VELOCITY, 0, t, columns(topic, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s"), "m/s", name)


def _global(topics: Topics, name: str) -> Iterator[Channel]:
    topic = topics.get((name, 0))
    if topic is not None and has(topic, "lat", "lon", "alt"):
        yield _finite(Sensor.POSITION, 0, sample_time(topic), columns(topic, "lat", "lon", "alt"), "deg deg m", name)


def _local(topics: Topics, name: str = "vehicle_local_position") -> Iterator[Channel]:
    topic = topics.get((name, 0))
    if topic is None:
        return
    for sensor, fields, unit, flag in (
        (Sensor.PLACE, ("x", "y", "z"), "m", "xy_valid"),
        (Sensor.VELOCITY, ("vx", "vy", "vz"), "m/s", "v_xy_valid"),
    ):
        if has(topic, *fields):
            valid = topic[flag] != 0 if flag in topic else np.ones(len(topic["timestamp"]), dtype=bool)
            yield _finite(sensor, 0, sample_time(topic)[valid], columns(topic, *fields)[valid], unit, name)


def _current(topics: Topics) -> Iterator[Channel]:
    for multi_id, topic in instances_of(topics, "battery_status"):
        if "current_a" in topic:
            measured = topic["current_a"] >= 0.0  # -1: not measured
            values = columns(topic, "current_a")[measured]
            yield _finite(Sensor.CURRENT, multi_id, sample_time(topic)[measured], values, "A", "battery_status")


def _throttle(topics: Topics) -> Iterator[Channel]:
    """|thrust setpoint|, which is what CAL_MAG_COMP_TYP 1 multiplies."""
    topic = topics.get(("vehicle_thrust_setpoint", 0))
    if topic is not None and has(topic, "xyz[0]", "xyz[1]", "xyz[2]"):
        size = np.linalg.norm(triple(topic, "xyz"), axis=1)[:, None]
        yield _finite(Sensor.THROTTLE, 0, sample_time(topic), size, "1", "vehicle_thrust_setpoint")
        return
    topic = topics.get(("actuator_controls_0", 0))
    if topic is not None and "control[3]" in topic:
        size = np.abs(columns(topic, "control[3]"))
        yield _finite(Sensor.THROTTLE, 0, sample_time(topic), size, "1", "actuator_controls_0")


def _motors(topics: Topics, kind: int | None = None) -> Iterator[Channel]:
    """Motor commands 0..1, or -1..1; where only PWM was logged, every output in use, whatever it drives.

    Pulses of a rover, boat or sub rest at neutral. Those of a plane are not taken: its surfaces rest there as well.
    """
    topic = topics.get(("actuator_motors", 0))
    if topic is not None:
        used = [f"control[{k}]" for k in range(MOST_OUTPUTS) if f"control[{k}]" in topic]
        used = [name for name in used if np.isfinite(topic[name]).any()]
        if used:
            # nan: the motor is stopped; below 0: it turns back (CA_R_REV)
            values = np.clip(np.nan_to_num(columns(topic, *used), nan=0.0), -1.0, 1.0)
            yield _finite(Sensor.MOTOR, 0, sample_time(topic), values, "1", "actuator_motors")
        return
    if kind in WITH_SURFACES:
        return
    zero, span, least = (PWM_NEUTRAL, 0.5 * PWM_SPAN, -1.0) if kind in REVERSIBLE else (PWM_LOW, PWM_SPAN, 0.0)
    for multi_id, outputs in instances_of(topics, "actuator_outputs"):
        used = [f"output[{k}]" for k in range(MOST_OUTPUTS) if f"output[{k}]" in outputs and _is_pwm(outputs, k)]
        if used:
            values = np.clip((columns(outputs, *used) - zero) / span, least, 1.0)
            yield _finite(Sensor.MOTOR, multi_id, sample_time(outputs), values, "1", "actuator_outputs")


def _is_pwm(topic: Topic, output: int) -> bool:
    values = topic[f"output[{output}]"]
    return bool((values >= 800.0).all() and (values <= 2200.0).all())


def _rotors(topics: Topics) -> Iterator[Channel]:
    topic = topics.get(("esc_status", 0))
    if topic is None or "esc_count" not in topic or not len(topic["timestamp"]):
        return
    count = min(int(topic["esc_count"].max()), 8)
    used = [f"esc[{k}].esc_rpm" for k in range(count)]
    if used and has(topic, *used):
        speeds = np.abs(columns(topic, *used)) / 60.0
        yield _finite(Sensor.ROTOR_SPEED, 0, sample_time(topic), speeds, "Hz", "esc_status")


def dynamics_channels(topics: Topics) -> Iterator[Channel]:
    """CONTROL, VOLTAGE, HEIGHT, AIR, filtered ACCEL and GYRO, and the estimator's ATTITUDE, VELOCITY and PLACE."""
    for name, sensor, unit, of in (
        ("vehicle_acceleration", Sensor.ACCEL, "m/s2", "accel"),
        ("vehicle_angular_velocity", Sensor.GYRO, "rad/s", "gyro"),
    ):
        topic = topics.get((name, 0))
        if topic is not None and has(topic, "xyz[0]", "xyz[1]", "xyz[2]"):
            values = triple(topic, "xyz") + _estimated_bias(topics, of, topic["timestamp"])
            yield Channel(sensor, 0, sample_time(topic), values, unit, Stage.FILTERED, name)
    yield from _control(topics)
    for _, topic in instances_of(topics, "battery_status"):
        if "voltage_v" in topic:
            volts = columns(topic, "voltage_v")
            yield Channel(Sensor.VOLTAGE, 0, sample_time(topic), volts, "V", Stage.RAW, "battery_status")
            break
    yield from _height(topics)
    yield from _air(topics)
    yield from _estimates(topics)


def _estimated_bias(topics: Topics, of: str, stamps: NDArray[Any]) -> Array:
    """The estimator's bias (N, 3) that was subtracted from the selected sensor at `stamps`; 0 where none was logged."""
    logged = dict(instances_of(topics, "estimator_sensor_bias"))
    selection, device = topics.get(("sensor_selection", 0)), f"{of}_device_id"
    if selection is not None and device in selection and len(selection[device]):
        chosen = selection[device][-1]  # the firmware subtracts nothing that was estimated for another sensor
        logged = {k: t for k, t in logged.items() if device not in t or (t[device] == chosen).any()}
    topic = next(iter(logged.values()), None)
    if topic is None or not has(topic, *(f"{of}_bias[{k}]" for k in range(3))):
        return np.zeros((len(stamps), 3))
    latest = np.searchsorted(topic["timestamp"], stamps, side="right") - 1
    bias = np.nan_to_num(triple(topic, f"{of}_bias"))
    return np.where((latest >= 0)[:, None], bias[np.maximum(latest, 0)], 0.0)


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
        yield _finite(Sensor.AIR, 0, sample_time(topic), values, "Pa degC", "vehicle_air_data")


def _estimates(topics: Topics) -> Iterator[Channel]:
    yield from _attitude(topics)
    topic = topics.get(("vehicle_local_position", 0))
    for sensor, fields, unit in ((Sensor.VELOCITY, ("vx", "vy", "vz"), "m/s"), (Sensor.PLACE, ("x", "y", "z"), "m")):
        if topic is not None and has(topic, *fields):
            yield _finite(sensor, 0, sample_time(topic), columns(topic, *fields), unit, "vehicle_local_position")
