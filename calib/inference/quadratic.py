"""A log-likelihood as a quadratic form about a point: what one record says of its parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Quadratic:
    """``constant + gradient . d - d . curvature . d / 2`` with ``d = theta - centre``; (P,), (P,), (P, P)."""

    centre: Array
    gradient: Array
    curvature: Array
    constant: float = 0.0

    def at(self, theta: Array) -> float:
        """Log-likelihood at `theta`, nats."""
        d = theta - self.centre
        return float(self.constant + self.gradient @ d - 0.5 * d @ self.curvature @ d)

    def slope(self, theta: Array) -> Array:
        """Gradient (P,) of the log-likelihood at `theta`."""
        return np.asarray(self.gradient - self.curvature @ (theta - self.centre))

    def with_discrepancy(self, precision: Array) -> Quadratic:
        """The form with normal errors between the record's parameters and the model's integrated out.

        These errors bound what a record of any length can say about the model (Kennedy and O'Hagan 2001). `precision`
        (P, P) is the inverse of the covariance of these errors; it must be positive definite.
        """
        root = np.linalg.cholesky(precision)
        whitened = solve_triangular(root, solve_triangular(root, self.curvature, lower=True).T, lower=True)
        ratio, turned = np.linalg.eigh(0.5 * (whitened + whitened.T))
        ratio = np.maximum(ratio, 0.0)  # in parts of the discrepancy's precision; below 0 by rounding only
        own = turned.T @ solve_triangular(root, self.gradient, lower=True)
        across = root @ turned
        constant = 0.5 * float((own**2 / (1.0 + ratio)).sum()) - 0.5 * float(np.log1p(ratio).sum())
        return Quadratic(
            self.centre,
            np.asarray(across @ (own / (1.0 + ratio))),
            np.asarray((across * (ratio / (1.0 + ratio))) @ across.T),
            self.constant + constant,
        )

    def without(self, gone: NDArray[np.bool_], mean: Array, sd: Array) -> Quadratic:
        """The form of the other parameters; those `gone` (P,) are integrated out under normal priors (P,), (P,)."""
        kept = ~gone
        prior = np.diag(1.0 / sd[gone] ** 2)
        off = mean[gone] - self.centre[gone]
        inner = np.linalg.inv(self.curvature[np.ix_(gone, gone)] + prior)
        across = self.curvature[np.ix_(kept, gone)]
        pull = self.gradient[gone] + prior @ off
        _, inside = np.linalg.slogdet(inner)
        constant = 0.5 * float(pull @ inner @ pull - off @ prior @ off) + 0.5 * inside - float(np.log(sd[gone]).sum())
        return Quadratic(
            self.centre[kept],
            np.asarray(self.gradient[kept] - across @ inner @ pull),
            np.asarray(self.curvature[np.ix_(kept, kept)] - across @ inner @ across.T),
            self.constant + constant,
        )
