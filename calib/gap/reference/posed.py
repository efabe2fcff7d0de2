"""An ideal sensor driven by a reference pose: attitude, and place or velocity where they were recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib import STANDARD_GRAVITY
from calib.gap.problem import ReferenceInfo, ReferenceKind
from calib.gap.reference.ideal import Ideal
from calib.gap.reference.recorded import continuous, true_attitude, true_place
from calib.gap.reference.signal import Signal, linear
from calib.gap.reference.smooth import Smoothed, bandwidth, smoothed
from calib.recording import Channel, Recording, Sensor, Stage

Array = NDArray[np.float64]

GRAVITY_NED = np.array([0.0, 0.0, STANDARD_GRAVITY])


@dataclass(frozen=True, eq=False)
class Pose:
    """Attitude (N, 4) body to north-east-down on `t`, angular rate (N, 3) in the body, acceleration (N, 3) in NED."""

    t: Array
    attitude: Array
    rate: Array
    acceleration: Array | None
    place: Signal | None
    cutoff_hz: float | None
    att_sigma_deg: float

    def body_from_ned(self, t: Array) -> Rotation:
        """At the times `t`."""
        return rotation(Signal(self.t, self.attitude).at(t)).inv()


def rotation(q: Array) -> Rotation:
    """Of quaternions w x y z, of any length."""
    return Rotation.from_quat(q[:, [1, 2, 3, 0]])


def pose_of(recording: Recording) -> Pose | None:
    """The reference pose of `recording`: ``ref_q_*``, or a table's own; None without an attitude."""
    attitude = true_attitude(recording)
    if attitude is None:
        return None
    smooth, q, rate = _turned(attitude, None)
    gyro = _judge(recording, Sensor.GYRO, smooth.t)
    if gyro is not None and (cutoff := bandwidth(smooth.t, rate, gyro)) is not None:
        smooth, q, rate = _turned(attitude, cutoff)
    return Pose(
        t=smooth.t,
        attitude=q,
        rate=rate,
        acceleration=_acceleration(recording, smooth.t, q),
        place=true_place(recording),
        cutoff_hz=smooth.cutoff_hz,
        att_sigma_deg=float(np.degrees(2.0 * np.sqrt((smooth.noise**2).sum()))),
    )


def _turned(attitude: Signal, cutoff: float | None) -> tuple[Smoothed, Array, Array]:
    """Attitudes below `cutoff`, as unit quaternions, and the rates in the body."""
    smooth = smoothed(attitude, cutoff)
    q = smooth.values / np.linalg.norm(smooth.values, axis=1, keepdims=True)
    return smooth, q, body_rate(q, smooth.first)


def _judge(recording: Recording, sensor: Sensor, t: Array) -> Array | None:
    """Readings of the first instance at `t`, by which the bandwidth of a pose is judged; None without one."""
    channel = next((c for c in recording.channels if c.sensor == sensor and c.stage != Stage.DEBIASED), None)
    signal = None if channel is None else Signal.of(channel)
    return None if signal is None else linear(signal.t, signal.values, t)


def body_rate(q: Array, change: Array) -> Array:
    """Angular rate in the body from unit quaternions (N, 4) and their derivatives: ``omega = 2 vec(q* dq/dt)``."""
    w, v, dw, dv = q[:, :1], q[:, 1:], change[:, :1], change[:, 1:]
    return np.asarray(2.0 * (w * dv - v * dw - np.cross(v, dv)))


def _acceleration(recording: Recording, t: Array, q: Array) -> Array | None:
    """In NED at `t`, from velocity or place, as far up in frequency as the accelerometer knows of it; None without."""
    found: dict[Sensor, Channel] = {c.sensor: c for c in recording.reference if len(c) >= 16}
    turn = rotation(q)
    force = _judge(recording, Sensor.ACCEL, t)
    for sensor in (Sensor.VELOCITY, Sensor.PLACE):
        signal = None if sensor not in found else Signal.of(found[sensor])
        if signal is not None:
            cutoff = None
            if force is not None:
                plain = smoothed(signal)
                moved = linear(plain.t, _derivative(plain, sensor), t)
                cutoff = bandwidth(t, moved, turn.apply(force) + GRAVITY_NED)
            smooth = smoothed(signal, cutoff)
            return linear(smooth.t, _derivative(smooth, sensor), t)
    return None


def _derivative(smooth: Smoothed, sensor: Sensor) -> Array:
    return smooth.first if sensor == Sensor.VELOCITY else smooth.second


def driven(pose: Pose, earth: Array | None) -> Ideal:
    """Ideal sensors along `pose`; the magnetometer in the field `earth` (3,), uT, north-east-down, None: unknown.

    Without a place or a velocity the vehicle is taken not to accelerate, and the text says so.
    """
    turn = rotation(pose.attitude).inv()
    acceleration = np.zeros((len(pose.t), 3)) if pose.acceleration is None else pose.acceleration
    readings = {
        Sensor.ACCEL: Signal(pose.t, turn.apply(acceleration - GRAVITY_NED)),
        Sensor.GYRO: Signal(pose.t, pose.rate),
    }
    if earth is not None:
        readings[Sensor.MAG] = Signal(pose.t, turn.apply(np.tile(earth, (len(pose.t), 1))))
    band = "" if pose.cutoff_hz is None else f", below {pose.cutoff_hz:.3g} Hz, where its own noise begins"
    still = "" if pose.acceleration is not None else "; no place or velocity was recorded: acceleration is not in it"
    return Ideal(
        ReferenceInfo(ReferenceKind.POSE, pose.att_sigma_deg, text=f"An ideal sensor driven by a pose{band}{still}."),
        readings,
        Signal(pose.t, continuous(pose.attitude)),
        pose.place,
    )


def earth_field_of(channels: list[Channel], pose: Pose) -> Array | None:
    """The field in NED that magnetometers saw along `pose`, beside an offset of each; None if nothing determines it.

    ``m = R_bn B + h``, linear in B and every h; residuals beyond three times their median lose weight, so that what
    comes and goes does not pull. Where too few attitudes were visited to tell B from h, h is taken as zero.
    """
    rows, values, owner = [], [], []
    for i, channel in enumerate(channels):
        inside = np.isfinite(channel.values).all(axis=1) & (channel.t >= pose.t[0]) & (channel.t <= pose.t[-1])
        pick = np.flatnonzero(inside)[:: max(1, int(inside.sum()) // 4000)]
        if len(pick) < 8:
            continue
        rows.append(pose.body_from_ned(channel.t[pick]).as_matrix())
        values.append(channel.values[pick])
        owner.append(np.full(len(pick), i))
    if not rows:
        return None
    turns, m, which = np.vstack(rows), np.vstack(values), np.concatenate(owner)
    offsets = np.zeros((len(m), 3, 3 * len(channels)))
    for i in range(len(channels)):
        offsets[which == i, :, 3 * i : 3 * i + 3] = np.eye(3)
    told_apart = np.linalg.svd(turns.mean(axis=0), compute_uv=False)[0] < _SPREAD
    design = np.concatenate([turns, offsets], axis=2) if told_apart else turns
    return _robust(design, m)[:3]


_SPREAD = 0.98
"""Largest singular value of the mean attitude: 1 if it never changes, 0 if all are visited."""


def _robust(design: Array, m: Array) -> Array:
    weight = np.ones(len(m))
    solution: Array = np.zeros(design.shape[2])
    for _ in range(12):
        scaled = design * np.sqrt(weight)[:, None, None]
        flat, right = scaled.reshape(-1, design.shape[2]), (m * np.sqrt(weight)[:, None]).ravel()
        solution = np.asarray(np.linalg.lstsq(flat, right, rcond=None)[0], dtype=np.float64)
        size = np.linalg.norm(m - design @ solution, axis=1)
        weight = np.minimum(1.0, 3.0 * np.median(size) / np.maximum(size, 1e-12))
    return solution
