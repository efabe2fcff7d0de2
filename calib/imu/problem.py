"""One maximum-likelihood problem for accelerometer, gyroscope and the directions of the poses.

In units of the poses' radius and of a gyroscope of about unit scale, with u_k the direction of gravity in pose k:

* pose: ``mean_k = b + C^-1 u_k + noise``, C symmetric (the frame of both sensors, METHODS 0);
* movement: ``u_after = D(G, bg) u_before``, two numbers across it;
* rest: the mean of the gyroscope over all poses is bg.

The directions form a chain, so one banded factorisation eliminates them and leaves 21 unknowns (METHODS 3.3).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from mavcal.calib.imu.integrate import Moves, Turns, integrate
from mavcal.calib.imu.unknowns import ACCEL, FREE, GYRO, NO_PRIOR, UNKNOWNS, Array, Coordinates, ImuPrior, cross
from mavcal.calib.stats.norm_fit import PAIRS, symmetric

_ROUNDS = 60
_DECREMENT = 1e-8  # of the cost, in squared standard deviations, by a step that is no longer worth another


@dataclass(frozen=True, eq=False)
class ImuProblem:
    """Pose means, movements and rest, each with its noise; K movements between P poses.

    `means` (P, 3) and `covariances` (P, 3, 3) in radii; `before` (K,) is the pose that movement k leaves, the next one
    is where it ends; `wander` (P,) is the variance of a direction by sway, rad^2; `density` (3,) the noise of the rates
    (:func:`integrate`) and `turn_covariances` (K, 3, 3) its effect on each turn. `extra` are the variances that the
    residuals need beyond the noise: of a mean's component, and of a direction after a movement.
    """

    means: Array
    covariances: Array
    moves: Moves
    before: NDArray[np.intp]
    wander: Array
    density: Array
    turn_covariances: Array
    rest: Array
    rest_covariance: Array
    extra: tuple[float, float] = (0.0, 0.0)

    @property
    def freedom(self) -> int:
        """Numbers observed less numbers fitted."""
        return len(self.means) + 2 * len(self.before) + 3 - UNKNOWNS

    def without_move(self, move: int) -> ImuProblem:
        """The problem without that movement."""
        return self._of_moves(np.delete(np.arange(len(self.before)), move))

    def without_pose(self, pose: int) -> ImuProblem:
        """The problem without that pose and the movements to and from it."""
        kept = np.delete(np.arange(len(self.means)), pose)
        moves = np.flatnonzero((self.before != pose) & (self.before + 1 != pose))
        fewer = self._of_moves(moves)
        return dataclasses.replace(
            fewer,
            means=self.means[kept],
            covariances=self.covariances[kept],
            wander=self.wander[kept],
            before=fewer.before - (fewer.before > pose),
        )

    def _of_moves(self, which: NDArray[np.intp]) -> ImuProblem:
        return dataclasses.replace(
            self,
            moves=self.moves.take(which),
            before=self.before[which],
            turn_covariances=self.turn_covariances[which],
        )


@dataclass(frozen=True, eq=False)
class Linearised:
    """Whitened residuals of poses (P, 3) and movements (K, 2), and the normal equations with the directions."""

    cost: float
    poses: Array
    moves: Array
    band: Array  # (4, 2P) upper form of the directions' block
    border: Array  # (2P, 21)
    corner: Array  # (21, 21)
    directions: Array  # (2P,) gradient
    gradient: Array  # (21,)
    bases: Array  # (P, 3, 2)


@dataclass(frozen=True, eq=False)
class ImuSolution:
    """The converged solution: unknowns (21,), directions (P, 3), information with the directions eliminated."""

    x: Array
    directions: Array
    information: Array
    at: Linearised
    turns: Turns


def solve(
    problem: ImuProblem, x: Array, directions: Array, *, prior: ImuPrior = NO_PRIOR, coordinates: Coordinates = FREE
) -> ImuSolution | None:
    """Damped Gauss-Newton solution from `x` (21,) and `directions` (P, 3); None if it does not converge.

    The information of the solution is that of the data, without the prior.
    """
    damping = 0.0
    turns = turns_of(problem, x)
    at = linearise(problem, x, directions, turns)
    for _ in range(_ROUNDS):
        off = prior.information * (x - prior.centre)
        step = _step(at, prior.information, off, coordinates.tangents(x), damping)
        if step is None:
            return None
        change, tangents, decrement = step
        trial = coordinates.moved(x, change)
        moved = directions + np.einsum("kij,kj->ki", at.bases, tangents)
        moved /= np.linalg.norm(moved, axis=1)[:, None]
        new_turns = turns_of(problem, trial)
        new = linearise(problem, trial, moved, new_turns)
        done = decrement < _DECREMENT and damping == 0.0
        before, after = at.cost + _off(prior, x), new.cost + _off(prior, trial)
        if not done and not after <= before * (1.0 + 1e-6):
            if damping > 1e9:
                return None
            damping = max(10.0 * damping, 1e-3)
            continue
        x, directions, turns, at, damping = trial, moved, new_turns, new, 0.1 * damping
        damping = damping if damping > 1e-5 else 0.0
        if done:
            return ImuSolution(x, directions, reduced(at)[0], at, turns)
    return None


def _off(prior: ImuPrior, x: Array) -> float:
    return float(prior.information @ (x - prior.centre) ** 2)


def turns_of(problem: ImuProblem, x: Array) -> Turns:
    """Rotation of each movement, by the gyroscope of the unknowns `x`."""
    return integrate(problem.moves, x[9:18].reshape(3, 3), x[18:21], problem.density)


def linearise(
    problem: ImuProblem, x: Array, u: Array, turns: Turns, weights: tuple[float, float] = (1.0, 1.0)
) -> Linearised:
    """Residuals and normal equations at unknowns `x` and directions `u`; `weights` multiply poses and movements."""
    inverse = np.asarray(np.linalg.inv(symmetric(x[3:9])), dtype=np.float64)
    bases = _bases(u)
    of_pose, of_move = (float(np.sqrt(weight)) for weight in weights)
    pose_r, pose_x, pose_u = (of_pose * a for a in _pose_rows(problem, x, u, inverse, bases))
    move_r, move_x, move_before, move_after = (of_move * a for a in _move_rows(problem, u, turns, bases))
    rest_white = np.linalg.inv(np.linalg.cholesky(problem.rest_covariance))
    rest_r = rest_white @ (problem.rest - x[18:21])
    corner, gradient = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    for J, r, part in (
        (pose_x.reshape(-1, 9), pose_r.ravel(), ACCEL),
        (move_x.reshape(-1, 12), move_r.ravel(), GYRO),
        (-rest_white, rest_r, slice(18, 21)),
    ):
        corner[part, part] += J.T @ J
        gradient[part] += J.T @ r
    blocks = np.swapaxes(pose_u, 1, 2) @ pose_u
    right = np.einsum("kij,ki->kj", pose_u, pose_r)
    border = np.zeros((len(u), 2, UNKNOWNS))
    border[:, :, ACCEL] += np.swapaxes(pose_u, 1, 2) @ pose_x
    off = np.zeros((len(u), 2, 2))  # pose k with pose k + 1
    for of, pose in ((move_before, problem.before), (move_after, problem.before + 1)):
        transposed = np.swapaxes(of, 1, 2)
        blocks[pose] += transposed @ of
        right[pose] += np.einsum("kij,ki->kj", of, move_r)
        border[pose, :, GYRO] += transposed @ move_x
    off[problem.before] = np.swapaxes(move_before, 1, 2) @ move_after
    cost = float((pose_r**2).sum() + (move_r**2).sum() + rest_r @ rest_r)
    return Linearised(
        cost, pose_r, move_r, _band(blocks, off), border.reshape(-1, UNKNOWNS), corner, right.ravel(), gradient, bases
    )


def reduced(at: Linearised, damping: float = 0.0) -> tuple[Array, Array, Array]:
    """Information (21, 21) and gradient (21,) with the directions eliminated, and ``A^-1 [border, gradient]``."""
    band = at.band.copy()
    band[-1] *= 1.0 + damping
    factor = scipy.linalg.cholesky_banded(band)
    solved = np.asarray(scipy.linalg.cho_solve_banded((factor, False), np.column_stack([at.border, at.directions])))
    information = at.corner - at.border.T @ solved[:, :UNKNOWNS]
    return 0.5 * (information + information.T), at.gradient - at.border.T @ solved[:, UNKNOWNS], solved


def log_determinant(at: Linearised) -> float:
    """Logarithm of the determinant of the whole normal matrix."""
    factor = scipy.linalg.cholesky_banded(at.band)
    value = 2.0 * float(np.log(factor[-1]).sum())
    return value + float(np.linalg.slogdet(reduced(at)[0])[1])


def _step(
    at: Linearised, prior: Array, prior_gradient: Array, basis: Array, damping: float
) -> tuple[Array, Array, float] | None:
    """Change of the unknowns along `basis` (21, p), of the directions (P, 2), and what the cost should fall by.

    None if nothing determines it.
    """
    information, gradient, solved = reduced(at, damping)
    information = basis.T @ (information + np.diag(prior)) @ basis
    gradient = basis.T @ (gradient + prior_gradient)
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    if not (np.isfinite(information).all() and (scale > 0.0).all()):
        return None
    sub = information / np.outer(scale, scale) + damping * np.eye(len(scale))
    if np.linalg.cond(sub) > 1e13:
        return None
    change = -np.linalg.solve(sub, gradient / scale) / scale
    tangents = -solved[:, UNKNOWNS] - solved[:, :UNKNOWNS] @ (basis @ change)
    decrement = -float(gradient @ change) + float(at.directions @ solved[:, UNKNOWNS])
    return change, tangents.reshape(-1, 2), decrement


def _bases(u: Array) -> Array:
    """Two orthonormal tangents (P, 3, 2) at every direction."""
    least = np.eye(3)[np.argmin(np.abs(u), axis=1)]
    first = np.cross(u, least)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(u, first)], axis=2)


def _pose_rows(problem: ImuProblem, x: Array, u: Array, inverse: Array, bases: Array) -> tuple[Array, Array, Array]:
    """Whitened residuals (P, 3) of the means, and their derivatives by accelerometer and direction."""
    covariances = problem.covariances + problem.extra[0] * np.eye(3)
    white = np.linalg.inv(np.linalg.cholesky(covariances))
    felt = u @ inverse  # symmetric
    residuals = problem.means - x[:3] - felt
    J = np.empty((len(u), 3, 9))
    J[:, :, :3] = -np.eye(3)
    for k, (i, j) in enumerate(PAIRS):  # d(C^-1 u) = -C^-1 dC C^-1 u
        J[:, :, 3 + k] = np.outer(felt[:, j], inverse[:, i])
        if i != j:
            J[:, :, 3 + k] += np.outer(felt[:, i], inverse[:, j])
    return np.einsum("kij,kj->ki", white, residuals), white @ J, -white @ (inverse @ bases)


def _move_rows(problem: ImuProblem, u: Array, turns: Turns, bases: Array) -> tuple[Array, Array, Array, Array]:
    """Whitened residuals (K, 2) across the movements, and their derivatives by gyroscope and the two directions."""
    before, after = problem.before, problem.before + 1
    carried = np.einsum("kij,kj->ki", turns.rotations, u[before])
    across = np.swapaxes(bases[after], 1, 2)
    turned = across @ cross(carried)
    wander = problem.wander[before] + problem.wander[after] + problem.extra[1]
    covariance = turned @ problem.turn_covariances @ np.swapaxes(turned, 1, 2) + wander[:, None, None] * np.eye(2)
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    residuals = np.einsum("kij,kj->ki", across, u[after] - carried)
    return (
        np.einsum("kij,kj->ki", white, residuals),
        -white @ turned @ turns.sensitivity,
        -white @ across @ turns.rotations @ bases[before],
        white @ across @ bases[after],
    )


def _band(blocks: Array, off: Array) -> Array:
    """The block-tridiagonal matrix in the upper form of scipy's banded routines, (4, 2P)."""
    count = 2 * len(blocks)
    band = np.zeros((4, count))
    band[3] = np.einsum("kii->ki", blocks).ravel()
    band[2, 1::2] = blocks[:, 0, 1]
    band[2, 2::2] = off[:-1, 1, 0]
    band[1, 2::2], band[1, 3::2] = off[:-1, 0, 0], off[:-1, 1, 1]
    band[0, 3::2] = off[:-1, 0, 1]
    return band
