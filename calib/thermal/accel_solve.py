"""The solver of :mod:`calib.thermal.accel`: gravity's length between poses, and the drift within them.

Everything here is in units of the poses' radius and in powers of a scaled temperature. The parameters are the offset
(3), the six entries of the symmetric matrix, and the drift power by power (degree x 3).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.accel.poses import missing_faces
from mavcal.calib.geometry import sphere_of
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.correlated import long_run_variance
from mavcal.calib.stats.norm_fit import UNDETERMINED, linearised, newton_step
from mavcal.calib.stats.stillness import PoseMean, Still

_NO_DRIFT = 0.005  # of a radius over half the span: a larger sd is no drift
_WEAK = 1.0  # radii: prior under which what the poses do not determine shows
_WITHIN_LEAST = 64  # samples of all poses that tell the drift within them
_MOVED = 0.02  # of the span: a pose through which the temperature moved less shows a hand's sway and no drift
_ITERATIONS = 60


@dataclass(frozen=True, eq=False)
class WarmPose:
    """A still pose: its mean (3,), and the mean powers (degree,) of the scaled temperature during it."""

    pose: PoseMean
    powers: Array


@dataclass(frozen=True, eq=False)
class WithinPoses:
    """Drift that shows within poses, of `n` samples: coefficients (degree, 3) of the scaled powers, and information
    (3, degree, degree) of each axis; zero where nothing shows.
    """

    coefficients: Array
    information: Array
    n: int


@dataclass(frozen=True, eq=False)
class WarmProblem:
    """In units of the poses' radius. Parameters: b (3), C (6, as PAIRS), p (degree x 3, power by power)."""

    means: Array  # (K, 3)
    covariances: Array  # (K, 3, 3)
    powers: Array  # (K, degree)
    within: WithinPoses
    radius: float
    start: Array
    prior: Array  # (n,) information about `start`

    @property
    def degree(self) -> int:
        """Degree of the drift."""
        return int(self.powers.shape[1])


@dataclass(frozen=True, eq=False)
class WarmSolution:
    """End of the iteration: estimate, posterior covariance, and the linearisation there."""

    parameters: Array
    covariance: Array
    residuals: Array  # (K,) in standard deviations
    lengths: Array
    directions: Array
    information: Array


@dataclass(frozen=True, eq=False)
class AccelThermalSolution:
    """The solution, that under a weak prior, and the indices of the parameters that are then undetermined."""

    warm: tuple[WarmPose, ...]
    problem: WarmProblem
    weak: WarmSolution
    solution: WarmSolution
    unknown: tuple[int, ...]


def within_poses(accel: Channel, x: Array, stills: Sequence[Still], degree: int) -> WithinPoses:
    """Least squares of the drift with one constant a pose, by the noise that is left in the residuals.

    Serial correlation widens it. Poses with hardly any change of temperature are left out: they would only show hand
    sway.
    """
    rows_x, rows_y, count = [], [], 0
    spread = float(np.ptp(x)) or 1.0
    for still in stills:
        i, j = np.searchsorted(accel.t, (still.start, still.end))
        if j - i < 16 or np.ptp(x[i:j]) < _MOVED * spread:
            continue
        powers = x[i:j, None] ** np.arange(1, degree + 1)
        rows_x.append(powers - powers.mean(axis=0))
        rows_y.append(accel.values[i:j] - accel.values[i:j].mean(axis=0))
        count += 1
    nothing = WithinPoses(np.zeros((degree, 3)), np.zeros((3, degree, degree)), 0)
    if not rows_x:
        return nothing
    X, Y = np.concatenate(rows_x), np.concatenate(rows_y)
    gram = X.T @ X
    if len(X) < max(_WITHIN_LEAST, 4 * (count + degree)) or np.linalg.cond(gram) > 1e10:
        return nothing
    coefficients = np.linalg.solve(gram, X.T @ Y)
    residual = Y - X @ coefficients
    freedom = len(X) / (len(X) - count - degree)
    variance = np.array([max(long_run_variance(residual[:, i]) * freedom, 1e-24) for i in range(3)])
    return WithinPoses(coefficients, gram / variance[:, None, None], len(X))


def solve_poses(
    warm: Sequence[WarmPose], within: WithinPoses, *, in_si: bool, gravity: float, cross_sd: float | None
) -> AccelThermalSolution | str:
    """Offset, matrix and drift from poses; or why there are none."""
    means = np.array([w.pose.mean for w in warm])
    if not np.isfinite(means).all():
        return "a pose's mean is not finite: leave that pose out"
    centre, radius = (np.zeros(3), gravity) if in_si else sphere_of(means)
    lengths = np.linalg.norm(means - centre, axis=1)
    if not (0.5 * radius < lengths.min() and lengths.max() < 2.0 * radius):
        return (
            f"readings of {lengths.min():.3g} to {lengths.max():.3g} are not gravity ({radius:.3g}): check the unit, "
            "or the sensor is broken"
        )
    problem = _problem(warm, within, centre, radius, cross_sd)
    weak = _solve(problem, weak=True)
    if weak is None:
        return "the poses do not lie on one sphere: check the unit, and that every pose was still"
    problem = _weighted_along(problem, warm, weak)
    weak = _solve(problem, weak=True)
    if weak is None:
        return "the poses do not lie on one sphere: check the unit, and that every pose was still"
    sd = np.sqrt(np.diag(weak.covariance))
    limit = np.where(np.arange(len(sd)) < 9, UNDETERMINED, _NO_DRIFT)
    unknown = tuple(i for i in range(len(sd)) if sd[i] > limit[i] and not 6 <= i < 9)
    if all(i in unknown for i in range(3)):
        return f"{len(warm)} poses determine no axis: {missing_faces(weak.directions)}"
    crosses = _unlearnt(sd, cross_sd)
    solution = _solve(problem, weak=bool(unknown), held=crosses)
    if solution is None:
        return "the fit of the poses did not converge: hold more poses, and each of them longer"
    return AccelThermalSolution(tuple(warm), problem, weak, solution, (*unknown, *crosses))


def _unlearnt(sd: Array, cross_sd: float | None) -> tuple[int, ...]:
    """Cross terms with less than half as much information from the poses as from the prior."""
    if cross_sd == 0.0:
        return (6, 7, 8)
    limit = UNDETERMINED if cross_sd is None else 0.5 * cross_sd
    return tuple(i for i in range(6, 9) if sd[i] > limit)


def _problem(
    warm: Sequence[WarmPose], within: WithinPoses, centre: Array, radius: float, cross_sd: float | None
) -> WarmProblem:
    degree = len(within.coefficients)
    covariances = np.array([w.pose.covariance for w in warm]) + (1e-9 * radius) ** 2 * np.eye(3)
    start = np.concatenate([centre / radius, np.ones(3), np.zeros(3 + 3 * degree)])
    prior = np.zeros(len(start))
    prior[6:9] = 0.0 if cross_sd is None else 1.0 / max(cross_sd, 1e-9) ** 2
    scaled = WithinPoses(within.coefficients / radius, within.information * radius**2, within.n)
    means = np.array([w.pose.mean for w in warm]) / radius
    powers = np.array([w.powers for w in warm])
    return WarmProblem(means, covariances / radius**2, powers, scaled, radius, start, prior)


def _linearised(problem: WarmProblem, x: Array) -> tuple[Array, Array, Array, Array]:
    """Weighted Jacobian and residuals of ``|C (m - b - p)| - 1``, the residuals themselves and the directions."""
    d = problem.means - x[:3] - problem.powers @ x[9:].reshape(problem.degree, 3)
    of_pose, lengths, directions, sd = linearised(d, x[3:9], problem.covariances)
    of_drift = (problem.powers[:, :, None] * of_pose[:, None, :3]).reshape(len(d), -1)
    return np.hstack([of_pose, of_drift]) / sd[:, None], lengths / sd, lengths, directions


def _solve(problem: WarmProblem, *, weak: bool, held: Sequence[int] = ()) -> WarmSolution | None:
    """Gauss and Newton from a sensor without error; None if it does not converge.

    `weak` adds a prior of one radius, so that undetermined parameters get a large variance.
    """
    prior, start = problem.prior.copy(), problem.start
    if weak:
        prior[:6] += 1.0 / _WEAK**2
        prior[9:] += 1.0 / _WEAK**2
    inner, target = within_information(problem)
    free = [i for i in range(len(start)) if i not in held]
    x = start.copy()
    size = np.inf
    for _ in range(_ITERATIONS):
        J, r, _, _ = _linearised(problem, x)
        information = J.T @ J + np.diag(prior) + inner
        gradient = J.T @ r + prior * (x - start) + inner @ (x - target)
        step = newton_step(information, gradient, free)
        if step is None:
            return None
        size = float(np.abs(step).max())
        x = x + step * min(1.0, 0.5 / max(size, 1e-300))
        if size < 1e-12:
            break
    if size > 1e-8:
        return None
    J, r, lengths, directions = _linearised(problem, x)
    information = J.T @ J + np.diag(prior) + inner
    covariance = np.zeros_like(information)
    covariance[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    return WarmSolution(x, covariance, r, lengths, directions, information)


def within_information(problem: WarmProblem) -> tuple[Array, Array]:
    """Information (n, n) of the drift within poses, and the corresponding parameters."""
    size = len(problem.start)
    information, target = np.zeros((size, size)), problem.start.copy()
    for axis in range(3):
        rows = 9 + axis + 3 * np.arange(problem.degree)
        information[np.ix_(rows, rows)] = problem.within.information[axis]
        target[rows] = problem.within.coefficients[:, axis]
    return information, target


def _weighted_along(problem: WarmProblem, warm: Sequence[WarmPose], solution: WarmSolution) -> WarmProblem:
    """The problem with each pose's variance along its own normal, which excludes hand sway."""
    covariances = problem.covariances.copy()
    for k, w in enumerate(warm):
        if w.pose.estimate is not None:
            normal = solution.directions[k]
            covariances[k] = (w.pose.estimate.variance_along(normal) / problem.radius**2 + 1e-18) * np.eye(3)
    return dataclasses.replace(problem, covariances=covariances)


def confounding(problem: WarmProblem, solution: WarmSolution) -> float:
    """Largest ratio of a drift term's sd to that with every direction at every temperature."""
    J, _, _, _ = _linearised(problem, solution.parameters)
    K = len(J)
    rest = solution.information - J.T @ J  # priors, and the drift within poses
    crossed = np.concatenate([J[:, :9].repeat(K, axis=0), _drift_columns(problem, J)], axis=1) / np.sqrt(K)
    drift = np.arange(9, J.shape[1])
    free = [i for i in range(J.shape[1]) if solution.covariance[i, i] > 0.0]
    ideal = np.diag(np.linalg.inv((crossed.T @ crossed + rest)[np.ix_(free, free)]))[-len(drift) :]
    return float(np.sqrt((np.diag(solution.covariance)[drift] / ideal).max()))


def _drift_columns(problem: WarmProblem, J: Array) -> Array:
    """Columns (K K, 3 degree) of the drift with every direction at every pose's temperature."""
    return np.asarray(np.einsum("ka,jd->kjda", J[:, :3], problem.powers).reshape(len(J) ** 2, -1))


def scale_drift(problem: WarmProblem, solution: WarmSolution) -> tuple[Array, Array]:
    """Change of each axis' scale by a scaled temperature of one, and its covariance (3, 3): one step from `solution`.

    ``M (1 + x S) g``, S diagonal: no autopilot stores it, so it is only a test, not part of the model.
    """
    J, r, _, _ = _linearised(problem, solution.parameters)
    d = problem.means - solution.parameters[:3] - problem.powers @ solution.parameters[9:].reshape(problem.degree, 3)
    extra = J[:, :3] * d * problem.powers[:, :1]
    cross = extra.T @ J
    information = extra.T @ extra - cross @ solution.covariance @ cross.T
    covariance = np.asarray(np.linalg.inv(information + np.eye(3)))  # a prior of one keeps what no pose tells finite
    return -covariance @ extra.T @ r, covariance
