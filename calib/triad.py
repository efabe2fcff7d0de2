"""The sensor equation of a three-axis sensor, defined only here, and what its uncertainty does to the attitude.

``measured = M truth + b + p(T)`` and ``corrected = C (measured - b - p(T))`` with ``C = M^-1``.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib.errors import InvalidInputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ThermalPolynomial:
    """``p(T) = sum_j coefficients[:, j] (T - t_ref)^(j+1)``, T clamped to ``[t_min, t_max]``; ``p(t_ref) = 0``.

    Temperatures are in degC, `coefficients` has shape (3, k) in sensor units per degC, per degC^2, ...
    """

    t_ref: float
    t_min: float
    t_max: float
    coefficients: Array

    def __post_init__(self) -> None:
        coefficients = np.array(self.coefficients, dtype=np.float64)
        if coefficients.ndim != 2 or coefficients.shape[0] != 3 or not np.isfinite(coefficients).all():
            raise InvalidInputError(
                f"thermal coefficients must be finite and of shape (3, k), not {coefficients.shape}"
            )
        if not self.t_min <= self.t_max:
            raise InvalidInputError(f"temperature range is empty: {self.t_min} to {self.t_max} degC")
        object.__setattr__(self, "coefficients", coefficients)

    def __call__(self, temperature: ArrayLike) -> Array:
        """Values at `temperature` (degC), shape ``temperature.shape + (3,)``."""
        d = np.clip(np.asarray(temperature, dtype=np.float64), self.t_min, self.t_max) - self.t_ref
        value = np.zeros((*d.shape, 3))
        for column in self.coefficients.T[::-1]:
            value = (value + column) * d[..., None]
        return value


@dataclass(frozen=True, eq=False)
class TriadModel:
    """Offset `b` (3,), correction matrix `C` (3, 3) and thermal polynomial (None: temperature has no effect).

    Examples
    --------
    >>> model = TriadModel(offset=[0.1, 0.0, 0.0], matrix=np.diag([2.0, 1.0, 1.0]))
    >>> model.apply([[1.1, 0.0, -9.8]])
    array([[ 2. ,  0. , -9.8]])
    >>> model.invert([[2.0, 0.0, -9.8]])
    array([[ 1.1,  0. , -9.8]])
    """

    offset: Array = field(default_factory=lambda: np.zeros(3))
    matrix: Array = field(default_factory=lambda: np.eye(3))
    polynomial: ThermalPolynomial | None = None

    def __post_init__(self) -> None:
        offset = np.array(self.offset, dtype=np.float64)
        matrix = np.array(self.matrix, dtype=np.float64)
        if offset.shape != (3,) or matrix.shape != (3, 3):
            raise InvalidInputError(f"offset {offset.shape} and matrix {matrix.shape} must be (3,) and (3, 3)")
        if not (np.isfinite(offset).all() and np.isfinite(matrix).all()):
            raise InvalidInputError("offset and matrix of a sensor model must be finite")
        object.__setattr__(self, "offset", offset)
        object.__setattr__(self, "matrix", matrix)

    def apply(self, measured: ArrayLike, temperature: ArrayLike | None = None) -> Array:
        """Correct `measured` (..., 3) at `temperature` (...) in degC.

        Raises
        ------
        InvalidInputError
            If the model depends on temperature and none is given.
        """
        return (np.asarray(measured, dtype=np.float64) - self.bias(temperature)) @ self.matrix.T

    def invert(self, truth: ArrayLike, temperature: ArrayLike | None = None) -> Array:
        """What the sensor measures of `truth` (..., 3) at `temperature` (...) in degC."""
        sensitivity = np.linalg.inv(self.matrix)
        return np.asarray(truth, dtype=np.float64) @ sensitivity.T + self.bias(temperature)

    def after(self, first: TriadModel) -> TriadModel:
        """The model that corrects by `first` and then by this one; only one of them may be thermal.

        ``C2 (C1 (m - b1 - p1) - b2 - p2) = C2 C1 (m - b1 - C1^-1 b2 - p1 - C1^-1 p2)``
        """
        if first.polynomial is not None and self.polynomial is not None:
            raise InvalidInputError("two thermal models cannot be composed into one polynomial")
        back = np.linalg.inv(first.matrix)
        polynomial = first.polynomial
        if self.polynomial is not None:
            polynomial = dataclasses.replace(self.polynomial, coefficients=back @ self.polynomial.coefficients)
        return TriadModel(first.offset + back @ self.offset, self.matrix @ first.matrix, polynomial)

    def symmetric(self) -> TriadModel:
        """The model with the same ``|corrected|`` whose matrix is symmetric: ``C = Q S``, polar, gives S.

        The canonical form where only the length of the true vector is known (METHODS 0).
        """
        values, vectors = np.linalg.eigh(self.matrix.T @ self.matrix)
        return dataclasses.replace(self, matrix=(vectors * np.sqrt(values)) @ vectors.T)

    def upper_triangular(self) -> TriadModel:
        """The model with the same ``|corrected|`` whose matrix is upper triangular with a positive diagonal."""
        upper = np.asarray(np.linalg.cholesky(self.matrix.T @ self.matrix).T, dtype=np.float64)
        return dataclasses.replace(self, matrix=upper)

    @property
    def rotation(self) -> Array:
        """``Q`` of the polar decomposition ``C = Q S``: the part that no length constraint can see."""
        return self.matrix @ np.linalg.inv(self.symmetric().matrix)

    def bias(self, temperature: ArrayLike | None = None) -> Array:
        """What is subtracted at `temperature` (...) in degC, shape (..., 3), or (3,) if temperature has no effect."""
        if self.polynomial is None:
            return self.offset
        if temperature is None:
            raise InvalidInputError("this model depends on temperature: give the temperature of every sample")
        return self.offset + self.polynomial(temperature)


def tilt_sd_deg(model: TriadModel, covariance: Array, gravity: float) -> float:
    """Standard deviation of the tilt by an accelerometer's `model`, degrees, in the worst direction.

    ``da = dC C^-1 a - C db`` with ``a = (0, 0, -g)``: its horizontal part over g is the tilt. A rotation of the whole
    sensor against the vehicle is not in it: no pose shows it.

    Parameters
    ----------
    model
        Offset and matrix; no thermal part.
    covariance : shape (12, 12) or more
        Covariance of offset and matrix, in the order of :func:`calib.fit.parameter_names`.
    gravity
        Length of the corrected vector.
    """
    level = np.linalg.solve(model.matrix, np.array([0.0, 0.0, -gravity]))
    rows = np.hstack([-model.matrix, np.kron(np.eye(3), level)])[:2]
    variance = rows @ covariance[:12, :12] @ rows.T
    return math.degrees(math.sqrt(max(float(np.linalg.eigvalsh(variance)[-1]), 0.0)) / gravity)


def drift_sd_deg_per_min(model: TriadModel, covariance: Array) -> float:
    """Standard deviation of the angle that a gyroscope's offset makes in a minute, degrees, about the worst axis.

    `covariance` (12, 12) or more is that of offset and matrix, the matrix in rad/s per unit of the sensor.
    """
    rate = model.matrix @ covariance[:3, :3] @ model.matrix.T
    return math.degrees(60.0 * math.sqrt(max(float(np.linalg.eigvalsh(rate)[-1]), 0.0)))
