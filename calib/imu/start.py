"""Start values of the joint fit: the accelerometer alone, then the gyroscope's rough scale and axes."""

from __future__ import annotations

import dataclasses

import numpy as np

from mavcal.calib.imu.integrate import integrate
from mavcal.calib.imu.problem import ImuProblem
from mavcal.calib.imu.unknowns import cross
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.norm_fit import symmetric

_COARSE = 9.0  # times the variance of a turn by noise: what the samples' rate changes is more than that
_LEADS = float(np.radians(10.0))  # a movement that misses the next pose by less leads there
_OTHER_SCALE = float(np.sqrt(2.0))  # half way to the next range: 250, 500, 1000, 2000 deg/s
_BETTER = 0.5  # of the miss as given that a factor must leave at most
_AROUND, _TRIED = 1.5, 25  # about what the turn of gravity tells: how far factors are tried, and how many
_BLOCK = 0.1  # s over which the direction is averaged while it turns


def rough_gyro(
    accel: Channel, gyro: Channel, spans: Array, rest: Array, centre: Array, block: float = _BLOCK
) -> Array | None:
    """Gyroscope matrix (3, 3), rad/s per unit of `gyro`, from the accelerometer's turns; None: undetermined.

    ``u' = -w x u`` over blocks of a tenth of a second, linear in the matrix; accelerations by the hand count as noise.

    Parameters
    ----------
    accel, gyro
        Finite samples of the same time.
    spans : shape (K, 2)
        The movements, s.
    rest, centre : shape (3,)
        Reading of the gyroscope at rest, and of the accelerometer without gravity.
    block
        Time over which a direction is averaged, s.
    """
    rows, changes = [], []
    for start, end in spans:
        edges = np.arange(start, end + block, block)
        u = _block_means(accel, edges) - centre
        x = _block_means(gyro, edges) - rest
        u = u / np.linalg.norm(u, axis=1)[:, None]
        product = np.einsum("kij,kr->kijr", cross(u), x).reshape(-1, 3, 9)  # [u]x G x, G by rows
        rows.append(0.5 * block * (product[1:] + product[:-1]))
        changes.append(np.diff(u, axis=0))
    if not rows:
        return None
    design, change = np.concatenate(rows).reshape(-1, 9), np.concatenate(changes).ravel()
    good = np.isfinite(design).all(axis=1) & np.isfinite(change)
    if good.sum() < 60:
        return None
    solution, _, rank, _ = np.linalg.lstsq(design[good], change[good], rcond=1e-3)
    matrix = solution.reshape(3, 3)
    return matrix if rank == 9 and np.linalg.cond(matrix) < 100.0 else None


def closure(problem: ImuProblem, x: Array) -> float:
    """Root mean square angle by which the movements of the model `x` (21,) miss the next pose, rad."""
    return float(np.sqrt((_misses(problem, x) ** 2).mean()))


def rate_factor(problem: ImuProblem, x: Array, rough: Array) -> float | None:
    """Factor on the gyroscope's numbers that corrects a wrong unit or range.

    None: the movements lead from pose to pose without a factor, or with none. `x` (21,) has the gyroscope as given;
    `rough` (3, 3) is from :func:`rough_gyro`.
    """
    as_given = float(np.median(_misses(problem, x)))
    begun = float(np.cbrt(abs(np.linalg.det(rough))))
    if as_given < _LEADS or not begun > 0.0:
        return None

    def miss(factor: float) -> float:
        return float(np.median(_misses(problem, np.concatenate([x[:9], (factor * np.eye(3)).ravel(), x[18:]]))))

    tried = {factor: miss(factor) for factor in begun * np.geomspace(1.0 / _AROUND, _AROUND, _TRIED)}
    tried |= {factor: miss(factor) for factor in min(tried, key=tried.__getitem__) * np.linspace(0.985, 1.015, 7)}
    best = min(tried, key=tried.__getitem__)
    wrong = abs(np.log(best)) > np.log(_OTHER_SCALE)
    return float(best) if wrong and tried[best] < min(_BETTER * as_given, _LEADS) else None


def _misses(problem: ImuProblem, x: Array) -> Array:
    """Angle, rad, by which each movement of the model `x` (21,) misses the next pose, (K,)."""
    inclined = (problem.means - x[:3]) @ symmetric(x[3:9])
    u = inclined / np.linalg.norm(inclined, axis=1)[:, None]
    rotations = integrate(problem.moves, x[9:18].reshape(3, 3), x[18:21], problem.density).rotations
    carried = np.einsum("kij,kj->ki", rotations, u[problem.before])
    cosines = np.einsum("ki,ki->k", carried, u[problem.before + 1])
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)), dtype=np.float64)


def with_turn_noise(problem: ImuProblem, x: Array) -> ImuProblem:
    """The problem with the noise of its turns by the model `x` (21,), coarse sampling included.

    A turn that comes out differently with every second sample was too fast for the sample rate. A third of the
    difference is its error (Richardson, second order).
    """
    matrix, offset = x[9:18].reshape(3, 3), x[18:21]
    turns = integrate(problem.moves, matrix, offset, problem.density)
    coarse = integrate(problem.moves.thinned(), matrix, offset, problem.density).rotations
    apart = coarse @ np.swapaxes(turns.rotations, 1, 2)
    angles = 0.5 * np.stack([apart[:, j, i] - apart[:, i, j] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    noise = np.einsum("kii->k", turns.noise)
    error = (angles**2).sum(axis=1)
    fast = np.where(error > _COARSE * noise, error / 9.0, 0.0)
    return dataclasses.replace(problem, turn_covariances=turns.noise + fast[:, None, None] * np.eye(3))


def _block_means(channel: Channel, edges: Array) -> Array:
    """Means (B, 3) between consecutive `edges` (B + 1,); nan where there is no sample."""
    which = np.searchsorted(channel.t, edges)
    sums = np.vstack([np.zeros(3), np.cumsum(channel.values[which[0] : which[-1]], axis=0)])
    counts = np.diff(which)[:, None]
    total = np.diff(sums[which - which[0]], axis=0)
    means = np.full(total.shape, np.nan)
    np.divide(total, counts, out=means, where=counts > 0)
    return means
