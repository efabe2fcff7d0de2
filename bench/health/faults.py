"""Faults of one sensor, put into a recording that is healthy."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.recording import Channel, Recording, Sensor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HealthFault:
    """One way in which a sensor is wrong; `needs` is what a log must have to show it."""

    name: str
    sensor: Sensor
    change: Callable[[Channel, Recording], Array]
    needs: tuple[Sensor, ...] = (Sensor.ATTITUDE,)


def injected(recording: Recording, fault: HealthFault, instance: int) -> Recording:
    """`recording` with `fault` in that unit's channels."""

    def changed(channel: Channel) -> Channel:
        if (channel.sensor, channel.instance) != (fault.sensor, instance) or not len(channel):
            return channel
        return dataclasses.replace(channel, values=fault.change(channel, recording), quantum=0.0, zero_bin=None)

    return recording.with_channels(changed(c) for c in recording.channels)


def _plus(*offset: float) -> Callable[[Channel, Recording], Array]:
    return lambda channel, _: channel.values + np.array(offset)


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


FAULTS = (
    HealthFault("accelerometer 0.8 m/s2 off along z", Sensor.ACCEL, _plus(0.0, 0.0, 0.8)),
    HealthFault("accelerometer reads 10 % too much", Sensor.ACCEL, lambda c, _: 1.1 * c.values),
    HealthFault("accelerometer holds one value for a fifth of the log", Sensor.ACCEL, _held, ()),
    HealthFault("gyroscope 3 deg/s off", Sensor.GYRO, _plus(0.0, float(np.radians(3.0)), 0.0)),
    HealthFault("gyroscope 20 deg/s off", Sensor.GYRO, _plus(float(np.radians(20.0)), 0.0, 0.0)),
    HealthFault("gyroscope drifts by 8 deg/s over the log", Sensor.GYRO, _drifting),
    HealthFault("compass reads one value throughout", Sensor.MAG, lambda c, _: np.tile(c.values[0], (len(c), 1)), ()),
    HealthFault("compass 20 uT off", Sensor.MAG, _plus(14.0, 14.0, 0.0), (Sensor.POSITION,)),
    HealthFault(
        "compass reads 25 % of the field too little", Sensor.MAG, lambda c, _: 0.75 * c.values, (Sensor.POSITION,)
    ),
    HealthFault(
        "motors move the compass by 30 % of the field", Sensor.MAG, _motors, (Sensor.THROTTLE, Sensor.ATTITUDE)
    ),
    HealthFault("compass turned by 90 deg about x", Sensor.MAG, _turned, (Sensor.ATTITUDE, Sensor.POSITION)),
)
"""Every kind; sizes are what a pilot would call broken, or twice the limit."""
