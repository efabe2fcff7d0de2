"""Channels of a flight, checked and turned into body axes for the compass fit."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.mag.flight_fit import Samples
from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.mag.motor_drives import Drive
from mavcal.calib.mag.result import MagContext
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.triad import TriadModel

MOVEMENT = "fly whole circles on the spot, and bank and pitch by 20 degrees and more in different headings"
LEAST_SAMPLES = 50
LEAST_TIME = 10.0
"""s"""
_MOST_SAMPLES = 12_000
_LARGEST = 1e9  # of any unit
_FASTEST = 35.0  # rad/s, of a vehicle: half of the time faster is another unit
_LEAST_TURN = 5.0  # degrees
_TIPPED = math.radians(75.0)
_SHOCK = 60.0  # m/s2
_BEFORE_SHOCK = 2.0  # s


@dataclass(frozen=True, eq=False)
class FlightInput:
    """Checked input: samples in body axes, motion, and the correction in force."""

    samples: Samples
    turning: Turning
    sensor_from_body: Array
    offset_in_force: Array
    """(3,), body axes."""
    mag: Channel
    yaw_range_deg: float
    tilt_range_deg: float


def prepared(
    mag: Channel,
    turning: Turning,
    in_force: TriadModel | None,
    drive: Drive | None,
    window: float,
    context: MagContext,
) -> FlightInput:
    """Channels with finite samples, in order, within the time of the motion; the compass in body axes.

    Raises
    ------
    InvalidInputError
        Wrong units or shapes, or time that goes back.
    """
    for channel, columns in ((mag, 3), (turning.gyro, 3), (turning.attitude, 4)):
        _check(channel, columns)
    gyro = _increasing(turning.gyro)
    attitude = _increasing(turning.attitude)
    if attitude is not None:
        lengths = np.linalg.norm(attitude.values, axis=1)
        attitude = attitude.take(np.flatnonzero(np.abs(lengths - 1.0) < 0.01))
    turning = Turning(gyro if gyro is not None and len(gyro) > 1 else None, _or_none(attitude))
    mag = mag.take(_measured(mag.values))
    if turning.gyro is not None or turning.attitude is not None:
        start, end = turning.span()
        mag = mag.take((mag.t >= start) & (mag.t <= end))
    mag = mag.take(slice(None, None, max(1, len(mag) // _MOST_SAMPLES)))
    body_from_sensor = np.eye(3) if context.body_from_sensor is None else context.body_from_sensor
    correction = TriadModel(np.zeros(3), body_from_sensor) if in_force is None else in_force
    sensitivity = np.linalg.inv(correction.matrix @ body_from_sensor.T)
    drives = np.zeros((len(mag), 0)) if drive is None else drive.columns(mag.t)
    known = np.asarray(np.isfinite(drives).all(axis=1), dtype=np.bool_)
    mag, drives = mag.take(known), drives[known]
    samples = Samples(
        mag.t,
        mag.values @ body_from_sensor.T,
        drives,
        0.5 * (sensitivity + sensitivity.T),
        mag.quantum,
        window,
    )
    yaw, tilt = _ranges(turning)
    return FlightInput(samples, turning, body_from_sensor.T, body_from_sensor @ correction.offset, mag, yaw, tilt)


def unusable(data: FlightInput) -> str:
    """Reason to refuse the fit; empty: there is none."""
    mag, turning = data.mag, data.turning
    if turning.gyro is None and turning.attitude is None:
        return "nothing says how the vehicle turned: the recording has neither a gyroscope nor an attitude"
    if len(mag) < LEAST_SAMPLES or mag.t[-1] - mag.t[0] < LEAST_TIME:
        lasts = mag.t[-1] - mag.t[0] if len(mag) else 0.0
        return (
            f"{len(mag)} samples of the compass over {lasts:.1f} s beside the motion: at least {LEAST_SAMPLES} over "
            f"{LEAST_TIME:.0f} s of flight are needed"
        )
    if not np.ptp(mag.values, axis=0).all():
        return "the compass reads one constant value on an axis: it is stuck, or the vehicle never moved"
    if turning.gyro is not None:
        fastest = float(np.median(np.linalg.norm(turning.gyro.values, axis=1)))
        if fastest > _FASTEST:
            return f"the gyroscope reads {fastest:.3g} rad/s half of the time: its unit is another (deg/s, counts)"
    if max(data.yaw_range_deg, data.tilt_range_deg) < _LEAST_TURN:
        return f"the vehicle never turned by more than {_LEAST_TURN:.0f} degrees: {MOVEMENT}"
    return ""


def end_of_flight(recording_end: float, accel: Channel | None, attitude: Channel | None) -> float:
    """Time (s) at which a crash ends the flight for the compass; without one, the end of the recording.

    Two seconds before the first shock above 60 m/s2 with a tilt above 75 degrees within two seconds.
    """
    if accel is None or attitude is None or not len(accel) or not len(attitude):
        return recording_end
    down = np.clip(1.0 - 2.0 * (attitude.values[:, 1:3] ** 2).sum(axis=1), -1.0, 1.0)
    tipped = attitude.t[np.arccos(down) > _TIPPED]
    shocked = accel.t[np.linalg.norm(accel.values, axis=1) > _SHOCK]
    for t in shocked:
        if len(tipped) and np.abs(tipped - t).min() < _BEFORE_SHOCK:
            return float(min(t, tipped[np.abs(tipped - t) < _BEFORE_SHOCK][0])) - _BEFORE_SHOCK
    return recording_end


def _check(channel: Channel | None, columns: int) -> None:
    if channel is None:
        return
    if channel.values.shape[1:] != (columns,):
        raise InvalidInputError(f"the {channel.sensor} needs {columns} columns, not {channel.values.shape[1]}")
    if channel.sensor == Sensor.GYRO and channel.unit != "rad/s":
        raise InvalidInputError(f"the gyroscope must be in rad/s, not in {channel.unit}: state --unit-gyro")
    if not np.isfinite(channel.t).all() or (np.diff(channel.t) < 0.0).any():
        raise InvalidInputError(f"the time of the {channel.sensor} goes back or is not finite: sort the samples")


def _increasing(channel: Channel | None) -> Channel | None:
    if channel is None:
        return None
    channel = channel.take(_measured(channel.values))
    return channel.take(np.diff(channel.t, prepend=-np.inf) > 0.0)


def _measured(values: Array) -> NDArray[np.bool_]:
    """Mask (N,) of finite and plausible rows."""
    return np.asarray(np.isfinite(values).all(axis=1) & (np.abs(values) < _LARGEST).all(axis=1), dtype=np.bool_)


def _or_none(channel: Channel | None) -> Channel | None:
    return channel if channel is not None and len(channel) > 1 else None


def _ranges(turning: Turning) -> tuple[float, float]:
    """Range of turn about the vertical and about the horizontal, degrees; without an attitude from the gyroscope."""
    if turning.attitude is not None:
        track = Rotation.from_quat(turning.attitude.values, scalar_first=True)
        yaw, pitch, roll = np.unwrap(track.as_euler("ZYX"), axis=0).T
        return math.degrees(float(np.ptp(yaw))), math.degrees(float(max(np.ptp(pitch), np.ptp(roll))))
    if turning.gyro is None:
        return 0.0, 0.0
    gyro = turning.gyro
    steady = gyro.values - np.median(gyro.values, axis=0)
    turned = np.cumsum(steady[1:] * np.diff(gyro.t)[:, None], axis=0)
    swept = np.degrees(np.ptp(turned, axis=0)) if len(turned) else np.zeros(3)
    return float(swept[2]), float(max(swept[0], swept[1]))


def between(channel: Channel | None, end: float) -> Channel | None:
    """The samples before `end`."""
    return None if channel is None else dataclasses.replace(channel.between(-np.inf, end))
