"""Compass and gyroscope as a chain of directions and turns, solved for any delay of the compass.

Samples of the compass stand where :mod:`calib.imu.problem` has poses: ``y_k = b + C^-1 u_k`` and ``u_k+1 = D_k u_k``,
with D_k the integrated gyroscope. The rotation G turns the gyroscope's axes into those in which C is symmetric; where
the gyroscope's own scale or axes are off, G is any matrix.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from mavcal.calib.geometry import sphere_of
from mavcal.calib.imu.integrate import Moves
from mavcal.calib.imu.problem import ImuProblem, ImuSolution, solve
from mavcal.calib.imu.start import rough_gyro, with_turn_noise
from mavcal.calib.imu.unknowns import Coordinates, ImuPrior
from mavcal.calib.imu.weighting import groups
from mavcal.calib.mag.result import MagContext
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.norm_fit import NEUTRAL, symmetric
from mavcal.calib.stats.residuals import residual_statistics

RIGID = Coordinates(np.zeros(0, dtype=np.intp), rigid=True)
FREE_GYRO_MATRIX = Coordinates(np.zeros(0, dtype=np.intp))
BIAS_SD = 0.1  # rad/s, of a gyroscope before the data
_FIRST_NOISE = 0.01  # of the field: the compass' noise where nothing is known of it yet
_HOLE = 5.0  # usual steps of the gyroscope; over a longer one no direction is carried
_GAP = 0.5  # s without a gyroscope that a direction is not carried over
_DELAY_STEP = 0.02  # s
LONGEST_DELAY = 0.3  # s
_ENOUGH = 800  # samples of the compass that serve to begin with
_CONVINCING = 4.0  # reduced chi-square with the first noise: two percent of the field off, no other start is tried
_PER_BLOCK = 1.5  # samples of the compass in a block of the start


@dataclass(frozen=True, eq=False)
class ChainSolution:
    """A solution with the problem that it solves, in fields of strength `radius`."""

    problem: ImuProblem
    solution: ImuSolution
    coordinates: Coordinates
    radius: float
    noise: float
    delay: float
    delay_sd: float

    @property
    def cost(self) -> float:
        """Sum of squared residuals in standard deviations."""
        return self.solution.at.cost

    def covariance(self, prior: ImuPrior | None = None) -> Array:
        """Covariance (21, 21) of the unknowns, wider where residuals are correlated in time."""
        basis = self.coordinates.tangents(self.solution.x)
        information = self.solution.information
        if prior is not None:
            information = information + np.diag(prior.information)
        reduced = basis.T @ information @ basis
        scale = np.sqrt(np.diag(reduced))
        inner = np.linalg.inv(reduced / np.outer(scale, scale)) / np.outer(scale, scale)
        return np.asarray(basis @ inner @ basis.T, dtype=np.float64) * self.inflation

    @property
    def inflation(self) -> float:
        """Factor on the variances by serial correlation of the compass' residuals, one at least."""
        rho = float(residual_statistics(self.solution.at.poses, 0, 1.0)["first_correlation"])
        return max((1.0 + rho) / (1.0 - rho), 1.0)


class Chain:
    """Compass and gyroscope as a chain of directions and turns, for any delay of the compass."""

    def __init__(self, mag: Channel, gyro: Channel, context: MagContext) -> None:
        inside = (mag.t >= gyro.t[0] + LONGEST_DELAY) & (mag.t <= gyro.t[-1])
        fresh = np.diff(mag.t, prepend=-np.inf) > 0.0
        self.mag = mag.take(inside & fresh)
        self.gyro = gyro
        self.context = context
        step = float(np.median(np.diff(gyro.t)))
        wide = np.flatnonzero(np.diff(gyro.t) > _HOLE * step)
        self.holes = np.sort(np.concatenate([gyro.t[wide], gyro.t[wide + 1]]))
        noise = np.diff(gyro.values, n=3, axis=0).var(axis=0) / 20.0  # third differences leave no motion
        self.density = (noise + gyro.quantum**2 / 12.0 + 1e-18) * step

    def solved(self, delay: float | None) -> ChainSolution | None:
        """The best solution: of two starts, of rigid and bent gyroscopes, and of all delays where none is given."""
        every = -(-len(self.mag) // _ENOUGH)
        few = Chain(self.mag.take(slice(None, None, every)), self.gyro, self.context)
        found: ChainSolution | None = None
        for x, radius in self._starts():
            begun = few._at(delay or 0.0, x, radius)
            if begun is not None and (found is None or begun.cost < found.cost):
                found = begun
            if found is not None and found.cost < _CONVINCING * max(found.problem.freedom, 1):
                break
        if found is None or every == 1:
            return None if found is None else self._concluded(self._weighed(found), delay)
        found = few._weighed(found)
        return self.refined(few._delayed(found, rounds=6) if delay is None else found, delay)

    def refined(self, found: ChainSolution, delay: float | None) -> ChainSolution | None:
        """The solution of this chain from where that of another one, `found`, ended."""
        again = self._again(found, found.delay)
        return None if again is None else self._concluded(self._weighed(again), delay)

    def _concluded(self, found: ChainSolution, delay: float | None) -> ChainSolution:
        if delay is None:
            found = self._weighed(self._delayed(found, rounds=2))
        with_matrix = self._again(dataclasses.replace(found, coordinates=FREE_GYRO_MATRIX), found.delay)
        margin = 6.0 * math.log(3 * len(self.mag))  # six more unknowns, by Schwarz' criterion
        return (
            self._weighed(with_matrix) if with_matrix is not None and with_matrix.cost < found.cost - margin else found
        )

    def _at(
        self, delay: float, x: Array, radius: float, noise: float = _FIRST_NOISE, coordinates: Coordinates = RIGID
    ) -> ChainSolution | None:
        t = self.mag.t - delay
        spans = np.column_stack([t[:-1], t[1:]])
        linked = (np.diff(t) < _GAP) & (np.diff(np.searchsorted(self.holes, t)) == 0)
        moves = Moves.of(self.gyro.t, self.gyro.values, spans[linked], np.zeros(3))
        quantum = self.mag.quantum**2 / 12.0 / radius**2
        problem = ImuProblem(
            means=self.mag.values / radius,
            covariances=np.tile((noise**2 + quantum) * np.eye(3), (len(t), 1, 1)),
            moves=moves,
            before=np.flatnonzero(linked),
            wander=np.zeros(len(t)),
            density=self.density,
            turn_covariances=np.zeros((len(moves), 3, 3)),
            rest=np.zeros(3),
            rest_covariance=BIAS_SD**2 * np.eye(3),
        )
        problem = with_turn_noise(problem, x)
        problem = dataclasses.replace(problem, turn_covariances=problem.turn_covariances + 1e-16 * np.eye(3))
        u = (problem.means - x[:3]) @ symmetric(x[3:9])
        u = u / np.maximum(np.linalg.norm(u, axis=1), 1e-9)[:, None]
        solution = solve(problem, x, u, prior=weak_prior(x), coordinates=coordinates)
        if solution is None:
            return None
        return ChainSolution(problem, solution, coordinates, radius, noise, delay, 0.0)

    def _again(self, found: ChainSolution, delay: float) -> ChainSolution | None:
        """The solution from where `found` ended, with another delay."""
        return self._at(delay, found.solution.x, found.radius, found.noise, found.coordinates)

    def _weighed(self, found: ChainSolution) -> ChainSolution:
        """The solution with the compass' noise as known, or as its residuals show it."""
        known = self.context.noise_variance
        for _ in range(4):
            if known is not None:
                noise = math.sqrt(known) / found.radius
            else:
                fit = groups(found.problem, found.solution)[0]
                noise = found.noise * math.sqrt(max(fit.chi2 / max(fit.dof, 1.0), 1e-12))
            if abs(noise / found.noise - 1.0) < 0.02:
                break
            scaled = dataclasses.replace(
                found.problem, covariances=found.problem.covariances * (noise / found.noise) ** 2
            )
            x = found.solution.x
            solution = solve(scaled, x, found.solution.directions, prior=weak_prior(x), coordinates=found.coordinates)
            if solution is None:
                break
            found = dataclasses.replace(found, problem=scaled, solution=solution, noise=noise)
        return found

    def _delayed(self, found: ChainSolution, rounds: int) -> ChainSolution:
        """The delay with the least cost, by parabolas through three of them, and its sd."""
        step, best = min(_DELAY_STEP, 3.0 * found.delay_sd or _DELAY_STEP), found
        for _ in range(rounds):
            sides = [self._again(best, best.delay + sign * step) for sign in (-1.0, 1.0)]
            if any(side is None for side in sides):
                break
            low, high = (side.cost for side in sides if side is not None)
            curvature = (low + high - 2.0 * best.cost) / step**2
            if curvature <= 0.0:
                better = min((s for s in sides if s is not None), key=lambda s: s.cost)
                if better.cost >= best.cost or abs(better.delay) > LONGEST_DELAY:
                    break
                best = better
                continue
            shift = float(np.clip((low - high) / (2.0 * step * curvature), -3.0 * step, 3.0 * step))
            moved = self._again(best, float(np.clip(best.delay + shift, -LONGEST_DELAY, LONGEST_DELAY)))
            if moved is None:
                break
            best = dataclasses.replace(moved, delay_sd=math.sqrt(2.0 / curvature))
            if abs(shift) < 0.3 * best.delay_sd or abs(shift) < 1e-4:
                break
        return best

    def _starts(self) -> list[tuple[Array, float]]:
        """Unknowns (21,) and strengths to begin with: the sphere's centre, and that by the gyroscope's own axes."""
        centres = [sphere_of(self.mag.values)[0], self._turning_centre()]
        starts = []
        for centre in centres:
            radius = float(np.sqrt(((self.mag.values - centre) ** 2).sum(axis=1).mean()))
            block = max(0.1, _PER_BLOCK * float(np.median(np.diff(self.mag.t))))
            span = np.array([[self.mag.t[0], self.mag.t[-1]]])
            rough = rough_gyro(self.mag, self.gyro, span, np.zeros(3), centre, block)
            for matrix in ([] if rough is None else [rotation_of(rough)]) + [np.eye(3)]:
                x = np.concatenate([centre / radius, NEUTRAL[3:], matrix.ravel(), np.zeros(3)])
                starts.append((x, radius))
        return starts

    def _turning_centre(self) -> Array:
        """The offset (3,) by ``dy = -W x (y - b)`` over every interval, with the axes of both sensors taken as one."""
        t, y = self.mag.t, self.mag.values
        edges = np.concatenate([[0.0], np.cumsum(np.diff(self.gyro.t))]) + self.gyro.t[0]
        steps = 0.5 * (self.gyro.values[1:] + self.gyro.values[:-1]) * np.diff(self.gyro.t)[:, None]
        integral = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        at = np.column_stack([np.interp(t, edges, column) for column in integral.T])
        turn = np.diff(at, axis=0)
        design = np.zeros((len(turn), 3, 3))
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            design[:, i, j], design[:, j, i] = -turn[:, k], turn[:, k]
        target = np.diff(y, axis=0) + np.cross(turn, 0.5 * (y[1:] + y[:-1]))
        return np.asarray(np.linalg.lstsq(design.reshape(-1, 3), target.ravel(), rcond=1e-3)[0], dtype=np.float64)


def rotation_of(matrix: Array) -> Array:
    """The rotation (or reflection) nearest to `matrix`."""
    U, _, Vt = np.linalg.svd(matrix)
    return np.asarray(U @ Vt, dtype=np.float64)


def weak_prior(x: Array) -> ImuPrior:
    """Offsets within a field, scales within half their size, axes within a radian of `x` (21,)."""
    sd = np.concatenate([np.ones(3), np.full(6, 0.5), np.full(9, 1.0), np.full(3, np.inf)])
    return ImuPrior(x, 1.0 / sd**2)
