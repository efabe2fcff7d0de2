"""Recursive adjusted least squares: one pass, a state of fixed size, a covariance at any time.

Only moments of the samples are kept. The estimate needs them to the fourth order (:mod:`calib.mag.moments`), its
covariance to the sixth. Products of neighbours show the serial correlation of its residuals. Moments are additive, so
chunks can be split and merged anywhere, and old ones can fade without any linearisation (METHODS 3.5).

The algebraic residual of a sample is ``e = psi . theta``; noise moves it by ``grad . noise``. The nine parameters x
have ``theta(x)``, ``T = d theta/dx`` and ``A = T^T Psi T``. Hence ``Cov x = A^-1 T^T (sum w^2 v |grad|^2 psi psi^T) T
A^-1 / (sum w)^2``.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.distance import ALL_SIDES
from mavcal.calib.mag.ellipsoid_result import ShapeFit, judged_ellipsoid
from mavcal.calib.mag.moments import POWERS, Moments, corrections, fill_monomials
from mavcal.calib.mag.result import MagContext, MagFacts, refusal
from mavcal.calib.mag.samples import CHUNK, LEAST_VARIANCE, Array, Cloud, check_not_flat, check_samples
from mavcal.calib.mag.shape import SYMMETRIC_BASIS, Ellipsoid, MagModel
from mavcal.calib.stats.residuals import WHITE, student_variance

METHOD = "mag-ellipsoid"

_SINGULAR = 1e-13  # smallest over largest information that is more than rounding

# Exponents of the twenty monomials of the third order: those of psi, then the cubes.
_CUBES = np.array([p for p in itertools.product(range(4), repeat=3) if sum(p) == 3])
_TWENTY = np.vstack([POWERS, _CUBES])
# Each cube as a row of psi times one of x, y, z (rows 6, 7, 8).
_FACTORS = [
    next(
        (i, 6 + j) for i, j in itertools.product(range(6), range(3)) if np.array_equal(POWERS[i] + POWERS[6 + j], cube)
    )
    for cube in _CUBES
]


def _sixth_order_table() -> NDArray[np.intp]:
    """Index into the flattened (20, 20) gram matrix of the mean of ``psi_i psi_j psi_q``, (10, 10, 10)."""
    where: dict[tuple[int, ...], int] = {}
    for p, q in itertools.product(range(20), repeat=2):
        where.setdefault(tuple(_TWENTY[p] + _TWENTY[q]), 20 * p + q)
    table = np.empty((10, 10, 10), dtype=np.intp)
    for i, j, q in itertools.product(range(10), repeat=3):
        table[i, j, q] = where[tuple(POWERS[i] + POWERS[j] + POWERS[q])]
    return table


_SIXTH = _sixth_order_table()


@dataclass(frozen=True, eq=False)
class RunningEllipsoid:
    """Moments of all magnetometer samples so far, in a state of fixed size; immutable.

    Start with :meth:`about`. `centre` and `scale` only serve the conditioning: the middle and the radius of the cloud,
    roughly. `forgetting` is the factor on a sample's weight with each following one: 1 keeps all, ``1 - 1/n`` about the
    last n.
    """

    forgetting: float
    moments: Moments
    sixth: Array
    """Sum of ``w^2 phi phi^T``, phi the monomials to the third order, (20, 20)."""
    lagged: Array
    """Sum of ``w psi_k psi_(k-1)^T``, (10, 10)."""
    first: Array
    last: Array
    """psi of the first and the last sample, (10,); zero: none yet."""
    count: int

    @classmethod
    def about(cls, centre: ArrayLike, scale: float, *, forgetting: float = 1.0) -> RunningEllipsoid:
        """No samples yet.

        Raises
        ------
        InvalidInputError
            If `scale` is not positive or `forgetting` not in (0, 1].
        """
        if not 0.0 < forgetting <= 1.0:
            raise InvalidInputError(f"forgetting is a factor above 0 and up to 1, not {forgetting}")
        moments = Moments.empty(np.asarray(centre, dtype=np.float64), scale)
        return cls(forgetting, moments, np.zeros((20, 20)), np.zeros((10, 10)), np.zeros(10), np.zeros(10), 0)

    def added(self, samples: ArrayLike) -> RunningEllipsoid:
        """The fit with `samples` (N, 3) or (3,) added, in order of time.

        Raises
        ------
        InvalidInputError
            If they are not finite or of another shape.
        """
        array = check_samples(np.atleast_2d(np.asarray(samples, dtype=np.float64)), 0, may_repeat=True)
        cloud = Cloud(array, self.moments.centre, self.moments.scale)
        state = self
        for start in range(0, len(array), CHUNK):
            state = state.then(self._of_chunk(cloud.rows(start)))
        return state

    def then(self, later: RunningEllipsoid) -> RunningEllipsoid:
        """The fit of both; `later` came after this one, and shares centre, scale and forgetting.

        Raises
        ------
        InvalidInputError
            If they do not.
        """
        if self.forgetting != later.forgetting:
            raise InvalidInputError(f"forgetting of {self.forgetting} and {later.forgetting} cannot be joined")
        fade = self.forgetting**later.count
        faded = Moments(self.moments.centre, self.moments.scale, fade * self.moments.gram)
        joint = self.forgetting ** max(later.count - 1, 0) * np.outer(later.first, self.last)
        return RunningEllipsoid(
            self.forgetting,
            faded.merged(later.moments),
            fade**2 * self.sixth + later.sixth,
            fade * self.lagged + later.lagged + joint,
            self.first if self.count else later.first,
            later.last if later.count else self.last,
            self.count + later.count,
        )

    def _of_chunk(self, points: Array) -> RunningEllipsoid:
        n = points.shape[1]
        phi = np.empty((20, n))
        psi = fill_monomials(points, phi[:10])
        for row, (i, j) in zip(phi[10:], _FACTORS, strict=True):
            np.multiply(psi[i], psi[j], out=row)
        first, last = psi[:, 0].copy(), psi[:, -1].copy()
        weight = self.forgetting ** np.arange(n - 1, -1, -1.0)
        weighted = psi if self.forgetting == 1.0 else weight * psi
        lagged, gram = weighted[:, 1:] @ psi[:, :-1].T, weighted @ psi.T
        if self.forgetting < 1.0:
            phi *= weight
        moments = Moments(self.moments.centre, self.moments.scale, gram)
        return RunningEllipsoid(self.forgetting, moments, phi @ phi.T, lagged, first, last, n)

    @property
    def n_effective(self) -> float:
        """Number of equally weighted samples that these are worth: ``(sum w)^2 / sum w^2``."""
        return self.moments.count**2 / float(self.sixth[9, 9]) if self.count else 0.0

    def ellipsoid(self, model: str = MagModel.SYMMETRIC) -> tuple[Ellipsoid, float]:
        """The adjusted least squares ellipsoid and the noise of a sample.

        Raises
        ------
        UndeterminedError
            If the samples lie on no ellipsoid.
        """
        return self.moments.ellipsoid(MagModel(model))

    def fit(self, model: str = MagModel.SYMMETRIC, **facts: Unpack[MagFacts]) -> FitResult:
        """The ellipsoid with its covariance; refused as long as too much is missing.

        Outliers are not detected, which needs the samples themselves (:func:`calib.mag.fit_ellipsoid`).

        Parameters
        ----------
        model
            What is free, :class:`~calib.mag.shape.MagModel`.
        **facts
            Known facts of sensor and field, as in :class:`calib.mag.result.MagContext`.
        """
        context, form = MagContext(**facts), MagModel(model)
        try:
            fit, about = self._shape_fit(form, context)
        except UndeterminedError as error:
            return refusal(METHOD, error, self.count, context)
        return judged_ellipsoid(fit, about, self.count, self.count, context)

    def _shape_fit(self, model: MagModel, context: MagContext) -> tuple[ShapeFit, dict[str, Any]]:
        dof = self.n_effective - model.size
        if dof < 1.0:
            raise UndeterminedError(
                f"{self.count} magnetometer samples ({self.n_effective:.0f} as they are weighed) are too few for the "
                f"{model.size} parameters",
                remedy="record longer while turning the vehicle in all directions",
            )
        check_not_flat(self.moments.scatter())
        scaled = Moments(np.zeros(3), 1.0, self.moments.gram)
        ellipsoid, noise_sd = scaled.ellipsoid(model)
        variance = max(noise_sd**2 * self.n_effective / dof, LEAST_VARIANCE)
        rho = self._first_correlation(quadric(ellipsoid))
        white = 2.0 * float(scipy.special.ndtr(-abs(rho) * math.sqrt(self.n_effective))) >= WHITE
        inflation = 1.0 if white or rho <= 0.0 else (1.0 + rho) / max(1.0 - rho, 1e-3)
        covariance, condition = self._covariance(ellipsoid, model, variance)
        fit = ShapeFit(
            method=METHOD,
            ellipsoid=ellipsoid,
            covariance=covariance * student_variance(dof) * inflation,
            residuals=np.zeros(0),
            dof=dof,
            condition_number=condition,
            native={"model": str(model)},
            variance_inflation=inflation,
        ).moved(self.moments.centre, self.moments.scale)
        return fit, _about(math.sqrt(variance) * self.moments.scale, dof, rho, white=white, context=context)

    def _covariance(self, ellipsoid: Ellipsoid, model: MagModel, variance: float) -> tuple[Array, float]:
        """(9, 9) in the scaled coordinates, and the condition of the normal equations."""
        theta, weight = quadric(ellipsoid), self.moments.count
        by_parameters = quadric_derivatives(ellipsoid) @ model.basis
        k0, k1, k2 = corrections(self.moments.gram / weight)
        normal = by_parameters.T @ (k0 + variance * k1 + variance**2 * k2) @ by_parameters
        spread = np.linalg.eigvalsh(normal)
        if not spread[0] > _SINGULAR * spread[-1]:
            raise UndeterminedError(
                "the magnetometer samples leave a parameter of the ellipsoid open", remedy=ALL_SIDES
            )
        scatter = self.sixth.ravel()[_SIXTH] @ squared_gradient(theta)
        inverse = model.basis @ np.linalg.inv(normal) @ by_parameters.T
        return inverse @ scatter @ inverse.T * (variance / weight**2), float(spread[-1] / spread[0])

    def _first_correlation(self, theta: Array) -> float:
        power = float(theta @ self.moments.gram @ theta)
        return float(theta @ self.lagged @ theta) / power if power > 0.0 else 0.0


def quadric(ellipsoid: Ellipsoid) -> Array:
    """Coefficients (10,) of psi that vanish on `ellipsoid`: ``(y - b)^T S^-2 (y - b) - 1``."""
    inverse = np.linalg.inv(ellipsoid.shape)
    Q = inverse @ inverse
    return _coefficients(Q, -2.0 * Q @ ellipsoid.offset, float(ellipsoid.offset @ Q @ ellipsoid.offset) - 1.0)


def quadric_derivatives(ellipsoid: Ellipsoid) -> Array:
    """Derivatives (10, 9) of :func:`quadric` by the nine parameters."""
    b, inverse = ellipsoid.offset, np.linalg.inv(ellipsoid.shape)
    Q = inverse @ inverse
    columns = [_coefficients(np.zeros((3, 3)), -2.0 * Q[:, i], 2.0 * float(Q[i] @ b)) for i in range(3)]
    for direction in SYMMETRIC_BASIS:
        half = inverse @ direction @ Q
        change = -(half + half.T)
        columns.append(_coefficients(change, -2.0 * change @ b, float(b @ change @ b)))
    return np.column_stack(columns)


def squared_gradient(theta: Array) -> Array:
    """Coefficients (10,) of psi of the squared gradient of ``psi . theta``."""
    Q = np.diag(theta[:3])
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        Q[i, j] = Q[j, i] = 0.5 * theta[3 + k]
    linear = theta[6:9]
    return _coefficients(4.0 * Q @ Q, 4.0 * Q @ linear, float(linear @ linear))


def _coefficients(quadratic: Array, linear: Array, constant: float) -> Array:
    cross = 2.0 * quadratic[[0, 0, 1], [1, 2, 2]]
    return np.concatenate([quadratic.diagonal(), cross, linear, [constant]])


def _about(rms: float, dof: float, rho: float, *, white: bool, context: MagContext) -> dict[str, Any]:
    noise = context.noise_variance
    chi2 = None if noise is None else dof * rms**2 / noise
    return {
        "residual_rms": rms,
        "chi2": chi2,
        "p_value": None if chi2 is None else float(scipy.special.chdtrc(dof, chi2)),
        "noise_sd": rms if noise is None else math.sqrt(noise),
        "noise_from": "residuals" if noise is None else "given",
        "first_correlation": rho,
        "white": white,
    }
