"""The compass of a flight as one least-squares problem: parameters of interest and nuisance parameters.

.. code-block:: text

    y_k = A Q u_k + b + K d_k + noise      u_k = R_k^T h, R_k = exp([delta(t_k)]) R_reference(t_k - delay)

Wanted: the offset b, the symmetric A (the inverse of the soft iron's correction) and the motors' K for the drives d
(current, throttle, outputs). Nuisance parameters are, at every knot, the error delta of the attitude and that of the
gyroscope's offset. The others are the gyroscope's scale; the delay and the blur of the compass; its mounting Q (a small
rotation); the field h; and a tilt of the log's level against the body.

The knots make a block tridiagonal matrix and the others a border of it, so an hour costs no more than its samples.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.mag.flight_path import Path

Array = NDArray[np.float64]

OFFSET, SHAPE = slice(0, 3), slice(3, 9)
SHAPES = np.array(
    [
        [[1, 0, 0], [0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 0, 0], [0, 0, 1]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
        [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    ],
    dtype=np.float64,
)
"""The symmetric matrices (6, 3, 3) of xx, yy, zz, xy, xz, yz."""
NUISANCES = 13  # gyroscope's scale, field (3 each), delay, blur, level (2), mounting (3)
KNOT = 6  # unknowns at a knot: attitude, gyroscope's offset
_ROUNDS = 12
_CONVERGED = 1e-3  # of the sum of squares in standard deviations: a thirtieth of one


@dataclass(frozen=True)
class Layout:
    """Indices of the unknowns, with p drives."""

    drives: int

    @property
    def motor(self) -> slice:
        """K (3, p) by columns: x y z of the first drive first."""
        return slice(9, 9 + 3 * self.drives)

    @property
    def scale(self) -> slice:
        """Scale factor of the gyroscope, less one."""
        return self._after(0, 3)

    @property
    def field(self) -> slice:
        """North, east, down in the unit of the samples."""
        return self._after(3, 6)

    @property
    def delay(self) -> slice:
        """Delay of the compass against the gyroscope, s."""
        return self._after(6, 7)

    @property
    def blur(self) -> slice:
        """Blur of the compass in addition to its averaging, s2: half the variance of the averaging window."""
        return self._after(7, 8)

    @property
    def level(self) -> slice:
        """Tilt of the log's attitude about the body's x and y, rad."""
        return self._after(8, 10)

    @property
    def mounting(self) -> slice:
        """Mounting of the compass in the body, rad: ``Q = exp([mounting])``."""
        return self._after(10, 13)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return 9 + 3 * self.drives + NUISANCES

    def _after(self, first: int, last: int) -> slice:
        start = 9 + 3 * self.drives
        return slice(start + first, start + last)


@dataclass(frozen=True, eq=False)
class FlightPrior:
    """Prior of the unknowns: `mean` and `sd` (G,); sd 0 fixes one, inf is no prior."""

    mean: Array
    sd: Array
    start_sd: Array
    """Prior sd (6,) at the first knot: attitude about north, east and down, rad (inf: from the log's attitude alone),
    then the gyroscope's offset about zero, rad/s."""


@dataclass(frozen=True, eq=False)
class Flight:
    """Samples `y` (N, 3) of a compass in body axes, drives `d` (N, p), the noise's `variance` (N,) and weights (N,)."""

    y: Array
    drives: Array
    path: Path
    variance: Array
    weights: Array


@dataclass(frozen=True, eq=False)
class FlightSolution:
    """Unknowns `x` (G,) with their covariance (G, G), knots (J, 6), residuals (N, 3)."""

    x: Array
    covariance: Array
    knots: Array
    residuals: Array
    cost: float


def solve(flight: Flight, prior: FlightPrior, start: Array, knots: Array | None = None) -> FlightSolution:
    """The most likely unknowns, by Gauss-Newton from `start` (G,).

    Raises
    ------
    UndeterminedError
        If data and prior leave an unknown undetermined.
    """
    x = start.copy()
    knots = np.zeros((flight.path.knots, KNOT)) if knots is None else knots.copy()
    cost = _cost(flight, prior, x, knots)
    for _ in range(_ROUNDS):
        normal = _normal(flight, prior, x, knots)
        dx, dknots = normal.step()
        for shrink in (1.0, 0.5, 0.1, 0.0):
            if shrink == 0.0:
                break
            tried = x + shrink * dx, knots + shrink * dknots
            new = _cost(flight, prior, *tried)
            if new <= cost * (1.0 + 1e-12):
                break
        done = shrink == 0.0 or cost - new <= _CONVERGED
        if shrink > 0.0:
            (x, knots), cost = tried, new
        if done:
            break
    covariance = _normal(flight, prior, x, knots).covariance()
    return FlightSolution(x, covariance, knots, flight.y - predicted(flight, x, knots), cost)


def predicted(flight: Flight, x: Array, knots: Array) -> Array:
    """Predicted readings of the compass (N, 3)."""
    return _Model.of(flight, x, knots).reading(flight, x)


@dataclass(frozen=True, eq=False)
class _Model:
    """The field in the body at the compass, and its components."""

    turned: Array  # (N, 3): field turned by the attitude's error, north-east-down
    back: Array  # (N, 3, 3): exp(-delta)
    met: Array  # (N, 3): field in the body as the compass meets it
    by_delay: Array
    by_blur: Array
    mounted: Array
    layout: Layout
    matrix: Array

    @classmethod
    def of(cls, flight: Flight, x: Array, knots: Array) -> _Model:
        path, layout = flight.path, Layout(flight.drives.shape[1])
        f = path.fraction[:, None]
        delta = (1.0 - f) * knots[path.left, :3] + f * knots[path.left + 1, :3]
        back = np.asarray(Rotation.from_rotvec(-delta).as_matrix())
        turned = back @ x[layout.field]
        still = np.einsum("nji,nj->ni", path.rotations, turned)
        by_delay = np.cross(path.rates, still)
        by_blur = np.einsum("nji,nj->ni", path.bends, turned)
        seen = still + x[layout.delay] * by_delay + x[layout.blur] * by_blur
        mounted = np.asarray(Rotation.from_rotvec(x[layout.mounting]).as_matrix())
        met = seen @ mounted.T
        return cls(turned, back, met, by_delay, by_blur, mounted, layout, np.einsum("k,kij->ij", x[SHAPE], SHAPES))

    def reading(self, flight: Flight, x: Array) -> Array:
        motor = x[self.layout.motor].reshape(-1, 3)
        return np.asarray(self.met @ self.matrix.T + x[OFFSET] + flight.drives @ motor)


def _process(path: Path, x: Array, knots: Array, layout: Layout) -> tuple[Array, Array]:
    """Residuals of the gyroscope from knot to knot (J - 1, 3), and of the walk of its offset (J - 1, 3)."""
    mean = 0.5 * (knots[1:, 3:] + knots[:-1, 3:])
    expected = path.by_scale @ x[layout.scale] - np.einsum("nij,nj->ni", path.by_bias, mean)
    return np.diff(knots[:, :3], axis=0) - expected, np.diff(knots[:, 3:] + path.bias, axis=0)


def _attitude(path: Path, x: Array, knots: Array, layout: Layout) -> Array:
    """Residuals of the log's attitude (J, 3)."""
    return np.asarray(path.observed - knots[:, :3] - path.knot_rotations[:, :, :2] @ x[layout.level])


def _inverse_square(sd: Array) -> Array:
    with np.errstate(divide="ignore"):
        information = 1.0 / sd**2
    return np.where(np.isfinite(information), information, 0.0)


def _cost(flight: Flight, prior: FlightPrior, x: Array, knots: Array) -> float:
    layout, path = Layout(flight.drives.shape[1]), flight.path
    r = flight.y - predicted(flight, x, knots)
    cost = float(((flight.weights / flight.variance)[:, None] * r**2).sum())
    turned, wandered = _process(path, x, knots, layout)
    cost += float((turned**2 / path.variance[:, None]).sum() + (wandered**2 / path.wander[:, None]).sum())
    cost += float((path.information * _attitude(path, x, knots, layout) ** 2).sum())
    cost += float((_inverse_square(prior.sd) * (x - prior.mean) ** 2).sum())
    return cost + float((_inverse_square(prior.start_sd) * _first(path, knots) ** 2).sum())


def _first(path: Path, knots: Array) -> Array:
    """Attitude's error and gyroscope's offset (6,) at the first knot."""
    return np.asarray(knots[0] + np.concatenate([np.zeros(3), path.bias[0]]))


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations: knots (diagonal and upper blocks), border, others; `free` (G,) are not held fixed."""

    diagonal: Array  # (J, 6, 6)
    upper: Array  # (J - 1, 6, 6)
    border: Array  # (J, 6, G)
    inner: Array  # (G, G)
    right_knots: Array  # (J, 6)
    right: Array  # (G,)
    free: NDArray[np.bool_]

    def _eliminated(self) -> tuple[Array, Array, Array]:
        """Schur complement of the knots, its right side, and the solutions for the knots."""
        border = self.border.reshape(-1, self.border.shape[2])[:, self.free]
        sides = np.column_stack([border, self.right_knots.ravel()])
        try:
            factor = cholesky_banded(_banded(self.diagonal, self.upper), lower=False)
        except np.linalg.LinAlgError as error:
            raise UndeterminedError(
                "the attitude during the flight is not determined", remedy="record gyroscope and attitude"
            ) from error
        inside = cho_solve_banded((factor, False), sides)
        schur = self.inner[np.ix_(self.free, self.free)] - border.T @ inside[:, :-1]
        return schur, self.right[self.free] - border.T @ inside[:, -1], inside

    def step(self) -> tuple[Array, Array]:
        schur, side, inside = self._eliminated()
        dx = np.zeros(len(self.free))
        dx[self.free] = _inverse(schur) @ side
        return dx, (inside[:, -1] - inside[:, :-1] @ dx[self.free]).reshape(-1, KNOT)

    def covariance(self) -> Array:
        full = np.zeros((len(self.free), len(self.free)))
        full[np.ix_(self.free, self.free)] = _inverse(self._eliminated()[0])
        return full


def _inverse(information: Array) -> Array:
    """Inverse of a symmetric positive matrix, scaled first."""
    scale = np.sqrt(np.clip(np.diag(information), 1e-300, None))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] < 1e-13 * values[-1]:
        raise UndeterminedError(
            "the flight leaves an unknown of the compass entirely open", remedy="turn on the spot, climb and bank"
        )
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def _banded(diagonal: Array, upper: Array) -> Array:
    """Upper banded form (12, 6 J) of a block tridiagonal matrix."""
    last = 2 * KNOT - 1
    banded = np.zeros((last + 1, KNOT * len(diagonal)))
    for i in range(KNOT):
        for j in range(KNOT):
            if j >= i:
                banded[last + i - j, j::KNOT] = diagonal[:, i, j]
            banded[last - KNOT + i - j, KNOT + j :: KNOT] = upper[:, i, j]
    return banded


def _cross_matrices(v: Array) -> Array:
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _normal(flight: Flight, prior: FlightPrior, x: Array, knots: Array) -> _Normal:
    path, layout = flight.path, Layout(flight.drives.shape[1])
    by_delta, by_others, residuals = _derivatives(flight, x, knots)
    count, size = path.knots, layout.size
    diagonal, upper = np.zeros((count, KNOT, KNOT)), np.zeros((count - 1, KNOT, KNOT))
    border, right_knots = np.zeros((count, KNOT, size)), np.zeros((count, KNOT))
    scaled = (flight.weights / flight.variance)[:, None, None]
    shares = ((0, 1.0 - path.fraction), (1, path.fraction))
    spans, begins = np.unique(path.left, return_index=True)
    square = np.swapaxes(by_delta, 1, 2) @ (scaled * by_delta)
    beside = np.swapaxes(by_delta, 1, 2) @ (scaled * by_others)
    side = np.einsum("nij,ni->nj", by_delta, scaled[:, :, 0] * residuals)
    for shift, share in shares:  # the samples are in order of time, so those of a span follow one another
        knot = spans + shift
        diagonal[knot, :3, :3] += np.add.reduceat(share[:, None, None] ** 2 * square, begins)
        border[knot, :3] += np.add.reduceat(share[:, None, None] * beside, begins)
        right_knots[knot, :3] += np.add.reduceat(share[:, None] * side, begins)
    upper[spans, :3, :3] += np.add.reduceat((path.fraction * (1.0 - path.fraction))[:, None, None] * square, begins)
    flat = by_others.reshape(-1, size)
    weighted = (np.broadcast_to(scaled, by_others.shape) * by_others).reshape(-1, size)
    normal = _Normal(
        diagonal, upper, border, weighted.T @ flat, right_knots, weighted.T @ residuals.ravel(), prior.sd > 0.0
    )
    _add_process(normal, path, x, knots, layout)
    _add_attitude(normal, path, x, knots, layout)
    normal.inner[np.diag_indices(size)] += _inverse_square(prior.sd)
    normal.right[:] += _inverse_square(prior.sd) * (prior.mean - x)
    normal.diagonal[0][np.diag_indices(KNOT)] += _inverse_square(prior.start_sd)
    normal.right_knots[0] -= _inverse_square(prior.start_sd) * _first(path, knots)
    return normal


def _derivatives(flight: Flight, x: Array, knots: Array) -> tuple[Array, Array, Array]:
    """Derivatives of the reading by attitude error (N, 3, 3) and the others (N, 3, G), and the residuals (N, 3)."""
    model, path = _Model.of(flight, x, knots), flight.path
    layout, count = model.layout, len(flight.y)
    delayed = np.eye(3) + x[layout.delay][0] * _cross_matrices(path.rates)
    turned = model.matrix @ model.mounted
    through = turned @ delayed @ np.swapaxes(path.rotations, 1, 2)
    by_delta = through @ _cross_matrices(model.turned)
    by_others = np.zeros((count, 3, layout.size))
    by_others[:, :, OFFSET] = np.eye(3)
    by_others[:, :, SHAPE] = np.einsum("kij,nj->nik", SHAPES, model.met)
    eyes = flight.drives[:, :, None, None] * np.eye(3)
    by_others[:, :, layout.motor] = np.moveaxis(eyes, 1, 2).reshape(count, 3, -1)
    by_others[:, :, layout.field] = through @ model.back
    by_others[:, :, layout.delay] = (model.by_delay @ turned.T)[:, :, None]
    by_others[:, :, layout.blur] = (model.by_blur @ turned.T)[:, :, None]
    by_others[:, :, layout.mounting] = -model.matrix @ _cross_matrices(model.met)
    return by_delta, by_others, flight.y - model.reading(flight, x)


def _add_process(normal: _Normal, path: Path, x: Array, knots: Array, layout: Layout) -> None:
    """``delta_j+1 - delta_j + by_bias (beta_j + beta_j+1)/2 - by_scale scale = 0``, and beta hardly changes."""
    count = len(path.variance)
    turned, wandered = _process(path, x, knots, layout)
    before, after = np.zeros((count, 6, KNOT)), np.zeros((count, 6, KNOT))
    before[:], after[:] = -np.eye(6), np.eye(6)
    before[:, :3, 3:] = after[:, :3, 3:] = 0.5 * path.by_bias
    rows = np.zeros((count, 6, layout.size))
    rows[:, :3, layout.scale] = -path.by_scale
    miss = np.concatenate([turned, wandered], axis=1)
    weight = np.repeat(np.column_stack([1.0 / path.variance, 1.0 / path.wander]), 3, axis=1)[:, :, None]
    for part, first, last in ((before, 0, count), (after, 1, count + 1)):
        side = np.swapaxes(part, 1, 2)
        normal.diagonal[first:last] += side @ (weight * part)
        normal.border[first:last] += side @ (weight * rows)
        normal.right_knots[first:last] -= np.einsum("nij,ni->nj", part, weight[:, :, 0] * miss)
    normal.upper[:] += np.swapaxes(before, 1, 2) @ (weight * after)
    normal.inner[:] += np.einsum("nij,nik->jk", weight * rows, rows)
    normal.right[:] -= np.einsum("nij,ni->j", rows, weight[:, :, 0] * miss)


def _add_attitude(normal: _Normal, path: Path, x: Array, knots: Array, layout: Layout) -> None:
    """``observed = delta + R level``."""
    information = path.information
    rows = np.zeros((path.knots, 3, layout.size))
    rows[:, :, layout.level] = path.knot_rotations[:, :, :2]
    miss = _attitude(path, x, knots, layout)
    normal.diagonal[:, range(3), range(3)] += information
    weighted = information[:, :, None] * rows
    normal.border[:, :3] += weighted
    normal.inner[:] += np.einsum("nij,nik->jk", weighted, rows)
    normal.right_knots[:, :3] += information * miss
    normal.right[:] += np.einsum("nij,ni->j", weighted, miss)


def without(flight: Flight, rows: NDArray[np.bool_]) -> Flight:
    """The flight without compass samples in `rows`; the gyroscope propagates the attitude through them."""
    return dataclasses.replace(flight, weights=np.where(rows, 0.0, flight.weights))
