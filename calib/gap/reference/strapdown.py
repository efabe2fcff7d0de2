"""Strapdown integration of gyroscope and accelerometer between the nodes of a trajectory, all intervals at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.reference.signals import Signal
from mavcal.calib.geometry import quaternion_product

Array = NDArray[np.float64]

STEPS = 8
"""Steps between nodes, within which the rate is constant. Chosen, not measured: 80 steps a second follow turns up to 20
Hz."""
WARMTH_UNIT = 10.0
"""Unit of temperature, K. Chosen, not measured: a usual warm-up, so that coefficients are as large as the drift
itself."""
_LEAST_WARMTH = 3.0
"""Least temperature span, K, for thermal drifts. Chosen, not measured: a smaller span causes less than the sensor's
noise."""


@dataclass(frozen=True, eq=False)
class Increments:
    """Angle and velocity increments (K, STEPS, 3) of an inertial unit over the steps of K intervals of `dt` seconds.

    `sampling` (2, 3) are standard deviations of angle and velocity over an interval from sampling alone, x y z. They
    are the change of the sums when every second sample is omitted, and bound the aliasing of turns and vibration. With
    slow samples that error is correlated over several intervals; it is scaled as independent errors with the same sum.
    `known` (K,) is False for intervals in a hole. `warmth` (K,) is the temperature above its mean in units of
    :data:`WARMTH_UNIT`; 0 if unknown or nearly constant. `dense`: the gyroscope has a sample for every step, which
    resolves turns within an interval.
    """

    t: Array
    dt: float
    angle: Array
    velocity: Array
    sampling: Array
    known: NDArray[np.bool_]
    warmth: Array
    dense: bool

    @classmethod
    def of(cls, gyro: Signal, accel: Signal, t: Array, temperature: Array | None = None) -> Increments:
        """Increments between uniform nodes `t` (K + 1,); `temperature` (K + 1,) at the nodes, degC."""
        dt = float(t[1] - t[0])
        edges = t[0] + dt / STEPS * np.arange((len(t) - 1) * STEPS + 1)
        shape = (len(t) - 1, STEPS, 3)
        sums = [_integrals(signal, edges).reshape(shape) for signal in (gyro, accel)]
        coarse = [_integrals(Signal(s.t[::2], s.values[::2]), t) for s in (gyro, accel)]
        middle = 0.5 * (t[1:] + t[:-1])
        known = np.logical_and.reduce([s.known(x) for s in (gyro, accel) for x in (t[:-1], middle, t[1:])])
        rows = known if known.any() else ~known
        change = [np.sqrt(np.mean((a.sum(axis=1) - b)[rows] ** 2, axis=0)) for a, b in zip(sums, coarse, strict=True)]
        lasting = [np.sqrt(max(1.0, float(np.median(np.diff(s.t))) / dt)) for s in (gyro, accel)]
        sampling = np.array(change) * np.array(lasting)[:, None]
        dense = float(np.median(np.diff(gyro.t))) <= dt / STEPS
        return cls(t, dt, sums[0], sums[1], sampling, known, _relative_warmth(temperature, len(t) - 1), dense)

    def integrated(
        self,
        gyro_bias: Array,
        accel_bias: Array,
        gyro_matrix: Array | None = None,
        accel_turn: Rotation | None = None,
        accel_scale: Array | None = None,
    ) -> IntervalMotion:
        """Motion over each interval, with the errors of the unit corrected.

        Biases (K, 3) are subtracted; gyroscope matrix (3, 3), accelerometer scales (3,) and rotation are undone.
        """
        step = self.dt / STEPS
        angle = self.angle - step * gyro_bias[:, None, :]
        if gyro_matrix is not None:
            angle = angle @ np.linalg.inv(gyro_matrix).T
        velocity = self.velocity - step * accel_bias[:, None, :]
        if accel_scale is not None:
            velocity = velocity / accel_scale
        if accel_turn is not None:
            velocity = velocity @ accel_turn.as_matrix()
        halves = Rotation.from_rotvec(0.5 * angle.reshape(-1, 3)).as_quat().T.reshape(4, len(angle), STEPS)
        turn = np.zeros((4, len(angle)))
        turn[3] = 1.0
        total = np.zeros((len(angle), 3))
        within = []
        for j in range(STEPS):
            within.append(Rotation.from_quat(turn.T))
            half = quaternion_product(turn, halves[..., j])  # rotation and sculling to second order
            total += Rotation.from_quat(half.T).apply(velocity[:, j])
            turn = quaternion_product(half, halves[..., j])
        return IntervalMotion(Rotation.from_quat(turn.T), total, tuple(within), angle / step, self.dense)


@dataclass(frozen=True, eq=False)
class IntervalMotion:
    """Rotation and velocity change (K, 3) over each interval, in its initial axes; attitudes and rates at its steps.

    `dense`: steps that were sampled, not interpolated.
    """

    turn: Rotation
    velocity: Array
    within: tuple[Rotation, ...]
    rate: Array
    dense: bool


def _relative_warmth(temperature: Array | None, count: int) -> Array:
    if temperature is None or float(np.ptp(temperature)) < _LEAST_WARMTH:
        return np.zeros(count)
    middle = 0.5 * (temperature[1:] + temperature[:-1])
    return np.asarray((middle - middle.mean()) / WARMTH_UNIT)


def _integrals(signal: Signal, edges: Array) -> Array:
    """Integral of every column between consecutive `edges`, with linear interpolation, held at the ends."""
    t, values = signal.t, signal.values
    area = np.vstack([np.zeros(3), np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t)[:, None], axis=0)])
    inside = np.clip(edges, t[0], t[-1])
    k = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, len(t) - 2)
    s = (inside - t[k])[:, None]
    slope = (values[k + 1] - values[k]) / (t[k + 1] - t[k])[:, None]
    upto = area[k] + values[k] * s + 0.5 * slope * s**2
    upto += np.minimum(edges - t[0], 0.0)[:, None] * values[0] + np.maximum(edges - t[-1], 0.0)[:, None] * values[-1]
    return np.asarray(np.diff(upto, axis=0))
