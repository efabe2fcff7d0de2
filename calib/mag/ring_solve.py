"""From rings to the offset and the columns of a magnetometer's matrix, outliers left out (METHODS S3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UndeterminedError
from mavcal.calib.mag.ring_centres import FEWEST_OF_CIRCLE, Centre, Circle, Ring, centre_of, fit_circle, is_round
from mavcal.calib.mag.robust import MAD_TO_SD, MOST_OUTLIERS, OUTLIER
from mavcal.calib.mag.serial import variance_inflation

Array = NDArray[np.float64]

_ROUNDS = 4  # of centres and matrix: each makes the circles rounder by the square of what was wrong
_SETTLED = 1e-12
_TRIMS = 6
_SPIKE = 4.0  # of the median distance from the middle of a ring, beyond which no turn and no noise goes
_MOST_CONDITION = 20.0  # of the columns: a matrix beyond it is noise, or no compass


@dataclass(frozen=True, eq=False)
class RingsFit:
    """Offset and columns from the ring centres, with covariance and diagnostics, in the unit of the samples."""

    rings: tuple[Ring, ...]
    way: str
    centres: Array
    """(K, 3)."""
    covariance: Array
    """(3 K, 3 K) of the centres."""
    offset: Array
    columns: Array
    """(3, 3): V, whose columns are ``F sin d A e_i``."""
    circles: tuple[Circle | None, ...]
    residuals: Array
    """(N, 2): distances from plane and circle."""
    dof: int
    noise_sd: float | None
    """Noise of one axis of a sample; None: the rings have too few samples to tell."""
    variance_inflation: float
    uneven: tuple[int, ...]
    fixture_sd: float

    @property
    def faces(self) -> Array:
        """Signed unit vectors (K, 3): which axis pointed down."""
        return np.array([ring.down for ring in self.rings])

    @property
    def closure(self) -> Array:
        """Residuals (K, 3) of the ring centres: how far the midpoints of the three pairs disagree."""
        return np.asarray(self.centres - self.offset - self.faces @ self.columns.T, dtype=np.float64)

    def residuals_by_ring(self) -> list[Array]:
        """The rows of `residuals` of every ring; none for a ring without a circle."""
        found, first = [], 0
        for ring, circle in zip(self.rings, self.circles, strict=True):
            count = 0 if circle is None else len(ring.samples)
            found.append(self.residuals[first : first + count])
            first += count
        return found

    @property
    def n_used(self) -> int:
        """Samples that are not outliers."""
        return sum(len(ring.samples) for ring in self.rings)

    def weakest_column(self) -> float:
        """Standard deviation of the columns over their smallest singular value."""
        solve = centres_inverse(self.faces)[1:]
        spread = np.einsum("ak,kilj,al->aij", solve, self._blocks(), solve)
        worst = max(float(np.linalg.eigvalsh(block)[-1]) for block in spread)
        return math.sqrt(max(worst, 0.0)) / max(float(np.linalg.svd(self.columns, compute_uv=False)[-1]), 1e-300)

    def offset_covariance(self) -> Array:
        """(3, 3)."""
        solve = centres_inverse(self.faces)[0]
        return np.asarray(np.einsum("k,kilj,l->ij", solve, self._blocks(), solve), dtype=np.float64)

    def chi2(self) -> tuple[float, int]:
        """Disagreement of the centres in units of their covariance, and the degrees of freedom."""
        count = len(self.rings)
        values, vectors = np.linalg.eigh(
            np.eye(count) - np.column_stack([np.ones(count), self.faces]) @ centres_inverse(self.faces)
        )
        basis = vectors[:, values > 0.5]
        r = (basis.T @ self.closure).ravel()
        size = len(r)
        spread = np.einsum("kp,kilj,lq->piqj", basis, self._blocks(), basis).reshape(size, size)
        floor = (1e-9 * float(np.abs(self.columns).max())) ** 2 * np.eye(size)
        return float(r @ np.linalg.solve(spread + floor, r)), size

    def _blocks(self) -> Array:
        count = len(self.rings)
        return self.covariance.reshape(count, 3, count, 3)


def columns_of(centres: Array, faces: Array) -> tuple[Array, Array]:
    """Offset b (3,) and matrix ``V = [v1 v2 v3]`` (3, 3) by least squares of ``c = b + V k`` (with six: the means).

    >>> v = np.array([[11.0, 4.0, 3.0], [2.0, 10.0, 1.0], [3.0, 4.0, 12.0]])
    >>> centres = np.array([120.0, 20.0, 30.0]) + np.vstack([v, -v])
    >>> columns_of(centres, np.vstack([np.eye(3), -np.eye(3)]))[1].round(9)
    array([[11.,  2.,  3.],
           [ 4., 10.,  4.],
           [ 3.,  1., 12.]])
    """
    solution = centres_inverse(faces) @ centres
    return solution[0], solution[1:].T


def centres_inverse(faces: Array) -> Array:
    """The (4, K) matrix that takes the centres (K, 3) to offset and columns, row by row."""
    return np.asarray(np.linalg.pinv(np.column_stack([np.ones(len(faces)), faces])), dtype=np.float64)


def by_dominant(columns: Array) -> Array:
    """`columns` (3, 3), each divided by its largest component, as published; this loses the scale of each axis.

    >>> by_dominant(np.array([[11.0, 2.0, 3.0], [4.0, 10.0, 4.0], [3.0, 1.0, 12.0]]))[1].round(9)
    array([0.36363636, 1.        , 0.33333333])
    """
    largest = columns[np.abs(columns).argmax(axis=0), np.arange(3)]
    return np.asarray(columns / largest, dtype=np.float64)


def published(samples: Array, offset: Array, columns: Array, diameter: float) -> tuple[Array, Array]:
    """The published correction: matrix ``K D^-1`` (3, 3) and gains k (3,).

    D are the columns by their dominant components, and ``k_i = diameter / (max_i - min_i)`` of ``D^-1 (m - b)``.
    """
    inverse = np.linalg.inv(by_dominant(columns))
    gains = diameter / np.ptp((samples - offset) @ inverse.T, axis=0)
    return gains[:, None] * inverse, gains


def solve_rings(rings: Sequence[Ring], way: str, fixture_sd: float) -> RingsFit:
    """The fit of the samples that are within :data:`OUTLIER` standard deviations of their own ring.

    Raises
    ------
    UndeterminedError
        If too many are not.
    """
    given = sum(len(ring.samples) for ring in rings)
    rings = [Ring(_without_spikes(ring.samples), ring.down) for ring in rings]
    for _ in range(_TRIMS):
        fit = _solved(rings, way, fixture_sd)
        kept = [_inside(rows) for rows in fit.residuals_by_ring()]
        if all(k.all() for k in kept):
            break
        rings = [Ring(r.samples[k], r.down) if len(k) else r for r, k in zip(rings, kept, strict=True)]
    left = sum(len(ring.samples) for ring in rings)
    if left < (1.0 - MOST_OUTLIERS) * given:
        raise UndeterminedError(
            f"{given - left} of {given} magnetometer samples lie off their rings",
            remedy="find what disturbs the field (motors, steel, a phone nearby), turn steadily, and repeat",
        )
    return fit


def _without_spikes(samples: Array) -> Array:
    """The samples without spikes far from the middle of the ring."""
    if len(samples) < FEWEST_OF_CIRCLE:
        return samples
    far = np.linalg.norm(samples - np.median(samples, axis=0), axis=1)
    return np.asarray(samples[far <= _SPIKE * np.median(far)])


def _inside(residuals: Array) -> NDArray[np.bool_]:
    """Mask (N, 2) of the rows that are no outliers: none where the ring has no circle."""
    if not len(residuals):
        return np.zeros(0, dtype=np.bool_)
    sd = MAD_TO_SD * np.median(np.abs(residuals), axis=0)
    quiet = np.maximum(sd, 1e-9 * np.abs(residuals).max())
    return np.asarray((np.abs(residuals) <= OUTLIER * np.maximum(quiet, quiet.max() / 3.0)).all(axis=1))


def _solved(rings: Sequence[Ring], way: str, fixture_sd: float) -> RingsFit:
    faces = np.array([ring.down for ring in rings])
    matrix: Array = np.eye(3)
    noise_sd = 0.0
    for _ in range(_ROUNDS):
        circles, noise_sd = _circles(rings, matrix, noise_sd)
        centres = [centre_of(r, way, matrix, c, noise_sd) for r, c in zip(rings, circles, strict=True)]
        offset, columns = columns_of(np.array([c.value for c in centres]), faces)
        if not np.linalg.cond(columns) < _MOST_CONDITION:
            break
        before, matrix = matrix, np.asarray(np.linalg.inv(columns), dtype=np.float64)
        if np.linalg.norm(matrix @ np.linalg.inv(before) - np.eye(3)) < _SETTLED:
            break
    residuals, dof = _residuals(rings, circles, matrix)
    inflation = 1.0
    if way in {"circle", "mean", "thinned"} and len(residuals):
        inflation = max(variance_inflation(residuals[:, 0]), variance_inflation(residuals[:, 1]))
    values = np.array([c.value for c in centres])
    closure = values - offset - faces @ columns.T
    return RingsFit(
        rings=tuple(rings),
        way=way,
        centres=values,
        covariance=_covariance(centres, faces, columns, closure, noise_sd**2 * inflation if dof else None, fixture_sd),
        offset=offset,
        columns=columns,
        circles=tuple(circles),
        residuals=residuals,
        dof=dof,
        noise_sd=noise_sd if dof else None,
        variance_inflation=inflation,
        uneven=tuple(j for j, c in enumerate(centres) if c.surprise.any()),
        fixture_sd=fixture_sd,
    )


def _circles(rings: Sequence[Ring], matrix: Array, noise_sd: float) -> tuple[list[Circle | None], float]:
    """Circles of all rings, None for undetermined ones, and the noise of one axis of a sample."""
    found = [fit_circle(ring.samples @ matrix.T, ring.down) for ring in rings]
    residuals, dof = _residuals(rings, found, matrix)
    if dof:
        noise_sd = math.sqrt(float((residuals**2).sum()) / dof)
    gain = float(np.cbrt(abs(np.linalg.det(matrix))))
    return [c if is_round(c, noise_sd * gain) else None for c in found], noise_sd


def _residuals(rings: Sequence[Ring], circles: Sequence[Circle | None], matrix: Array) -> tuple[Array, int]:
    """Distances (N, 2) of samples from their plane and circle in the unit of the samples, and degrees of freedom."""
    pieces, dof = [np.zeros((0, 2))], 0
    for ring, circle in zip(rings, circles, strict=True):
        if circle is not None:
            along = float(np.linalg.norm(ring.down @ matrix))
            across = np.linalg.norm(circle.outward @ matrix, axis=1)
            pieces.append(np.column_stack([circle.height_residuals / along, circle.radial_residuals / across]))
            dof += 2 * len(ring.samples) - 6
    return np.concatenate(pieces), dof


def _covariance(
    centres: Sequence[Centre], faces: Array, columns: Array, closure: Array, variance: float | None, fixture_sd: float
) -> Array:
    """Covariance of the centres (3 K, 3 K): noise of each, and a tilt that all rings of a face share.

    `variance` None: no ring has samples enough to tell its noise; the disagreement of the centres tells it.
    """
    count = len(centres)
    whole = np.zeros((count, 3, count, 3))
    scatter = float((closure**2).sum()) / (3 * (count - 4))
    for j, centre in enumerate(centres):
        noise = scatter * np.eye(3) if variance is None else variance * centre.covariance
        whole[j, :, j] = noise + np.outer(centre.surprise, centre.surprise)
        across = columns @ (np.eye(3) - np.outer(faces[j], faces[j])) @ columns.T
        for other in np.flatnonzero((faces == faces[j]).all(axis=1)):
            whole[j, :, other] += math.radians(fixture_sd) ** 2 * across
    return whole.reshape(3 * count, 3 * count)
