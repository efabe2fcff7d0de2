"""Topics of a PX4 log as channels (FLIGHT_CONTROLLERS 2.2; ``logger/logged_topics.cpp``).

======================  ================================================================================================
sensor_accel/gyro/mag   the driver's output, uncorrected, every instance; thinned to 1 Hz unless SDLOG_PROFILE asks more
sensor_*_fifo           the same, every sample of the sensor
vehicle_imu             corrected means over one integration interval (5 ms), thinned to 2 Hz
vehicle_imu_status      means of the *uncorrected* sensor over 100 ms or more, turned into the body's frame
sensor_combined         corrected means of whichever sensors are selected, full rate
vehicle_magnetometer    corrected, and minus a bias estimate from the moment the vehicle has one
======================  ================================================================================================

PX4 matches calibrations by device id. A sensor's instance is the place of its ``CAL_*`` row among the filled ones, as
:mod:`calib.firmware.slots` counts; sensors without a row follow.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.px4.parameters import UT_PER_GAUSS, mounting
from mavcal.calib.firmware.slots import px4_sensor_ids
from mavcal.calib.recording import Array, Channel, Event, Oddity, OddSamples, Sensor, Stage

Topic = Mapping[str, NDArray[Any]]
"""Columns of one instance of a topic by field name, equally long."""
Topics = Mapping[tuple[str, int], Topic]
Parameters = Mapping[str, Value]

US: Final = 1e-6
DRIVER_WINDOW_S: Final = 1e-3
"""A driver's sample is the mean of what its FIFO held, about a millisecond (``samples`` of sensor_accel)."""
STATUS_WINDOW_S: Final = 0.1
"""vehicle_imu_status means cover at least this (``VehicleIMU.cpp``)."""
NO_TIME_RELATIVE: Final = 0x7FFFFFFF
"""``*_timestamp_relative`` of sensor_combined where that sensor has no sample."""
DRIVERS: Final = (
    (Sensor.ACCEL, "sensor_accel", "m/s2", 1.0),
    (Sensor.GYRO, "sensor_gyro", "rad/s", 1.0),
    (Sensor.MAG, "sensor_mag", "uT", UT_PER_GAUSS),
)
CALIBRATED_BY_DRIVER: Final = ("x_raw", "x_integral", "scaling")
"""Fields of firmwares before 1.11, whose drivers applied the calibration themselves (compasses until 1.12)."""
TRUTH: Final = "_groundtruth"
"""End of the topics in which a simulator says what is so (``logger/logged_topics.cpp``: SITL, or SYS_HITL)."""
WANTED: Final = frozenset(
    {"sensor_accel", "sensor_gyro", "sensor_mag", "sensor_accel_fifo", "sensor_gyro_fifo", "sensor_combined"}
    | {"sensor_selection", "vehicle_imu", "vehicle_imu_status", "vehicle_magnetometer", "magnetometer_bias_estimate"}
    | {"vehicle_attitude", "vehicle_gps_position", "sensor_gps", "vehicle_local_position", "battery_status"}
    | {"actuator_outputs", "actuator_motors", "esc_status", "vehicle_thrust_setpoint", "actuator_controls_0"}
    | {"vehicle_status", "actuator_armed"}
    | {
        "vehicle_angular_velocity",
        "vehicle_acceleration",
        "estimator_sensor_bias",
        "vehicle_torque_setpoint",
        "distance_sensor",
        "vehicle_air_data",
    }
    | {f"vehicle_{what}{TRUTH}" for what in ("attitude", "local_position", "global_position")}
)
"""Topics that are read; see :mod:`calib.firmware.px4.flight` for those beside the inertial ones."""


def inertial_channels(topics: Topics, parameters: Parameters) -> tuple[list[Channel], list[Event]]:
    """Channels of accelerometers, gyroscopes, magnetometers and thermometers, and what was left out or clipped."""
    rows = Rows(topics, parameters)
    events: list[Event] = []
    channels = [
        *_selected(topics, rows),
        *_means(topics, rows, parameters, events),
        *_integrated(topics, rows),
        *_fifos(topics, rows),
        *_drivers(topics, rows),
        *_fields(topics, rows, parameters, events),
        *_temperatures(topics, rows),
        *_vibration(topics, rows),
    ]
    events += _clipping(topics, rows)
    return channels, events


class Rows:
    """Instance number of each device id in the log."""

    def __init__(self, topics: Topics, parameters: Parameters) -> None:
        self._parameters = parameters
        self._of: dict[tuple[Sensor, int], int] = {}
        filled = px4_sensor_ids(parameters)
        for sensor, name, _, _ in DRIVERS:
            known = {device: instance for (kind, instance), device in filled.items() if kind == sensor}
            self._of |= {(sensor, device): instance for device, instance in known.items()}
            others = [device for device in _devices(topics, name, sensor) if device not in known]
            self._of |= {(sensor, device): len(known) + k for k, device in enumerate(others)}

    def instance(self, sensor: Sensor, device: int, multi_id: int) -> int:
        """Instance of the sensor with that device id; the topic's own number where the id is not known."""
        return self._of.get((sensor, device), multi_id)

    def primary(self, sensor: Sensor) -> int:
        """Instance of the primary sensor in older firmwares; 0 where it is not logged."""
        short = {Sensor.ACCEL: "ACC", Sensor.GYRO: "GYRO", Sensor.MAG: "MAG"}[sensor]
        device = int(self._parameters.get(f"CAL_{short}_PRIME", 0))
        return self._of.get((sensor, device), 0)


def columns(topic: Topic, *names: str) -> Array:
    """The fields side by side, (N, k)."""
    return np.stack([topic[name].astype(np.float64) for name in names], axis=1)


def triple(topic: Topic, name: str) -> Array:
    """Elements 0..2 of an array field, (N, 3)."""
    return columns(topic, *(f"{name}[{k}]" for k in range(3)))


def has(topic: Topic, *names: str) -> bool:
    """Whether the topic has all of these fields."""
    return all(name in topic for name in names)


def instances_of(topics: Topics, name: str) -> Iterator[tuple[int, Topic]]:
    """Every instance of a topic that has rows, ascending."""
    for (found, multi_id), topic in sorted(topics.items(), key=lambda item: item[0]):
        if found == name and len(topic["timestamp"]):
            yield multi_id, topic


def sample_time(topic: Topic) -> Array:
    """Time of the sensor's reading, s; of the row's publication where that is not logged."""
    stamp = topic["timestamp"].astype(np.float64)
    if "timestamp_sample" in topic:
        sampled = topic["timestamp_sample"].astype(np.float64)
        stamp = np.where(sampled > 0, sampled, stamp)
    return stamp * US


def _devices(topics: Topics, name: str, sensor: Sensor) -> list[int]:
    """Device ids of that sensor in the order of the topics' instances."""
    short = {Sensor.ACCEL: "accel_device_id", Sensor.GYRO: "gyro_device_id", Sensor.MAG: "device_id"}[sensor]
    other = "vehicle_magnetometer" if sensor == Sensor.MAG else "vehicle_imu"
    found: list[int] = []
    for source, column in ((name, "device_id"), (f"{name}_fifo", "device_id"), (other, short)):
        for _, topic in instances_of(topics, source):
            device = _device(topic, column)
            if device and device not in found:
                found.append(device)
    return found


def _device(topic: Topic, column: str = "device_id") -> int:
    """The device id that most rows carry; 0 if there is none."""
    if column not in topic:
        return 0
    ids, counts = np.unique(topic[column], return_counts=True)
    return int(ids[np.argmax(counts)])


def _drivers(topics: Topics, rows: Rows) -> Iterator[Channel]:
    for sensor, name, unit, factor in DRIVERS:
        for multi_id, topic in instances_of(topics, name):
            if not has(topic, "x", "y", "z"):
                continue
            old = any(field in topic for field in CALIBRATED_BY_DRIVER) or (
                sensor == Sensor.MAG and _compass_drivers_calibrate(topics)
            )
            yield Channel(
                sensor,
                rows.instance(sensor, _device(topic), multi_id),
                sample_time(topic),
                columns(topic, "x", "y", "z") * factor,
                unit,
                Stage.CORRECTED if old else Stage.RAW,
                name,
                window=DRIVER_WINDOW_S,
            )


def _compass_drivers_calibrate(topics: Topics) -> bool:
    """Firmwares before 1.12: vehicle_magnetometer has no device id, and its samples are uncorrected."""
    fields = topics.get(("vehicle_magnetometer", 0))
    return fields is not None and "device_id" not in fields


def _fifos(topics: Topics, rows: Rows) -> Iterator[Channel]:
    """Every sample of a FIFO: ``timestamp_sample`` is the newest one's, `dt` us apart.

    The step of the sensor's own converter is part of the sensor, so it is no quantum.
    """
    for sensor, name, unit, _ in DRIVERS[:2]:
        for multi_id, topic in instances_of(topics, f"{name}_fifo"):
            if not has(topic, "timestamp_sample", "dt", "scale", "samples", "x[0]", "y[0]", "z[0]"):
                continue
            depth = sum(f"x[{k}]" in topic and f"y[{k}]" in topic and f"z[{k}]" in topic for k in range(64))
            count = np.minimum(topic["samples"].astype(np.int64), depth)
            dt = topic["dt"].astype(np.float64)
            place = np.arange(depth)[None, :]
            age = (count[:, None] - 1 - place) * dt[:, None]
            t = (topic["timestamp_sample"].astype(np.float64)[:, None] - age) * US
            xyz = np.stack([columns(topic, *(f"{a}[{k}]" for k in range(depth))) for a in "xyz"], axis=2)
            there = place < count[:, None]
            yield Channel(
                sensor,
                rows.instance(sensor, _device(topic), multi_id),
                t[there],
                (xyz * topic["scale"].astype(np.float64)[:, None, None])[there],
                unit,
                Stage.RAW,
                f"{name}_fifo",
                window=float(np.median(dt)) * US,
            )


def _integrated(topics: Topics, rows: Rows) -> Iterator[Channel]:
    for multi_id, topic in instances_of(topics, "vehicle_imu"):
        for sensor, field, unit, device in (
            (Sensor.ACCEL, "delta_velocity", "m/s2", "accel_device_id"),
            (Sensor.GYRO, "delta_angle", "rad/s", "gyro_device_id"),
        ):
            if not has(topic, f"{field}[0]", f"{field}[1]", f"{field}[2]", f"{field}_dt"):
                continue
            dt = topic[f"{field}_dt"].astype(np.float64) * US
            good = dt > 0
            if not good.any():
                continue
            yield Channel(
                sensor,
                rows.instance(sensor, _device(topic, device), multi_id),
                (sample_time(topic) - 0.5 * dt)[good],
                triple(topic, field)[good] / dt[good, None],
                unit,
                Stage.CORRECTED,
                "vehicle_imu",
                window=float(np.median(dt[good])),
            )


def _means(topics: Topics, rows: Rows, parameters: Parameters, events: list[Event]) -> Iterator[Channel]:
    """Means of the uncorrected sensors, turned back from the body's frame into their own."""
    for multi_id, topic in instances_of(topics, "vehicle_imu_status"):
        for sensor, field, unit, device in (
            (Sensor.ACCEL, "mean_accel", "m/s2", "accel_device_id"),
            (Sensor.GYRO, "mean_gyro", "rad/s", "gyro_device_id"),
        ):
            if not has(topic, f"{field}[0]", f"{field}[1]", f"{field}[2]"):
                continue
            instance = rows.instance(sensor, _device(topic, device), multi_id)
            t = sample_time(topic)
            try:
                turn = mounting(parameters, sensor, instance)
            except FirmwareError as reason:
                text = f"the raw means of {sensor} {instance + 1} in vehicle_imu_status are left out: {reason}"
                events.append(Event(float(t[0]), "left_out", text))
                continue
            yield Channel(
                sensor,
                instance,
                t - 0.5 * STATUS_WINDOW_S,
                triple(topic, field) @ turn,
                unit,
                Stage.RAW,
                "vehicle_imu_status",
                window=STATUS_WINDOW_S,
            )


def _selected(topics: Topics, rows: Rows) -> Iterator[Channel]:
    """sensor_combined, each row as a sample of the sensors that were selected then."""
    topic = topics.get(("sensor_combined", 0))
    if topic is None or not len(topic["timestamp"]):
        return
    stamp = topic["timestamp"].astype(np.float64) * US
    for sensor, field, unit, factor, relative, integral in (
        (Sensor.GYRO, "gyro_rad", "rad/s", 1.0, "", "gyro_integral_dt"),
        (
            Sensor.ACCEL,
            "accelerometer_m_s2",
            "m/s2",
            1.0,
            "accelerometer_timestamp_relative",
            "accelerometer_integral_dt",
        ),
        (Sensor.MAG, "magnetometer_ga", "uT", UT_PER_GAUSS, "magnetometer_timestamp_relative", ""),
    ):
        if not has(topic, f"{field}[0]", f"{field}[1]", f"{field}[2]"):
            continue
        later = topic[relative].astype(np.int64) if relative in topic else np.zeros(len(stamp), dtype=np.int64)
        dt = _integral(topic, integral)
        t = stamp + later * US
        fresh = later != NO_TIME_RELATIVE
        fresh[fresh] = np.diff(t[fresh], prepend=-np.inf) > 0  # rows repeat the last sample of a slower sensor
        values = triple(topic, field) * factor
        for instance, chosen in _selections(topics, rows, sensor, stamp):
            take = fresh & chosen
            if take.any():
                yield Channel(
                    sensor,
                    instance,
                    (t - 0.5 * dt)[take],
                    values[take],
                    unit,
                    Stage.CORRECTED,
                    "sensor_combined",
                    window=float(np.median(dt[take])) or DRIVER_WINDOW_S,
                )


def _integral(topic: Topic, field: str) -> Array:
    """Length of the integration intervals, s: older firmwares give seconds, later ones microseconds."""
    if field not in topic:
        return np.zeros(len(topic["timestamp"]))
    dt = topic[field].astype(np.float64)
    return np.clip(dt if topic[field].dtype.kind == "f" else dt * US, 0.0, 1.0)


def _selections(topics: Topics, rows: Rows, sensor: Sensor, stamp: Array) -> Iterator[tuple[int, NDArray[np.bool_]]]:
    """Instances that were the selected one, each with the rows at which it was."""
    selection = topics.get(("sensor_selection", 0))
    column = {Sensor.ACCEL: "accel_device_id", Sensor.GYRO: "gyro_device_id"}.get(sensor, "mag_device_id")
    if selection is None or column not in selection or not len(selection["timestamp"]):
        yield rows.primary(sensor), np.ones(len(stamp), dtype=bool)
        return
    since = selection["timestamp"].astype(np.float64) * US
    place = np.maximum(np.searchsorted(since, stamp, side="right") - 1, 0)
    device = selection[column][place]
    for chosen in np.unique(device):
        yield rows.instance(sensor, int(chosen), 0), np.asarray(device == chosen)


def _fields(topics: Topics, rows: Rows, parameters: Parameters, events: list[Event]) -> Iterator[Channel]:
    """vehicle_magnetometer up to the first bias estimate; what follows is useless for calibration."""
    for multi_id, topic in instances_of(topics, "vehicle_magnetometer"):
        if not has(topic, "magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]"):
            continue
        device = _device(topic)
        instance = rows.instance(Sensor.MAG, device, multi_id) if device else rows.primary(Sensor.MAG)
        t, values = sample_time(topic), triple(topic, "magnetometer_ga") * UT_PER_GAUSS
        debiased = t >= _estimated_from(topics, parameters, multi_id)
        for stage, rows_of in ((Stage.CORRECTED, ~debiased), (Stage.DEBIASED, debiased)):
            if rows_of.any():
                yield Channel(
                    Sensor.MAG,
                    instance,
                    t[rows_of],
                    values[rows_of],
                    "uT",
                    stage,
                    "vehicle_magnetometer",
                    window=DRIVER_WINDOW_S,
                )
        if debiased.any():
            text = (
                f"vehicle_magnetometer {instance + 1} has a running bias estimate subtracted and is not used; "
                "log sensor_mag at full rate (SDLOG_PROFILE bit 11) to calibrate it"
            )
            events.append(Event(float(t[debiased][0]), "left_out", text))


def _estimated_from(topics: Topics, parameters: Parameters, multi_id: int) -> float:
    """Time from which the magnetometer's running bias estimate may be subtracted; inf: never.

    ``MBE_ENABLE`` switches mag_bias_estimator (from 1.12 on); where its estimates were not logged they may have been
    there from the beginning.
    """
    topic = topics.get(("magnetometer_bias_estimate", 0))
    valid = f"valid[{multi_id}]"
    if topic is not None and valid in topic:
        good = np.flatnonzero(topic[valid])
        return float(topic["timestamp"][good[0]]) * US if len(good) else np.inf
    return -np.inf if parameters.get("MBE_ENABLE", 0) else np.inf


def _temperatures(topics: Topics, rows: Rows) -> Iterator[Channel]:
    """The thermometer of each inertial unit, for its accelerometer and, if that counts differently, its gyroscope."""
    held: set[tuple[str, int]] = set()
    for sensor, name, column, device in (
        (Sensor.ACCEL, "sensor_accel", "temperature", "device_id"),
        (Sensor.ACCEL, "vehicle_imu_status", "temperature_accel", "accel_device_id"),
        (Sensor.GYRO, "sensor_gyro", "temperature", "device_id"),
        (Sensor.GYRO, "vehicle_imu_status", "temperature_gyro", "gyro_device_id"),
    ):
        for multi_id, topic in instances_of(topics, name):
            instance = rows.instance(sensor, _device(topic, device), multi_id)
            if column not in topic or instance in {i for _, i in held if sensor == Sensor.GYRO}:
                continue
            good = np.isfinite(topic[column])
            if good.any() and (name, instance) not in held:
                held.add((name, instance))
                t, values = sample_time(topic)[good], topic[column].astype(np.float64)[good]
                yield Channel(Sensor.TEMPERATURE, instance, t, values, "degC", Stage.RAW, name)


def _vibration(topics: Topics, rows: Rows) -> Iterator[Channel]:
    """The levels of vehicle_imu_status: the running mean of the step from one sample to the next."""
    for multi_id, topic in instances_of(topics, "vehicle_imu_status"):
        for level, sensor, field, unit, device in (
            (Sensor.VIBRATION, Sensor.ACCEL, "accel_vibration_metric", "m/s2", "accel_device_id"),
            (Sensor.GYRO_VIBRATION, Sensor.GYRO, "gyro_vibration_metric", "rad/s", "gyro_device_id"),
        ):
            if field in topic:
                t, values = topic["timestamp"].astype(np.float64) * US, columns(topic, field)
                good = np.isfinite(values[:, 0])
                instance = rows.instance(sensor, _device(topic, device), multi_id)
                yield Channel(level, instance, t[good], values[good], unit, Stage.RAW, "vehicle_imu_status")


def _clipping(topics: Topics, rows: Rows) -> list[Event]:
    """Clipping count of each accelerometer; the counters run since boot."""
    events = []
    for multi_id, topic in instances_of(topics, "vehicle_imu_status"):
        if not has(topic, "accel_clipping[0]", "accel_clipping[1]", "accel_clipping[2]"):
            continue
        instance = rows.instance(Sensor.ACCEL, _device(topic, "accel_device_id"), multi_id)
        counts = [int(topic[f"accel_clipping[{k}]"].max()) for k in range(3)]
        if any(counts):
            axes = ", ".join(f"{axis} {count}" for axis, count in zip("xyz", counts, strict=True))
            text = f"accel {instance + 1} reached the end of its range {sum(counts)} times since boot ({axes})"
            t, counter = sample_time(topic), columns(topic, *(f"accel_clipping[{k}]" for k in range(3))).sum(axis=1)
            rose = np.flatnonzero(np.diff(counter) > 0) + 1  # what it counted before is no fault of this flight
            first, last = (float(t[rose[0]]), float(t[rose[-1]])) if len(rose) else (float(t[-1]), None)
            count = int(np.maximum(np.diff(counter), 0).sum())
            odd = OddSamples(Oddity.CLIPPED, Sensor.ACCEL, instance, count, until=last)
            events.append(Event(first, "clipping", text, odd))
    return events
