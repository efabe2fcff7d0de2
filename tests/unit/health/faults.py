"""Faults of one sensor, put into a recording that is healthy."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.firmware.names import Role, ardupilot_imu_names, px4_names, px4_thermal_names
from mavcal.calib.recording import Channel, Event, Oddity, OddSamples, ParameterTimeline, Recording, Sensor

Array = NDArray[np.float64]


Values = Callable[[Channel, Recording], Array]


@dataclass(frozen=True)
class HealthFault:
    """One way in which a sensor is wrong; `needs` is what a log must have to show it.

    `change` makes the values of the unit's channels; where it is None `whole` makes another recording.
    """

    name: str
    sensor: Sensor
    change: Values | None = None
    needs: tuple[Sensor, ...] = (Sensor.ATTITUDE,)
    whole: Callable[[Recording, int], Recording] | None = None
    shared: tuple[Sensor, ...] = ()
    """Other kinds of sensors that have the fault as well."""


def injected(recording: Recording, fault: HealthFault, instance: int) -> Recording:
    """`recording` with `fault` in that unit."""
    if fault.change is not None:
        return _changed(recording, fault.sensor, instance, fault.change)
    assert fault.whole is not None
    return fault.whole(recording, instance)


def _changed(recording: Recording, sensor: Sensor, instance: int, change: Values) -> Recording:
    def changed(channel: Channel) -> Channel:
        if (channel.sensor, channel.instance) != (sensor, instance) or not len(channel):
            return channel
        return dataclasses.replace(channel, values=change(channel, recording), quantum=0.0, zero_bin=None)

    return recording.with_channels(changed(c) for c in recording.channels)


def _plus(*offset: float) -> Callable[[Channel, Recording], Array]:
    added = np.array(offset, dtype=np.float64)
    return lambda channel, _: channel.values + added


def _times(factor: float) -> Values:
    return lambda channel, _: np.asarray(factor * channel.values)


def _drifting(channel: Channel, _: Recording) -> Array:
    share = (channel.t - channel.t[0]) / max(float(np.ptp(channel.t)), 1e-9)
    return channel.values + np.radians(8.0) * share[:, None] * np.array([0.0, 1.0, 0.0])


def _held(channel: Channel, _: Recording) -> Array:
    values = channel.values.copy()
    first, last = np.searchsorted(channel.t, channel.t[0] + np.array([0.4, 0.6]) * np.ptp(channel.t))
    values[first:last] = values[first]
    return values


def _motors(channel: Channel, recording: Recording) -> Array:
    drive = recording.find(Sensor.THROTTLE)[0]
    x = np.interp(channel.t, drive.t, np.nan_to_num(drive.values[:, 0]))
    strength = float(np.median(np.linalg.norm(channel.values, axis=1)))
    return channel.values + np.outer(
        x / max(float(np.percentile(x, 95)), 1e-9), 0.3 * strength * np.array([0.3, 0.2, 0.9])
    )


def _turned(channel: Channel, _: Recording) -> Array:
    return np.asarray(Rotation.from_euler("x", 90.0, degrees=True).apply(channel.values))


def _shaken(recording: Recording, instance: int) -> Recording:
    """Vibration of 80 m/s2 in the samples and in the level that the autopilot measured, where there is one."""
    rng = np.random.default_rng(0)
    loud = _changed(recording, Sensor.ACCEL, instance, lambda c, _: c.values + 80.0 * rng.normal(size=c.values.shape))
    return _changed(loud, Sensor.VIBRATION, instance, lambda c, _: c.values + 80.0)


def _clipped(recording: Recording, instance: int) -> Recording:
    """150 samples at the end of the range, spread over the log, as the autopilot counts them."""
    start, end = recording.span
    odd = OddSamples(Oddity.CLIPPED, Sensor.ACCEL, instance, 150, until=end - 0.2 * (end - start))
    said = Event(start + 0.2 * (end - start), "clipping", "clipped 150 times", odd)
    return dataclasses.replace(recording, events=(*recording.events, said))


def _too_warm(recording: Recording, instance: int) -> Recording:
    """A temperature calibration in force that ends 10 degC below the coldest reading."""
    low = min(float(np.nanmin(c.values)) for c in recording.find(Sensor.TEMPERATURE, instance))
    held = dict(recording.parameters.final())
    if recording.identity.autopilot == "px4":
        ids = {Role.ID: 1 + instance, Role.PRIORITY: 50}
        rows = {px4_names(Sensor.ACCEL, instance)[role]: value for role, value in ids.items()}
        held |= {name: value for name, value in rows.items() if not held.get(name)}
        device = held[px4_names(Sensor.ACCEL, instance)[Role.ID]]
        names, own = px4_thermal_names(Sensor.ACCEL, instance), {Role.THERMAL_ID: device}
    else:
        names, own = ardupilot_imu_names(Sensor.ACCEL, instance), {}
    own |= {Role.THERMAL_ENABLE: 1, Role.THERMAL_MIN: low - 40.0, Role.THERMAL_MAX: low - 10.0}
    held |= {names[role]: value for role, value in own.items()}
    return dataclasses.replace(recording, parameters=ParameterTimeline.constant(held))


def _silent(sensor: Sensor) -> Callable[[Recording, int], Recording]:
    """That unit stops for a sixth of the log."""

    def made(recording: Recording, instance: int) -> Recording:
        start, end = recording.span
        first, last = start + (end - start) / 2.0, start + (end - start) * 2.0 / 3.0

        def cut(channel: Channel) -> Channel:
            if (channel.sensor, channel.instance) != (sensor, instance):
                return channel
            return channel.take((channel.t < first) | (channel.t > last))

        return recording.with_channels(cut(c) for c in recording.channels)

    return made


FAULTS = (
    HealthFault("accelerometer 0.8 m/s2 off along z", Sensor.ACCEL, _plus(0.0, 0.0, 0.8)),
    HealthFault("accelerometer reads 10 % too much", Sensor.ACCEL, _times(1.1)),
    HealthFault("accelerometer holds one value for a fifth of the log", Sensor.ACCEL, _held, ()),
    HealthFault("gyroscope 3 deg/s off", Sensor.GYRO, _plus(0.0, float(np.radians(3.0)), 0.0)),
    HealthFault("gyroscope 20 deg/s off", Sensor.GYRO, _plus(float(np.radians(20.0)), 0.0, 0.0)),
    HealthFault("gyroscope drifts by 8 deg/s over the log", Sensor.GYRO, _drifting),
    HealthFault("compass reads one value throughout", Sensor.MAG, lambda c, _: np.tile(c.values[0], (len(c), 1)), ()),
    HealthFault("compass 20 uT off", Sensor.MAG, _plus(14.0, 14.0, 0.0), (Sensor.POSITION,)),
    HealthFault("compass reads 25 % of the field too little", Sensor.MAG, _times(0.75), (Sensor.POSITION,)),
    HealthFault(
        "motors move the compass by 30 % of the field", Sensor.MAG, _motors, (Sensor.THROTTLE, Sensor.ATTITUDE)
    ),
    HealthFault("compass turned by 90 deg about x", Sensor.MAG, _turned, (Sensor.ATTITUDE, Sensor.POSITION)),
    HealthFault("vibration of 80 m/s2", Sensor.ACCEL, None, (), _shaken),
    HealthFault("accelerometer clips 150 times over the flight", Sensor.ACCEL, None, (), _clipped),
    HealthFault(
        "10 degC beyond its temperature calibration",
        Sensor.ACCEL,
        None,
        (Sensor.TEMPERATURE,),
        _too_warm,
        (Sensor.GYRO,),
    ),
    HealthFault("accelerometer silent for a sixth of the log", Sensor.ACCEL, None, (), _silent(Sensor.ACCEL)),
    HealthFault("gyroscope silent for a sixth of the log", Sensor.GYRO, None, (), _silent(Sensor.GYRO)),
    HealthFault("compass silent for a sixth of the log", Sensor.MAG, None, (), _silent(Sensor.MAG)),
)
"""Every kind; sizes are what a pilot would call broken, or twice the limit."""
