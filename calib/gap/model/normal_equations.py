"""Solution of normal equations with missing directions, and Gram matrices that are kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri

from mavcal.calib.gap.model.hypotheses import Part
from mavcal.calib.gap.remembered import remembered

Array = NDArray[np.float64]

_RANK = 1e-9
"""Relative eigenvalue of a normalised Gram matrix below which a direction does not exist. Source: rounding of a Gram
matrix, 1e-16 of its size, with a margin."""


@remembered(24)
def weighted_gram(part: Part, weight: Array) -> Array:
    """``X W X'`` of many columns on one axis, kept, since weights change only with the noise

    Parameters
    ----------
    part
        Columns (p, n).
    weight : shape (n,)
        Of the bins; never changed in place.
    """
    half = part.X * np.sqrt(weight)
    return np.asarray(half @ half.T)


def eigh(gram: Array) -> tuple[Array, Array]:
    """Eigenvalues, ascending, and eigenvectors of a symmetric matrix, fast for single numbers."""
    if len(gram) == 1:
        return gram[0], np.ones((1, 1))
    values, vectors = np.linalg.eigh(gram)
    return values, vectors


def solved(gram: Array, right: Array) -> tuple[Array, Array, int]:
    """Solution, covariance and rank of normal equations, without directions that do not exist."""
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0.0] = 1.0
    sizes = np.outer(scale, scale)
    least = _RANK * max(len(scale), 1)
    inverse = _inverse(gram / sizes, least)
    rank = len(scale)
    if inverse is None:
        values, vectors = np.linalg.eigh(gram / sizes)
        good = values > least
        basis = vectors[:, good] / np.sqrt(values[good])
        inverse, rank = basis @ basis.T, int(good.sum())
    covariance = inverse / sizes
    return covariance @ right, covariance, rank


def _inverse(gram: Array, least: float) -> Array | None:
    """The inverse if all eigenvalues certainly exceed `least`, else None.

    The largest eigenvalue of the inverse is at most its largest row sum.
    """
    if not len(gram):
        return None
    factor, failed = dpotrf(gram, lower=1)
    if failed:
        return None
    half, failed = dpotri(factor, lower=1)
    inverse: Array = half + np.tril(half, -1).T
    return inverse if float(np.abs(inverse).sum(axis=0).max()) * least < 1.0 else None
