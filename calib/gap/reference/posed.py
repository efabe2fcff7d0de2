"""An ideal sensor driven by a reference pose: attitude, and place or velocity where they were recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial.transform import Rotation

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.problem import ReferenceInfo, ReferenceKind
from mavcal.calib.gap.reference.align import (
    AXIS_EXCHANGES,
    UNCORRELATED,
    correlation,
    correlation_in_best_frame,
    matched_to,
)
from mavcal.calib.gap.reference.ideal import TABLE, Ideal, continuous, true_attitude, true_place
from mavcal.calib.gap.reference.signals import LowPassedSignal, Signal, bandwidth, interpolated, low_passed
from mavcal.calib.recording import Channel, Recording, Sensor, Stage

Array = NDArray[np.float64]

GRAVITY_NED = np.array([0.0, 0.0, STANDARD_GRAVITY])
"""Gravity in north-east-down, m/s2. Source: standard gravity, which both firmwares use (FLIGHT_CONTROLLERS)."""

_LEAST = 16
"""Least number of samples of a pose. Chosen, not measured: a cubic spline needs four."""


@dataclass(frozen=True)
class Cutoffs:
    """Cut-off frequencies, Hz, for rotation and translation of a pose; None: no cut-off."""

    rotation: float | None = None
    translation: float | None = None

    def lower(self, other: Cutoffs) -> Cutoffs:
        """The lower of each, so that two recordings are compared in one band."""
        return Cutoffs(_lower(self.rotation, other.rotation), _lower(self.translation, other.translation))


def _lower(one: float | None, other: float | None) -> float | None:
    return min((c for c in (one, other) if c is not None), default=None)


@dataclass(frozen=True, eq=False)
class PoseTrajectory:
    """Attitude (N, 4) body to north-east-down on `t`, angular rate (N, 3) in the body, acceleration (N, 3) in NED."""

    t: Array
    attitude: Array
    rate: Array
    acceleration: Array | None
    place: Signal | None
    cutoffs: Cutoffs
    att_sigma_deg: float
    known: NDArray[np.bool_]
    """Mask (N,) of `t` where the pose was recorded; elsewhere it was interpolated across a hole."""

    def body_from_ned(self, t: Array) -> Rotation:
        """Rotation from north-east-down to body axes at the times `t`."""
        return rotation(Signal(self.t, self.attitude).at(t)).inv()


def rotation(q: Array) -> Rotation:
    """Rotation of quaternions w x y z, of any length."""
    return Rotation.from_quat(q[:, [1, 2, 3, 0]])


def pose_of(recording: Recording, highest: Cutoffs | None = None) -> PoseTrajectory | None:
    """The reference pose of `recording`: ``ref_q_*``, or a table's own; None without an attitude, or one of holes only.

    `highest`: upper limits of the cut-offs; None: none.
    """
    highest = highest or Cutoffs()
    attitude = true_attitude(recording)
    if attitude is None:
        return None
    smooth, q, rate = _attitude_and_rate(attitude, None)
    gyro = _readings_at(recording, Sensor.GYRO, smooth.t)
    if gyro is not None:
        _check_convention(smooth, gyro, _readings_at(recording, Sensor.ACCEL, smooth.t))
        if (cutoff := _lower(bandwidth(smooth.t, rate, matched_to(gyro, rate)), highest.rotation)) is not None:
            smooth, q, rate = _attitude_and_rate(attitude, cutoff)
    known = _known(attitude, smooth)
    if known.sum() < _LEAST:
        return None
    acceleration, cutoff_hz = _acceleration(recording, smooth.t, q, highest.translation)
    return PoseTrajectory(
        t=smooth.t,
        attitude=q,
        rate=rate,
        acceleration=acceleration,
        place=true_place(recording),
        cutoffs=Cutoffs(smooth.cutoff_hz, cutoff_hz),
        att_sigma_deg=float(np.degrees(2.0 * np.sqrt((smooth.noise**2).sum()))),
        known=known,
    )


def _known(attitude: Signal, smooth: LowPassedSignal) -> NDArray[np.bool_]:
    """Mask of times with an attitude recorded nearby, not interpolated across a hole."""
    known = attitude.known(smooth.t)
    if smooth.cutoff_hz is None or known.all():
        return known
    count = int(1.0 / smooth.cutoff_hz / float(smooth.t[1] - smooth.t[0]))
    return np.asarray(binary_erosion(known, np.ones(2 * count + 1), border_value=1))


def _check_convention(smooth: LowPassedSignal, gyro: Array, force: Array | None) -> None:
    """Check that the rotation of the quaternion agrees with the gyroscope.

    Some wrong conventions agree with a gyroscope in another frame; then gravity decides.

    Raises
    ------
    InvalidInputError
        If only its inverse, or its numbers in another order, agree with the gyroscope. If nothing does.
    """
    if np.linalg.eigvalsh(np.cov(gyro.T))[1] < _TURNING**2:
        return  # a turn about one axis is a turn the other way with a sign
    reading = low_passed(Signal(smooth.t, gyro), _CONVENTION_HZ).values

    def turns(q: Array) -> Array:
        turned = low_passed(Signal(smooth.t, continuous(q)), _CONVENTION_HZ)
        return body_rate(turned.values / np.linalg.norm(turned.values, axis=1, keepdims=True), turned.first)

    def hangs(q: Array) -> float:
        return 0.0 if force is None else correlation(force, rotation(q).inv().apply(-GRAVITY_NED))

    if correlation(reading, turns(smooth.values)) > _SAME:
        return
    made = {what: change(smooth.values) for what, change in _CONVENTIONS.items()}
    others = {what: correlation(reading, turns(q)) for what, q in made.items()}
    what = max(others, key=lambda name: others[name])
    given = correlation_in_best_frame(reading, turns(smooth.values))
    need = "give q_w, q_x, q_y, q_z from the body to north-east-down"
    if others[what] > _SAME and hangs(made[what]) >= hangs(smooth.values):
        raise InvalidInputError(
            f"the attitude does not turn as the gyroscope does, and would (correlation {others[what]:.2f}) if it were "
            f"{what}: {need}"
        )
    if given < UNCORRELATED:
        raise InvalidInputError(
            f"the attitude and the gyroscope have nothing in common (correlation {given:.2f}): {need}, of the same "
            "movement"
        )


_CONVENTIONS: dict[str, Callable[[Array], Array]] = {
    "inverted, from north-east-down to the body": lambda q: q * [1.0, -1.0, -1.0, -1.0],
    "written x y z w": lambda q: q[:, [3, 0, 1, 2]],
    "written z w x y": lambda q: q[:, [1, 2, 3, 0]],
}
_TURNING = 0.05
"""Least standard deviation of the rate about a second axis, rad/s, to determine the convention. Chosen, not measured: 3
deg/s are beyond the noise of any gyroscope."""
_CONVENTION_HZ = 5.0
"""Frequency, Hz, up to which turns are compared. Chosen, not measured: poses and gyroscopes both follow vehicles
there."""
_SAME = 0.9
"""Correlation above which turns are the same. Chosen, not measured: four fifths of the power are common then."""


def _attitude_and_rate(attitude: Signal, cutoff: float | None) -> tuple[LowPassedSignal, Array, Array]:
    """Attitude below `cutoff` as unit quaternions, and the rate in the body."""
    smooth = low_passed(attitude, cutoff)
    q = smooth.values / np.linalg.norm(smooth.values, axis=1, keepdims=True)
    return smooth, q, body_rate(q, smooth.first)


def _readings_at(recording: Recording, sensor: Sensor, t: Array) -> Array | None:
    """Readings of the first instance at `t`, to judge the bandwidth of a pose; None without one."""
    channel = next((c for c in recording.channels if c.sensor == sensor and c.stage != Stage.DEBIASED), None)
    signal = None if channel is None else Signal.of(channel)
    return None if signal is None else interpolated(signal.t, signal.values, t)


def body_rate(q: Array, change: Array) -> Array:
    """Angular rate in the body from unit quaternions (N, 4) and their derivatives: ``omega = 2 vec(q* dq/dt)``."""
    w, v, dw, dv = q[:, :1], q[:, 1:], change[:, :1], change[:, 1:]
    return np.asarray(2.0 * (w * dv - v * dw - np.cross(v, dv)))


def _acceleration(recording: Recording, t: Array, q: Array, highest: float | None) -> tuple[Array | None, float | None]:
    """Acceleration in NED at `t` from velocity (also a flight table's own) or place, and its cut-off; None: neither.

    The cut-off is the highest frequency at which it still agrees with the accelerometer.
    """
    found: dict[Sensor, Channel] = {c.sensor: c for c in recording.reference if len(c) >= _LEAST}
    if not {Sensor.VELOCITY, Sensor.PLACE} & found.keys():  # an estimator's velocity is the poorer one
        found |= {c.sensor: c for c in recording.dynamics if c.source == TABLE and len(c) >= _LEAST}
    turn = rotation(q)
    force = _readings_at(recording, Sensor.ACCEL, t)
    for sensor in (Sensor.VELOCITY, Sensor.PLACE):
        signal = None if sensor not in found else Signal.of(found[sensor])
        if signal is not None:
            cutoff = None
            if force is not None:
                plain = low_passed(signal)
                moved = interpolated(plain.t, _derivative(plain, sensor), t)
                likely = matched_to(force, turn.inv().apply(moved - GRAVITY_NED))
                cutoff = bandwidth(t, moved, turn.apply(likely) + GRAVITY_NED)
            smooth = low_passed(signal, _lower(cutoff, highest))
            return interpolated(smooth.t, _derivative(smooth, sensor), t), smooth.cutoff_hz
    return None, None


def _derivative(smooth: LowPassedSignal, sensor: Sensor) -> Array:
    return smooth.first if sensor == Sensor.VELOCITY else smooth.second


def ideal_along(pose: PoseTrajectory, earth: Array | None) -> Ideal:
    """Ideal sensors along `pose`; the magnetometer in the field `earth` (3,), uT, north-east-down, None: unknown.

    Without place or velocity the acceleration is zero, as the text says.
    """
    rows, turn = pose.known, rotation(pose.attitude).inv()
    acceleration = np.zeros((len(pose.t), 3)) if pose.acceleration is None else pose.acceleration
    readings = {
        Sensor.ACCEL: Signal(pose.t[rows], turn.apply(acceleration - GRAVITY_NED)[rows]),
        Sensor.GYRO: Signal(pose.t[rows], pose.rate[rows]),
    }
    if earth is not None:
        readings[Sensor.MAG] = Signal(pose.t[rows], turn.apply(np.tile(earth, (len(pose.t), 1)))[rows])
    cutoff = pose.cutoffs.rotation
    band = "" if cutoff is None else f", below {cutoff:.3g} Hz, where its own noise begins"
    still = "" if pose.acceleration is not None else "; no place or velocity was recorded: acceleration is not in it"
    return Ideal(
        ReferenceInfo(ReferenceKind.POSE, pose.att_sigma_deg, text=f"An ideal sensor driven by a pose{band}{still}."),
        readings,
        Signal(pose.t[rows], continuous(pose.attitude[rows])),
        pose.place,
    )


def earth_field_of(channels: list[Channel], pose: PoseTrajectory) -> Array | None:
    """The field in NED that magnetometers measured along `pose`, beside an offset of each; None if undetermined.

    ``m = R_bn B + h``, linear in B and every h; residuals beyond three times their median lose weight. With too few
    attitudes to separate B and h, h is zero. A magnetometer in another frame fits no field in its own: B is then that
    of the frame in which it fits and points north. None also if several frames fit equally, as with rotations about one
    axis only.
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
    turns, m, owners = np.vstack(rows), np.vstack(values), np.concatenate(owner)
    offsets = np.zeros((len(m), 3, 3 * len(channels)))
    for i in range(len(channels)):
        offsets[owners == i, :, 3 * i : 3 * i + 3] = np.eye(3)
    separable = np.linalg.svd(turns.mean(axis=0), compute_uv=False)[0] < _SPREAD
    both = np.concatenate([turns, offsets], axis=2)
    frame = _magnetometer_frame(both, m)
    return None if frame is None else _robust_fit(both if separable else turns, m @ frame)[:3]


def _magnetometer_frame(design: Array, m: Array) -> Array | None:
    """Exchange of axes and signs with which `m` (N, 3) fits a field; None if several fit and the identity does not.

    A frame and its opposite fit equally, with opposite fields: the one whose field points north is chosen.
    """
    few = slice(None, None, max(1, len(m) // 500))
    flat = design[few].reshape(-1, design.shape[2])
    left = np.linalg.svd(flat, full_matrices=False)
    span = left[0][:, left[1] > 1e-6 * left[1][0]]

    def misfit(turn: Array) -> float:
        right = (m[few] @ turn).ravel()
        return float(np.sum((right - span @ (span.T @ right)) ** 2))

    own = misfit(np.eye(3))
    if own < _FITS * np.sum((m[few] - m[few].mean(axis=0)) ** 2):
        return np.eye(3)
    found = {key: misfit(turn) for key, turn in AXIS_EXCHANGES.items()}
    least = min(found.values())
    if own <= 4.0 * least:
        return np.eye(3)
    fitting = [AXIS_EXCHANGES[key] for key, value in found.items() if value <= 2.0 * least]
    if len(fitting) > 2:  # one and its opposite
        return None
    north = [turn for turn in fitting if _robust_fit(design[few], m[few] @ turn)[0] > 0.0]
    return (north or fitting)[0]


_FITS = 0.1
"""Largest residual of a magnetometer's movement for a fitting frame, as a fraction. Chosen, not measured: a field with
any iron fits far better."""


_SPREAD = 0.98
"""Limit of the largest singular value of the mean attitude: 1 if it never changes, 0 if all are visited. Chosen, not
measured: attitudes within some 10 degrees of each other."""


def _robust_fit(design: Array, m: Array) -> Array:
    weight = np.ones(len(m))
    solution: Array = np.zeros(design.shape[2])
    for _ in range(12):
        scaled = design * np.sqrt(weight)[:, None, None]
        flat, right = scaled.reshape(-1, design.shape[2]), (m * np.sqrt(weight)[:, None]).ravel()
        solution = np.asarray(np.linalg.lstsq(flat, right, rcond=None)[0], dtype=np.float64)
        size = np.linalg.norm(m - design @ solution, axis=1)
        weight = np.minimum(1.0, 3.0 * np.median(size) / np.maximum(size, 1e-12))
    return solution
