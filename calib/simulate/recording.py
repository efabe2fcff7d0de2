"""From a trajectory and sensor errors to a recording whose truth is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Channel, Recording, Rounding, Sensor, Stage
from mavcal.calib.simulate.motion import Trajectory
from mavcal.calib.simulate.sensor import SensorErrors

Frame = Literal["ned", "enu"]

FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])
_UNITS = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT"}
_THERMOMETER_RATE = 5.0  # Hz at most
_MAVLINK = {Sensor.ACCEL: 1e-3 * STANDARD_GRAVITY, Sensor.GYRO: 1e-3, Sensor.MAG: 0.1}  # SCALED_IMU: mG, mrad/s, mgauss


@dataclass(frozen=True, eq=False)
class SensorSuite:
    """Errors of the three sensors, in body axes forward-right-down."""

    accel: SensorErrors = field(default_factory=SensorErrors)
    gyro: SensorErrors = field(default_factory=SensorErrors)
    mag: SensorErrors = field(default_factory=SensorErrors)

    @property
    def by_sensor(self) -> Mapping[Sensor, SensorErrors]:
        """The errors by sensor."""
        return {Sensor.ACCEL: self.accel, Sensor.GYRO: self.gyro, Sensor.MAG: self.mag}

    def streamed(self) -> SensorSuite:
        """The same sensors, truncated toward zero to what MAVLink's ``SCALED_IMU`` carries."""
        coarse = {
            s.value: dataclasses.replace(e, resolution=_MAVLINK[s], rounding=Rounding.TOWARD_ZERO)
            for s, e in self.by_sensor.items()
        }
        return SensorSuite(**coarse)


@dataclass(frozen=True, eq=False)
class Simulated:
    """A recording, and what made it."""

    recording: Recording
    trajectory: Trajectory
    suite: SensorSuite


def simulate(
    path: Trajectory, suite: SensorSuite, rng: np.random.Generator, *, mag_rate: float | None = None
) -> Simulated:
    """What the sensors of `suite` record along `path`.

    Parameters
    ----------
    path, suite
        The motion of the sensors, and their errors.
    rng
        Random generator of the noise, drawn for accelerometer, gyroscope, magnetometer in this order.
    mag_rate
        Samples a second of the magnetometer, at most the trajectory's; None: the trajectory's.

    Raises
    ------
    InvalidInputError
        If the trajectory has no samples for `mag_rate`.
    """
    rate = path.samples_per_second
    every = _stride(rate, mag_rate)
    rows = np.arange(0, len(path.t), every)
    accel = _channel(Sensor.ACCEL, path, slice(None), path.force, suite.accel, rng)
    gyro = _channel(Sensor.GYRO, path, slice(None), path.rate, suite.gyro, rng)
    mag = _channel(Sensor.MAG, path, rows, path.field, suite.mag, rng)
    slow = np.arange(0, len(path.t), max(1, round(rate / _THERMOMETER_RATE)))
    temperature = _slow(Sensor.TEMPERATURE, path.t[slow], path.temperature[slow], "degC")
    attitude = _slow(Sensor.ATTITUDE, path.t, _wxyz(path), "1")
    recording = Recording(
        channels=(accel, gyro, mag, temperature, attitude),
        segments=tuple(facts.segment for facts in path.facts),
        source="simulated",
    )
    return Simulated(recording, path, suite)


def _stride(rate: float, mag_rate: float | None) -> int:
    if mag_rate is None:
        return 1
    if not (np.isfinite(mag_rate) and 0.0 < mag_rate <= rate * (1.0 + 1e-9)):
        raise InvalidInputError(f"the magnetometer's rate lies above 0 and at most at {rate:g} Hz, not at {mag_rate}")
    return round(rate / mag_rate)


def _channel(
    sensor: Sensor,
    path: Trajectory,
    rows: slice | NDArray[np.intp],
    truth: Array,
    errors: SensorErrors,
    rng: np.random.Generator,
) -> Channel:
    t = path.t[rows]
    die = path.temperature + errors.thermal_lag * np.gradient(path.temperature, path.t)
    force = path.force[rows] if errors.g_sensitivity.any() else None
    reading = errors.read(truth[rows], 1.0 / float(np.median(np.diff(t))), rng, temperature=die[rows], force=force)
    discrete = errors.resolution > 0.0 and errors.rounding != Rounding.NONE
    return Channel(
        sensor=sensor,
        instance=0,
        t=t,
        values=reading.values,
        unit=_UNITS[sensor],
        stage=Stage.RAW,
        source="simulated",
        quantum=errors.resolution if discrete else 0.0,
        rounding=errors.rounding if discrete else Rounding.NONE,
        zero_bin=reading.zero_bin,
    )


def _slow(sensor: Sensor, t: Array, values: Array, unit: str) -> Channel:
    return Channel(sensor, 0, t, values, unit, Stage.RAW, "simulated")


def _wxyz(path: Trajectory) -> Array:
    q = path.attitude.as_quat(scalar_first=True)
    return np.asarray(q * np.where(q[:, :1] < 0.0, -1.0, 1.0), dtype=np.float64)


def in_frame(recording: Recording, frame: Frame) -> Recording:
    """`recording` (contract axes) with vectors forward-left-up and attitudes to east-north-up, if `frame` is ``enu``.

    For tables that are read with ``--world enu --body flu``. A truncated channel stays valid: its zero is in the
    middle.
    """
    if frame == "ned":
        return recording
    return recording.with_channels(_turned(channel) for channel in recording.channels)


def _turned(channel: Channel) -> Channel:
    if channel.sensor in _UNITS:
        return dataclasses.replace(channel, values=channel.values @ FLU_FROM_FRD)
    if channel.sensor == Sensor.ATTITUDE:
        return dataclasses.replace(channel, values=_enu_from_flu(channel.values))
    return channel


def _enu_from_flu(q: Array) -> Array:
    """Quaternions (N, 4) body FLU to ENU from those of FRD to NED: ``r q f`` with half turns r and f.

    r takes north-east-down to east-north-up (about (1, 1, 0)), f forward-left-up to forward-right-down (about x).
    """
    w, x, y, z = q.T
    a, b, c, d = -x, w, z, -y  # q f with f = (0, 1, 0, 0); the sign of the whole is free
    h = np.sqrt(0.5)  # r = (0, h, h, 0)
    return np.column_stack([h * (b + c), -h * (a + d), h * (d - a), h * (b - c)])


def suite_in_frame(suite: SensorSuite, frame: Frame) -> SensorSuite:
    """Errors given in the body axes of `frame` as those of the contract, or back: the turn is its own inverse."""
    if frame == "ned":
        return suite
    return SensorSuite(**{s.value: errors_turned(e) for s, e in suite.by_sensor.items()})


def errors_turned(errors: SensorErrors) -> SensorErrors:
    """Errors in forward-left-up axes from those in forward-right-down ones, or back."""
    D = FLU_FROM_FRD
    return dataclasses.replace(
        errors,
        bias=D @ errors.bias,
        matrix=D @ errors.matrix @ D,
        temperature=D @ errors.temperature,
        g_sensitivity=D @ errors.g_sensitivity @ D,
    )
