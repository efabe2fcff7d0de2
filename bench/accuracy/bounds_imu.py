"""The joint bound of a multi-position calibration: accelerometer, gyroscope and every pose's direction together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, eq=False)
class Unit:
    """The true sensors: ``accel = A (-g d) + b_a``, A symmetric, d down in the body; ``gyro = G w + b_g``."""

    accel: Array
    gyro: Array
    accel_variance: float
    gyro_variance: float
    gravity: float


def joint(unit: Unit, spans: list[tuple[int, int]], rates: Array, downs: Array, dt: float) -> Array:
    """(21, 21) of ``b_a``, the six of A (diagonal first), the rows of G, ``b_g``; every pose's direction unknown.

    `spans` are first and one past the last sample of the poses that are used; `rates` and `downs` (N, 3) the true ones.
    What is measured: the means over the poses, and between them the turning of the vertical, ``d' = d x w``, with the
    noise of the rates integrated.
    """
    count = len(spans)
    total = np.zeros((21 + 2 * count, 21 + 2 * count))
    tangents = [_tangent(downs[start]) for start, _ in spans]
    for k, (start, end) in enumerate(spans):
        _add(total, _pose_rows(unit, downs[start], tangents[k], k, count), (end - start) / unit.accel_variance)
        total[18:21, 18:21] += (end - start) / unit.gyro_variance * np.eye(3)
    for k in range(count - 1):
        rows, covariance = _move(unit, spans[k][1], spans[k + 1][0], rates, downs, dt)
        full = np.zeros((2, total.shape[0]))
        out = tangents[k + 1]
        full[:, 9:21] = -out.T @ rows[:, 3:]
        full[:, 21 + 2 * k : 23 + 2 * k] = -out.T @ rows[:, :3] @ tangents[k]
        full[:, 23 + 2 * k : 25 + 2 * k] = np.eye(2)
        total += full.T @ np.linalg.solve(out.T @ covariance @ out, full)
    own, mixed = total[:21, :21], total[:21, 21:]
    return own - mixed @ np.linalg.solve(total[21:, 21:], mixed.T)


def _add(total: Array, rows: Array, weight: float) -> None:
    total += weight * rows.T @ rows


def _pose_rows(unit: Unit, down: Array, tangent: Array, k: int, count: int) -> Array:
    rows = np.zeros((3, 21 + 2 * count))
    rows[:, :3] = np.eye(3)
    force = -unit.gravity * down
    for place, (i, j) in enumerate(SYMMETRIC):
        rows[i, 3 + place] += force[j]
        if i != j:
            rows[j, 3 + place] += force[i]
    rows[:, 21 + 2 * k : 23 + 2 * k] = -unit.gravity * unit.accel @ tangent
    return rows


def _move(unit: Unit, start: int, end: int, rates: Array, downs: Array, dt: float) -> tuple[Array, Array]:
    """Derivative (3, 15) of the last vertical by the first, the rows of G and b_g, and its covariance (3, 3)."""
    inverse = np.linalg.inv(unit.gyro)
    carried = np.eye(3)  # of an error at a sample to the end: from the last sample backwards
    by, covariance = np.zeros((3, 12)), np.zeros((3, 3))
    for i in range(end - 1, start - 1, -1):
        pull = carried @ _cross(downs[i]) * dt  # d' = d x w, so an error of the rate turns it by d x dw
        by_reading = -pull @ inverse  # a number that is too large was read by larger parameters, not by more turning
        for axis in range(3):
            by[:, 3 * axis : 3 * axis + 3] += np.outer(by_reading[:, axis], rates[i])
        by[:, 9:] += by_reading
        covariance += by_reading @ by_reading.T * unit.gyro_variance
        carried = carried @ _turned(rates[i], dt)
    return np.hstack([carried, by]), covariance


def _turned(rate: Array, dt: float) -> Array:
    """What a body-fixed rate does to a vertical in the body over `dt`: ``exp(-[w] dt)``."""
    angle = float(np.linalg.norm(rate)) * dt
    W = _cross(rate) * dt
    if angle < 1e-9:
        return np.eye(3) - W
    return np.eye(3) - np.sin(angle) / angle * W + (1.0 - np.cos(angle)) / angle**2 * W @ W


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _tangent(down: Array) -> Array:
    """Two unit vectors across `down`, (3, 2)."""
    one = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    one /= np.linalg.norm(one)
    return np.column_stack([one, np.cross(down, one)])
