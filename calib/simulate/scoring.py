"""Comparison of a calibration with the truth, if a simulator or a test bench knows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult, parameter_names
from mavcal.calib.triad import Array, ThermalPolynomial, TriadModel


@dataclass(frozen=True, eq=False)
class RecoveryScore:
    """Errors of the parameters `names`, with the standard deviations and covariance that were stated for them."""

    names: tuple[str, ...]
    errors: Array
    covariance: Array

    @property
    def standardised(self) -> Array:
        """Error over stated standard deviation."""
        return np.asarray(self.errors / np.sqrt(np.diag(self.covariance)), dtype=np.float64)

    @property
    def chi2(self) -> float:
        """``e^T Cov^-1 e``, chi-square distributed with ``len(names)`` degrees of freedom if the fit is honest."""
        scale = np.sqrt(np.diag(self.covariance))
        e = self.errors / scale
        correlation = self.covariance / np.outer(scale, scale)
        return float(e @ np.linalg.solve(correlation, e))


def score(stored: TriadModel, fit: FitResult, truth: TriadModel, names: tuple[str, ...]) -> RecoveryScore:
    """Error of `stored` (the calibration in force on the vehicle) against `truth`, with the uncertainty of `fit`.

    Matrices are compared in their symmetric form, offsets at the temperature of the fit, polynomials about the
    fit's own reference. `names` are those of :func:`calib.fit.parameter_names` that the vehicle can hold.

    Raises
    ------
    InvalidInputError
        If a name has no uncertainty in the fit.
    """
    order = [fit.names.index(name) for name in names]
    covariance = fit.covariance[np.ix_(order, order)]
    silent = [n for n, v in zip(names, np.diag(covariance), strict=True) if not v > 0]
    if silent:
        raise InvalidInputError(f"the fit states no uncertainty for {', '.join(silent)}")
    errors = _values(stored, fit) - _values(truth, fit)
    return RecoveryScore(names, errors[order], covariance)


def joint_p_value(scores: tuple[RecoveryScore, ...]) -> tuple[float, int, float]:
    """Sum of chi-squares over independent fits, its degrees of freedom, and the probability of a larger one."""
    total = sum(s.chi2 for s in scores)
    freedom = sum(len(s.names) for s in scores)
    return total, freedom, float(chdtrc(freedom, total))


def _values(model: TriadModel, fit: FitResult) -> Array:
    offset = model.offset.copy()
    if model.polynomial is not None and fit.temperature is not None:
        offset = offset + model.polynomial(fit.temperature)
    parts = [offset, model.symmetric().matrix.ravel()]
    if fit.model.polynomial is not None:
        parts.append(_about(model.polynomial, fit.model.polynomial.t_ref, fit.degree).ravel())
    values = np.concatenate(parts)
    assert len(values) == len(parameter_names(fit.degree))
    return values


def _about(polynomial: ThermalPolynomial | None, t_ref: float, degree: int) -> Array:
    """Coefficients (3, degree) of the same curve about another reference; its constant belongs to the offset."""
    if polynomial is None:
        return np.zeros((3, degree))
    shift = np.polynomial.Polynomial([t_ref - polynomial.t_ref, 1.0])
    shifted = np.zeros((3, max(degree, polynomial.coefficients.shape[1]) + 1))
    for axis, coefficients in enumerate(polynomial.coefficients):
        curve = np.polynomial.Polynomial([0.0, *coefficients])(shift)
        shifted[axis, : len(curve.coef)] = curve.coef
    if np.any(np.abs(shifted[:, degree + 1 :]) > 0):
        raise InvalidInputError(f"the curve has more than {degree} terms")
    return shifted[:, 1 : degree + 1]
