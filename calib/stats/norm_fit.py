"""The equation ``|C (m - b)| = g`` on pose means: nine numbers, C symmetric, solved by Gauss and Newton.

Everything here is in units of the poses' own radius, so that C is near the identity and gravity is one. The public fit
is :func:`calib.accel.poses.fit_poses`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavcal.calib.geometry import sphere_of
from mavcal.calib.stats.stillness import PoseMean
from mavcal.calib.triad import Array, TriadModel

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Entries of the symmetric matrix in the order of the parameters, diagonal first."""
NEUTRAL = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""The parameters of a sensor without error."""
UNDETERMINED = 0.02
"""Largest sd of an estimate: of an offset relative to the radius, and of a scale or cross term."""
_CROSS_LEARNT = 0.5  # of the prior's sd: a cross term that the data do not halve stays unknown


@dataclass(frozen=True, eq=False)
class NormProblem:
    """Pose means in units of their radius, so that C is near the identity and gravity is one."""

    means: Array  # (K, 3)
    covariances: Array  # (K, 3, 3)
    radius: float  # sensor units
    centre: Array  # starting value, in radii
    gravity: float
    prior: Array  # (9,) information of the prior on b and the six entries of C

    @classmethod
    def of(cls, poses: Sequence[PoseMean], *, in_si: bool, gravity: float, cross_sd: float | None) -> NormProblem:
        """The problem of `poses`; `in_si`: their radius is `gravity`, else it is estimated from them."""
        means = np.array([pose.mean for pose in poses])
        covariances = np.array([pose.covariance for pose in poses])
        centre, radius = (np.zeros(3), gravity) if in_si else sphere_of(means)
        floor = (1e-9 * radius) ** 2 * np.eye(3)  # exact numbers keep a weight
        prior = np.zeros(9)
        prior[6:] = 0.0 if cross_sd is None else 1.0 / max(cross_sd, 1e-9) ** 2
        return cls(means / radius, (covariances + floor) / radius**2, radius, centre / radius, gravity, prior)


@dataclass(frozen=True, eq=False)
class NormSolution:
    """The result of the iteration: estimate, posterior covariance, and the linearisation there."""

    parameters: Array  # (9,) b, then C in the order of PAIRS
    covariance: Array  # (9, 9)
    jacobian: Array  # (K, 9) of the weighted residuals
    residuals: Array  # (K,) in standard deviations
    lengths: Array  # (K,) |C (m - b)| - 1
    directions: Array  # (K, 3) of the corrected means


def solve(problem: NormProblem, *, weak: bool, held: Sequence[int] = ()) -> NormSolution | None:
    """The solution, or None if the iteration does not converge.

    `weak` adds a prior of one radius to b and of one to the scales. What the poses do not determine then shows as a
    large variance. `held` parameters stay where they start.
    """
    prior = problem.prior.copy()
    if weak:
        prior[:6] = 1.0
    start = np.concatenate([problem.centre, np.ones(3), np.zeros(3)])
    x = start.copy()
    free = [i for i in range(9) if i not in held]
    for _ in range(50):
        J, r, _, _ = _linearised(problem, x)
        information = J.T @ J + np.diag(prior)
        gradient = J.T @ r + prior * (x - start)
        step = newton_step(information, gradient, free)
        if step is None:
            return None
        size = float(np.abs(step).max())
        x = x + step * min(1.0, 0.5 / max(size, 1e-300))
        if size < 1e-13:
            break
    else:
        if size > 1e-9:
            return None
    J, r, lengths, directions = _linearised(problem, x)
    information = J.T @ J + np.diag(prior)
    covariance = np.zeros((9, 9))
    covariance[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    return NormSolution(x, covariance, J, r, lengths, directions)


def _linearised(problem: NormProblem, x: Array) -> tuple[Array, Array, Array, Array]:
    """Weighted Jacobian and residuals of ``|C (m - b)| - 1``, the residuals themselves and the directions."""
    J, lengths, directions, sd = linearised(problem.means - x[:3], x[3:], problem.covariances)
    return J / sd[:, None], lengths / sd, lengths, directions


def newton_step(information: Array, gradient: Array, free: Sequence[int]) -> Array | None:
    """The step of the `free` parameters to the minimum, zero for the others; None: it is not determined."""
    scale = np.sqrt(np.diag(information)[free])
    if not (np.isfinite(information).all() and (scale > 0).all()):
        return None
    sub = information[np.ix_(free, free)] / np.outer(scale, scale)
    if np.linalg.cond(sub) > 1e13:
        return None
    step = np.zeros(len(gradient))
    step[free] = -np.linalg.solve(sub, gradient[free] / scale) / scale
    return step


def linearised(d: Array, c: Array, covariances: Array) -> tuple[Array, Array, Array, Array]:
    """Jacobian (K, 9) of ``|C d| - 1`` by the offset in `d` (K, 3) and by `c`, its value, direction and sd.

    `c` has the entries of C in the order of PAIRS; `covariances` (K, 3, 3) are those of `d`.
    """
    C = symmetric(c)
    corrected = d @ C
    length = np.maximum(np.linalg.norm(corrected, axis=1), 1e-12)
    u = corrected / length[:, None]
    normal = u @ C
    J = np.empty((len(d), 9))
    J[:, :3] = -normal
    for k, (i, j) in enumerate(PAIRS):
        J[:, 3 + k] = u[:, i] * d[:, j] if i == j else u[:, i] * d[:, j] + u[:, j] * d[:, i]
    sd = np.sqrt(np.einsum("ki,kij,kj->k", normal, covariances, normal))
    return J, length - 1.0, u, sd


def symmetric(c: Array) -> Array:
    """C of its entries in the order of PAIRS."""
    return np.array([[c[0], c[3], c[4]], [c[3], c[1], c[5]], [c[4], c[5], c[2]]])


def weighted_along(problem: NormProblem, poses: Sequence[PoseMean], solution: NormSolution) -> NormProblem:
    """The problem with each pose's variance along its own normal, from `solution`."""
    C = symmetric(solution.parameters[3:])
    normals = solution.directions @ C
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    covariances = problem.covariances.copy()
    for k, pose in enumerate(poses):
        if pose.estimate is not None:
            variance = pose.estimate.variance_along(normals[k]) / problem.radius**2 + 1e-18
            covariances[k] = variance * np.eye(3)
    return dataclasses.replace(problem, covariances=covariances)


def unlearnt(problem: NormProblem, solution: NormSolution, cross_sd: float | None) -> list[int]:
    """Cross terms with less information from the poses than from the prior."""
    if cross_sd == 0.0:
        return []
    limit = UNDETERMINED if cross_sd is None else _CROSS_LEARNT * cross_sd
    sd = np.sqrt(np.diag(solution.covariance))
    return [i for i in range(6, 9) if sd[i] > limit]


def without_crosses(problem: NormProblem, solution: NormSolution, crosses: list[int]) -> tuple[Array, Array]:
    """The estimate with unlearnt cross terms at zero; their prior scatter is passed on to the others.

    With ``r = J1 x1 + J2 x2`` and x2 ~ N(0, P), fitting x1 alone errs by ``-H x2``, ``H = F11^-1 F12``.
    """
    if not crosses:
        return solution.parameters, solution.covariance
    held = solve(problem, weak=False, held=crosses)
    if held is None or not problem.prior[crosses].all():
        return solution.parameters, solution.covariance
    rest = [i for i in range(9) if i not in crosses]
    J1, J2 = held.jacobian[:, rest], held.jacobian[:, crosses]
    H = held.covariance[np.ix_(rest, rest)] @ J1.T @ J2
    covariance = held.covariance.copy()
    covariance[np.ix_(rest, rest)] += (H / problem.prior[crosses]) @ H.T
    for axis in range(3):  # |C d| also lengthens by c^2/2 for every cross term c of the axis
        k = sum(axis in PAIRS[i - 3] for i in crosses)
        covariance[3 + axis, 3 + axis] += 0.25 * k * (k + 2) / problem.prior[6] ** 2
    return held.parameters, covariance


def with_neutral(x: Array, covariance: Array, unknown: list[int]) -> tuple[Array, Array]:
    """Estimate and covariance with `unknown` parameters at their neutral values and without variance."""
    x, covariance = x.copy(), covariance.copy()
    x[unknown] = NEUTRAL[unknown]
    covariance[unknown, :] = 0.0
    covariance[:, unknown] = 0.0
    return x, covariance


def model_of(problem: NormProblem, x: Array, covariance: Array, form: str) -> tuple[TriadModel, Array]:
    """The model in sensor units and the covariance over its twelve numbers."""
    scale = np.concatenate([np.full(3, problem.radius), np.full(6, problem.gravity / problem.radius)])
    spread = np.zeros((12, 9))
    spread[:3, :3] = np.eye(3)
    for k, (i, j) in enumerate(PAIRS):
        spread[3 + 3 * i + j, 3 + k] = spread[3 + 3 * j + i, 3 + k] = 1.0
    model = TriadModel(offset=problem.radius * x[:3], matrix=problem.gravity / problem.radius * symmetric(x[3:]))
    if form == "upper":
        spread[3:, 3:] = _upper_fromsymmetric(x[3:])
        model = model.upper_triangular()
    spread = spread * scale
    return model, spread @ covariance @ spread.T


def _upper_fromsymmetric(c: Array) -> Array:
    """Derivative (9, 6) of the upper triangular matrix with the same ``|C x|``, by central differences."""
    columns = []
    for k in range(6):
        h = np.zeros(6)
        h[k] = 1e-6
        ahead, behind = (TriadModel(matrix=symmetric(c + s * h)).upper_triangular().matrix for s in (1.0, -1.0))
        columns.append(((ahead - behind) / 2e-6).ravel())
    return np.column_stack(columns)
