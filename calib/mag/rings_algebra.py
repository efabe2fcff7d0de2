"""From the centres of six rings to a matrix: the exact columns, and the published variant of them (METHODS S3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    """`columns` (3, 3), each divided by its largest component, as published: the scale of each axis is thrown away.

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
