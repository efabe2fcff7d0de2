"""Weights from the residuals: excess noise, and outlying poses or movements.

The scatter within a pose does not show a hand's sway, the sensors' non-linearity or acceleration that the gyroscope
feels. The residuals of the poses, or of the movements, may then exceed their noise by more than chance. If so, one
variance for all of that kind is added until they are as large as expected (Paule and Mandel 1982). The expected size
follows from the redundancy of each group, as in Helmert's variance components.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from mavcal.calib.imu.problem import ImuProblem, ImuSolution, linearise, log_determinant, solve
from mavcal.calib.imu.unknowns import Coordinates, ImuPrior
from mavcal.calib.stats.residuals import student_variance

MISFIT = 0.01
"""Chance below which residuals count as larger than their noise."""
_POSES, _MOVES = 0, 1  # places of the groups
_ROUNDS = 12
_ENOUGH = 0.02  # relative, of the residuals' size
_MOST_LEFT_OUT = 0.1  # of the poses
_SPOILT = 0.5  # of the reduced chi-square: what is left without the one that spoils it
_SUSPECTS = 3  # poses, and movements, of the largest residuals that are tried
_LEAST_FREEDOM = 20  # residuals more than unknowns, below which none is called wrong: all are widened


@dataclass(frozen=True)
class GroupFit:
    """Sum of squares, redundancy and chance of one group of residuals, by the sensors' own noise alone."""

    chi2: float
    dof: float

    @property
    def p_value(self) -> float | None:
        """Probability of so large a sum; None without redundancy."""
        return float(scipy.special.chdtrc(self.dof, self.chi2)) if self.dof >= 0.5 else None


@dataclass(frozen=True, eq=False)
class Weighed:
    """The solution with weights from the residuals, how both groups fitted without them, and what was left out.

    `kept` (P',) are the poses of the given problem that are still in it, `moves_out` the movements that are not.
    """

    problem: ImuProblem
    solution: ImuSolution
    poses: GroupFit
    moves: GroupFit
    kept: NDArray[np.intp]
    moves_out: int

    @property
    def student_factor(self) -> float:
        """Factor on variances whose noise was estimated from few residuals; else one."""
        return student_variance(max(self.problem.freedom, 1)) if any(self.problem.extra) else 1.0


def weigh(problem: ImuProblem, solution: ImuSolution, prior: ImuPrior, coordinates: Coordinates) -> Weighed:
    """Leave out poses or movements that spoil the fit, at most a tenth; then add variances until the rest fits.

    A pose or a movement spoils the fit if leaving it out more than halves the reduced chi-square. A bump does so;
    swaying hands do not. A pose takes its movements with it.
    """
    kept, given = np.arange(len(problem.means)), len(problem.before)
    for _ in range(int(_MOST_LEFT_OUT * len(kept))):
        poses, moves = groups(problem, solution)
        misfit = [group.p_value is not None and group.p_value < MISFIT for group in (poses, moves)]
        better = _without_worst(problem, solution, prior, coordinates) if any(misfit) else None
        if better is None:
            break
        problem, solution, pose = better
        if pose is not None:
            kept = np.delete(kept, pose)
    poses, moves = groups(problem, solution)
    done, at = _expanded(problem, solution, poses, moves, prior, coordinates)
    return Weighed(done, at, poses, moves, kept, given - len(done.before))


def _without_worst(
    problem: ImuProblem, solution: ImuSolution, prior: ImuPrior, coordinates: Coordinates
) -> tuple[ImuProblem, ImuSolution, int | None] | None:
    """The fit without the pose or movement that spoils it, and which pose it was; None if no single one does."""
    if problem.freedom < _LEAST_FREEDOM:
        return None
    poses, moves = (np.abs(r).max(axis=1, initial=0.0) for r in (solution.at.poses, solution.at.moves))
    tried: list[tuple[float, ImuProblem, ImuSolution, int | None]] = []
    for pose in np.argsort(poses)[-_SUSPECTS:]:
        fewer = problem.without_pose(int(pose))
        again = solve(
            fewer, solution.x, np.delete(solution.directions, pose, axis=0), prior=prior, coordinates=coordinates
        )
        if again is not None and fewer.freedom > 0:
            tried.append((again.at.cost / fewer.freedom, fewer, again, int(pose)))
    for move in np.argsort(moves)[-_SUSPECTS:]:
        fewer = problem.without_move(int(move))
        again = solve(fewer, solution.x, solution.directions, prior=prior, coordinates=coordinates)
        if again is not None and fewer.freedom > 0:
            tried.append((again.at.cost / fewer.freedom, fewer, again, None))
    best = min(tried, key=lambda t: t[0], default=None)
    if best is None or best[0] > _SPOILT * solution.at.cost / problem.freedom:
        return None
    return best[1:]


def groups(problem: ImuProblem, solution: ImuSolution) -> tuple[GroupFit, GroupFit]:
    """How poses and movements fit the noise that `problem` gives them."""
    used = [_used(problem, solution, group) for group in (_POSES, _MOVES)]
    at = solution.at
    return (
        GroupFit(float((at.poses**2).sum()), at.poses.size - used[0]),
        GroupFit(float((at.moves**2).sum()), at.moves.size - used[1]),
    )


def _used(problem: ImuProblem, solution: ImuSolution, group: int) -> float:
    """How many unknowns a group of residuals determines: ``tr(N^-1 N_group) = d log det N / d log weight``."""
    step = 0.01
    values = []
    for sign in (1.0, -1.0):
        weights = [1.0, 1.0]
        weights[group] = float(np.exp(sign * step))
        at = linearise(problem, solution.x, solution.directions, solution.turns, weights=(weights[0], weights[1]))
        values.append(log_determinant(at))
    return (values[0] - values[1]) / (2.0 * step)


def _expanded(
    problem: ImuProblem,
    solution: ImuSolution,
    poses: GroupFit,
    moves: GroupFit,
    prior: ImuPrior,
    coordinates: Coordinates,
) -> tuple[ImuProblem, ImuSolution]:
    """The problem with the variances that make the groups fit, and its solution.

    The movements come first: their noise is known less well, and a wrong movement distorts the poses at its ends.
    """
    fits = (poses, moves)
    for group in (_MOVES, _POSES, _MOVES):
        p_value = fits[group].p_value
        if p_value is not None and p_value < MISFIT:
            problem, solution = _fitted(problem, solution, group, prior, coordinates)
            fits = groups(problem, solution)
    return problem, solution


def _fitted(
    problem: ImuProblem, solution: ImuSolution, group: int, prior: ImuPrior, coordinates: Coordinates
) -> tuple[ImuProblem, ImuSolution]:
    """The problem with the variance that makes one group's residuals as large as expected."""
    size = _typical_variances(problem)[group]
    for _ in range(_ROUNDS):
        fit = groups(problem, solution)[group]
        factor = fit.chi2 / max(fit.dof, 0.5)
        if abs(factor - 1.0) < _ENOUGH or (factor < 1.0 and problem.extra[group] == 0.0):
            break
        extra = list(problem.extra)
        extra[group] = max(factor * (size + extra[group]) - size, 0.0)
        wider = dataclasses.replace(problem, extra=(extra[0], extra[1]))
        again = solve(wider, solution.x, solution.directions, prior=prior, coordinates=coordinates)
        if again is None:
            break
        problem, solution = wider, again
    return problem, solution


def _typical_variances(problem: ImuProblem) -> tuple[float, float]:
    poses = np.einsum("kii->k", problem.covariances) / 3.0
    moves = np.einsum("kii->k", problem.turn_covariances) / 3.0
    moves = moves + problem.wander[problem.before] + problem.wander[problem.before + 1]
    return float(np.median(poses)), float(np.median(moves)) if len(moves) else 0.0
