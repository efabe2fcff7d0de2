"""Adjusted least squares for an ellipsoid: one pass over the samples, a 10 x 10 state, mergeable.

The algebraic fit solves ``psi(y) . theta = 0`` with ``psi = (x2 y2 z2 xy xz yz x y z 1)``. It is biased, because noise
does not average out of squares. Replacing every power by its noise-corrected counterpart (``x^2 -> x^2 - v`` and so on,
v the noise variance) removes that: ``Psi(v) = K0 + v K1 + v^2 K2`` is an unbiased estimate of the noise-free moments.
Its smallest eigenvalue vanishes at the right v, and theta is the null vector (Kukush, Markovsky and Van Huffel 2004;
METHODS 3.1).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.mag.samples import CHUNK, Array, Cloud, check_not_flat, check_real_samples
from mavcal.calib.mag.shape import Ellipsoid, MagModel

POWERS = np.array(
    [[2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]]
)
"""Exponents of x, y, z in the ten monomials of psi, (10, 3)."""

# Noise-corrected power: t_e = sum_m _HERMITE[e][m] v^m x^(e - 2m), and E t_e(x + noise) = x^e.
_HERMITE = ((1.0,), (1.0,), (1.0, -1.0), (1.0, -3.0), (1.0, -6.0, 3.0))

_MAX_NEWTON = 30


def _correction_table() -> Array:
    """Table (3, 100, 100): gram matrix -> K0, K1, K2, all flattened."""
    where: dict[tuple[int, ...], int] = {}
    for p, q in itertools.product(range(10), repeat=2):
        where.setdefault(tuple(POWERS[p] + POWERS[q]), 10 * p + q)
    table = np.zeros((3, 100, 100))
    for p, q in itertools.product(range(10), repeat=2):
        powers = POWERS[p] + POWERS[q]
        for lowered in itertools.product(*(range(len(_HERMITE[e])) for e in powers)):
            factor = np.prod([_HERMITE[e][m] for e, m in zip(powers, lowered, strict=True)])
            source = where[tuple(int(e) - 2 * m for e, m in zip(powers, lowered, strict=True))]
            table[sum(lowered), 10 * p + q, source] += factor
    return table


_CORRECTION = _correction_table()


# The coefficients of psi as combinations (10, k), orthonormal, of those that a model leaves free.
_FREE = {
    MagModel.OFFSET: np.column_stack([np.r_[np.full(3, 3.0**-0.5), np.zeros(7)], np.eye(10)[:, 6:]]),
    MagModel.DIAGONAL: np.delete(np.eye(10), (3, 4, 5), axis=1),
    MagModel.SYMMETRIC: np.eye(10),
}


def corrections(gram: Array) -> Array:
    """K0, K1, K2, stacked (3, 10, 10), of a mean `gram` (10, 10): ``Psi(v) = K0 + v K1 + v^2 K2``."""
    return np.asarray((_CORRECTION @ gram.ravel()).reshape(3, 10, 10))


def fill_monomials(points: Array, out: Array) -> Array:
    """The ten monomials (10, n) of `points` (3, n), in the first n columns of `out`."""
    rows = out[:, : points.shape[1]]
    np.square(points, out=rows[:3])
    np.multiply(points[0], points[1:], out=rows[3:5])
    np.multiply(points[1], points[2], out=rows[5])
    rows[6:9] = points
    rows[9] = 1.0
    return rows


@dataclass(frozen=True, eq=False)
class Moments:
    """Raw moments to the fourth order of samples shifted by `centre` and divided by `scale`.

    `centre` and `scale` only serve the conditioning: the middle and the radius of the cloud, roughly.
    """

    centre: Array
    scale: float
    gram: Array
    """Sum of ``psi psi^T`` over the samples, (10, 10)."""

    @classmethod
    def empty(cls, centre: Array, scale: float) -> Moments:
        """No samples yet."""
        if not scale > 0.0:
            raise InvalidInputError(f"the scale of a cloud of samples must be positive, not {scale}")
        return cls(np.asarray(centre, dtype=np.float64), float(scale), np.zeros((10, 10)))

    @property
    def count(self) -> float:
        """Number of samples."""
        return float(self.gram[9, 9])

    @classmethod
    def of(cls, cloud: Cloud) -> Moments:
        """Moments of `cloud` in its scaled coordinates: the result is about its centre and in units of its scale."""
        gram, psi = np.zeros((10, 10)), np.empty((10, min(CHUNK, max(len(cloud), 1))))
        for start in range(0, len(cloud), CHUNK):
            rows = fill_monomials(cloud.rows(start), psi)
            gram += rows @ rows.T
        return cls(np.zeros(3), 1.0, gram)

    def added(self, samples: NDArray[Any]) -> Moments:
        """The moments with `samples` (N, 3) added; they must be finite, of any real type."""
        found = Moments.of(Cloud(samples, self.centre, self.scale))
        return Moments(self.centre, self.scale, self.gram + found.gram)

    def merged(self, other: Moments) -> Moments:
        """The moments of both; `other` must share `centre` and `scale`."""
        if self.scale != other.scale or not np.array_equal(self.centre, other.centre):
            raise InvalidInputError("moments about different centres or scales cannot be merged")
        return Moments(self.centre, self.scale, self.gram + other.gram)

    def scatter(self) -> Array:
        """Covariance (3, 3) of the samples, in units of ``scale^2``."""
        mean = self.gram[6:9, 9] / self.count
        return self.gram[6:9, 6:9] / self.count - np.outer(mean, mean)

    def ellipsoid(self, model: MagModel = MagModel.SYMMETRIC) -> tuple[Ellipsoid, float]:
        """The adjusted least squares ellipsoid and the noise standard deviation, in the unit of the samples.

        `model` says what of the ellipsoid is free.

        Raises
        ------
        UndeterminedError
            If the samples lie on no ellipsoid.
        """
        free = _FREE[model]
        k0, k1, k2 = (free.T @ k @ free for k in corrections(self.gram / self.gram[9, 9]))
        variance = 0.0
        for _ in range(_MAX_NEWTON):  # on the smallest eigenvalue: dv = -lambda / (x^T Psi' x)
            quadric = k0 + variance * k1 + variance**2 * k2
            if not np.isfinite(quadric).all():
                raise _no_ellipsoid()
            values, vectors = np.linalg.eigh(quadric)
            vector = vectors[:, 0]
            slope = vector @ (k1 + 2.0 * variance * k2) @ vector
            if not slope < 0.0:
                raise _no_ellipsoid()
            step = -values[0] / slope
            variance += step
            if abs(step) <= 1e-12 * max(abs(variance), 1e-9):
                break
        return self._ellipsoid_of(free @ vector, float(variance))

    def _ellipsoid_of(self, theta: Array, variance: float) -> tuple[Ellipsoid, float]:
        """The ellipsoid of the quadric `theta` (10,), in the unit of the samples, and the noise."""
        quadratic = np.diag(theta[:3])
        quadratic[0, 1] = quadratic[1, 0] = theta[3] / 2.0
        quadratic[0, 2] = quadratic[2, 0] = theta[4] / 2.0
        quadratic[1, 2] = quadratic[2, 1] = theta[5] / 2.0
        values = np.linalg.eigvalsh(quadratic)
        if abs(values).min() <= 1e-9 * abs(values).max():
            raise _no_ellipsoid()
        offset = -0.5 * np.linalg.solve(quadratic, theta[6:9])
        level = offset @ quadratic @ offset - theta[9]
        if level == 0.0:
            raise _no_ellipsoid()
        values, vectors = np.linalg.eigh(quadratic / level)
        if values.min() <= 0.0:
            raise _no_ellipsoid()
        ellipsoid = Ellipsoid(np.asarray(offset), np.asarray((vectors / np.sqrt(values)) @ vectors.T))
        return ellipsoid.moved(self.centre, self.scale), self.scale * float(np.sqrt(max(variance, 0.0)))


def adjusted_least_squares(samples: NDArray[Any]) -> tuple[Ellipsoid, float]:
    """The ellipsoid of `samples` (N, 3) of any real type, and the noise of one: one pass, without uncertainty.

    Raises
    ------
    InvalidInputError
        Wrong shape, or a number that is not finite.
    UndeterminedError
        If the samples are too few, flat, or lie on no ellipsoid.
    """
    check_real_samples(samples, MagModel.SYMMETRIC.size + 1)
    cloud = Cloud.of(samples)
    moments = Moments.of(cloud)
    check_not_flat(moments.scatter())
    ellipsoid, noise_sd = moments.ellipsoid(MagModel.SYMMETRIC)
    return ellipsoid.moved(cloud.centre, cloud.scale), cloud.scale * noise_sd


def _no_ellipsoid() -> UndeterminedError:
    return UndeterminedError(
        "the magnetometer samples do not close to an ellipsoid",
        remedy="turn the vehicle so that every side points up and down once, away from steel and magnets",
    )
