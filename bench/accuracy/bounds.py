"""Cramer-Rao bounds from the measurement models alone: nothing here is shared with an estimator.

Fisher information F of the parameters, for Gaussian noise; no unbiased estimate scatters less than ``F^-1``.
Quantisation to a step q adds ``q^2/12`` to the variance of a sample while the motion or the noise spreads it over bins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BLOCK = 1 << 16


def variance_of(sd: float, quantum: float) -> float:
    """Variance of one axis of one sample."""
    return sd * sd + quantum * quantum / 12.0


def moving_variance_of(sd: float, quantum: float) -> float:
    """The same of a number that moves through the bins, used as well as it can be.

    The information in the bin it fell into, on average over where in the bin it was: of noise above half a bin that is
    ``1/(sd^2 + q^2/12)``; below, the few numbers next to an edge say more than the variance of rounding lets expect.
    """
    if not quantum:
        return sd * sd
    places = (np.arange(64) + 0.5) / 64.0 * quantum
    return 1.0 / float(np.mean([_bins(place, sd, quantum)[0] for place in places]))


def ellipsoid(directions: Array, shape: Array, variance: float) -> Array:
    """(9, 9) of ``b_x b_y b_z S_xx S_yy S_zz S_xy S_xz S_yz`` in ``y = S u + b + e``, unit vectors u (N, 3) unknown.

    Each u takes two of a sample's three numbers with it; what is left is the distance along the normal ``S^-1 u``:
    its derivative by b is n, by a diagonal entry ``n_i u_i``, by a cross term ``n_i u_j + n_j u_i``.
    """
    total = np.zeros((9, 9))
    inverse = np.linalg.inv(shape)
    for k in range(0, len(directions), _BLOCK):
        u = directions[k : k + _BLOCK]
        n = u @ inverse
        n /= np.sqrt(np.einsum("ij,ij->i", n, n))[:, None]
        rows = np.empty((len(u), 9))
        rows[:, 0:3] = n
        rows[:, 3:6] = n * u
        rows[:, 6] = n[:, 0] * u[:, 1] + n[:, 1] * u[:, 0]
        rows[:, 7] = n[:, 0] * u[:, 2] + n[:, 2] * u[:, 0]
        rows[:, 8] = n[:, 1] * u[:, 2] + n[:, 2] * u[:, 1]
        total += rows.T @ rows
    return total / variance


def linear_triad(truths: Array, variance: float) -> Array:
    """(12, 12) of ``b`` and the rows of M in ``y = M x + b + e`` with known x (N, 3): a triad on a perfect fixture."""
    gram = np.zeros((4, 4))
    rows = np.hstack([np.ones((len(truths), 1)), truths])
    gram += rows.T @ rows
    total = np.zeros((12, 12))
    for axis in range(3):
        places = [axis, *(3 + 3 * axis + j for j in range(3))]
        total[np.ix_(places, places)] = gram / variance
    return total


def polynomial(x: Array, degree: int, variance: float) -> Array:
    """(degree + 1,) squared of the coefficients of ``1, x, x^2 ...`` of one axis."""
    gram = np.zeros((degree + 1, degree + 1))
    for k in range(0, len(x), _BLOCK):
        rows = np.vander(x[k : k + _BLOCK], degree + 1, increasing=True)
        gram += rows.T @ rows
    return gram / variance


def alignment(
    fields: Array, downs: Array, matrix: Array, dip: float, mag_variance: float, down_variance: float
) -> Array:
    """(13, 13) of ``b``, the rows of M and the dip of a magnetometer beside an accelerometer.

    ``y = M h + b + e`` and ``d + f`` are measured. In the body h (N, 3) is the unit field and d (N, 3) the unit
    vertical, with ``h . d = sin dip``. The attitude of every sample is unknown: its three angles are eliminated by the
    Schur complement. `down_variance` is that of one component of the measured vertical; along itself it says nothing.
    """
    total = np.zeros((13, 13))
    for h, d in zip(fields, downs, strict=True):
        by_angle_y, by_angle_d = matrix @ _cross(h), _cross(d)
        by_parameters = np.zeros((3, 13))
        by_parameters[:, :3] = np.eye(3)
        for i in range(3):
            by_parameters[i, 3 + 3 * i : 6 + 3 * i] = h
        level = (h - np.sin(dip) * d) / np.cos(dip)
        by_parameters[:, 12] = matrix @ (np.cos(dip) * d - np.sin(dip) * level)
        nuisance = by_angle_y.T @ by_angle_y / mag_variance + by_angle_d.T @ by_angle_d / down_variance
        mixed = by_parameters.T @ by_angle_y / mag_variance
        total += by_parameters.T @ by_parameters / mag_variance - mixed @ np.linalg.solve(nuisance, mixed.T)
    return total


def _cross(v: Array) -> Array:
    """The matrix of ``v x``: up to its sign the derivative of a body vector by a small rotation of the body."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def interval_mean(mean: float, sd: float, quantum: float) -> float:
    """Information on the mean in one number rounded to `quantum`, its noise `sd` unknown as well.

    The probabilities of the bins are a multinomial in (mean, sd); sd is eliminated by the Schur complement.
    """
    mm, ms, ss = _bins(mean, sd, quantum)
    return mm - ms * ms / ss


def _bins(mean: float, sd: float, quantum: float) -> tuple[float, float, float]:
    """Fisher information (mean, mean and sd, sd) of the bin that one number falls into."""
    reach = int(np.ceil(8.0 * sd / quantum)) + 2
    edges = (np.rint(mean / quantum) + np.arange(-reach, reach + 1) - 0.5) * quantum
    z = (edges - mean) / sd
    below = 0.5 * (1.0 + np.array([math.erf(x / math.sqrt(2.0)) for x in z]))
    density = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / sd
    share = np.diff(below)
    there = share > 1e-300
    share, by_mean, by_sd = share[there], -np.diff(density)[there], -np.diff(density * z)[there]
    return tuple(float((a * b / share).sum()) for a, b in ((by_mean, by_mean), (by_mean, by_sd), (by_sd, by_sd)))


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
        rows = _pose_rows(unit, downs[start], tangents[k], k, count)
        total += (end - start) / unit.accel_variance * rows.T @ rows
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


def _tangent(down: Array) -> Array:
    """Two unit vectors across `down`, (3, 2)."""
    one = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    one /= np.linalg.norm(one)
    return np.column_stack([one, np.cross(down, one)])
