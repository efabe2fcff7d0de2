"""Readings of the inertial units at rest for the record: raw rates, corrected forces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware import calibration_in_force, sensor_ids
from mavcal.calib.preflight.history import calibrates_gyros, sensor_of
from mavcal.calib.preflight.rest import Mean, Silent, mean_at_rest, moved
from mavcal.calib.preflight.snapshot import Snapshot
from mavcal.calib.recording import Recording, Sensor

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class RestReading:
    """One unit at rest. `value` and `sd` are of a corrected sample's mean, in rad/s or m/s2, body frame."""

    sensor: Sensor
    instance: int
    device_id: int
    temperature: float | None
    """degC; None: not known."""
    value: Triple
    sd: Triple
    bias: Triple | None
    """A gyroscope's raw bias: what it read without the calibration in force. None: an accelerometer, or not known."""
    by_itself: bool
    """Whether the vehicle calibrates it by itself."""

    @property
    def norm(self) -> float:
        """Rate, or specific force."""
        return float(np.linalg.norm(self.value))


def rest_readings(snapshot: Snapshot) -> tuple[RestReading, ...]:
    """Every gyroscope and accelerometer whose device id is known; none if the vehicle was moved."""
    try:
        ids = sensor_ids(snapshot.identity.autopilot, snapshot.parameters)
    except CalibError:
        return ()
    means: dict[tuple[Sensor, int], Mean] = {
        (sensor, instance): mean
        for sensor, instance in ids
        if sensor in (Sensor.GYRO, Sensor.ACCEL)
        and not isinstance(mean := mean_at_rest(snapshot.recording, sensor, instance), Silent)
    }
    if moved(_of(means, Sensor.GYRO), _of(means, Sensor.ACCEL)) is not None:
        return ()
    warm = {instance: _temperature(snapshot.recording, instance) for _, instance in means}
    return tuple(
        RestReading(
            sensor,
            instance,
            ids[sensor, instance],
            warm[instance],
            _triple(mean.value),
            _triple(mean.sd),
            _raw(snapshot, sensor, instance, mean, warm[instance]),
            sensor == Sensor.GYRO and calibrates_gyros(snapshot.identity.autopilot or "", snapshot.parameters),
        )
        for (sensor, instance), mean in sorted(means.items())
    )


def _of(means: Mapping[tuple[Sensor, int], Mean], sensor: Sensor) -> dict[int, Mean]:
    return {instance: mean for (of, instance), mean in means.items() if of == sensor}


def _raw(snapshot: Snapshot, sensor: Sensor, instance: int, mean: Mean, at: float | None) -> Triple | None:
    calibrated_meanwhile = any(sensor_of(name) == sensor for name in snapshot.rewritten)
    if sensor != Sensor.GYRO or calibrated_meanwhile:
        return None
    try:
        model = calibration_in_force(snapshot.identity.autopilot, snapshot.parameters, sensor, instance)
        return _triple(model.invert(mean.value, at))
    except CalibError:
        return None


def _temperature(recording: Recording, instance: int) -> float | None:
    found = recording.find(Sensor.TEMPERATURE, instance)
    return float(np.median(found[0].values[:, 0])) if found and len(found[0]) else None


def _triple(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Triple:
    x, y, z = (float(v) for v in values)
    return x, y, z
