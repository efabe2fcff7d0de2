"""Samples of a turned compass that no combination of old and new values explains: they are left out.

A firmware reads a compass in a task of its own and streams the mean since it was last there. When that task comes late
while the vehicle turns, one sample is the mean over a longer arc, hence too short: 6 mG in all three compasses of an
ArduCopter on a busy machine, beside a scatter of 0.5 mG. Iron that passes by does the like. One such sample must not
decide about a write.

Each hypothesis pays :data:`PRICE` for a sample that it leaves out: none can leave out what contradicts it more
cheaply than another explains it. The cheapest one says which samples are spoilt, for all of them.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PRICE: Final = 5.0
"""Standard deviations that a sample must be off, by all the others, to be left out; its square is what that costs."""
MOST: Final = 0.2
"""Share of the samples that may be left out."""


def spoilt(vectors: Array, covariance: Array, candidates: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which rows (n,) to leave out.

    Parameters
    ----------
    vectors : shape (H, n)
        The discrepancy under each hypothesis.
    covariance : shape (n, n)
        Of the discrepancy under the true one.
    candidates : shape (n,)
        The rows that may be spoilt.
    """
    precision = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    most = int(MOST * candidates.sum())
    best, found = float(np.inf), np.zeros(len(candidates), dtype=np.bool_)
    for vector in vectors:
        cost, out = _cheapest(vector, precision, candidates, most)
        if cost < best:
            best, found = cost, out
    return found


def _cheapest(
    vector: Array, precision: Array, candidates: NDArray[np.bool_], most: int
) -> tuple[float, NDArray[np.bool_]]:
    """Sum of squares with its price when the worst rows are left out one after the other, and which they are."""
    precision, out = precision.copy(), np.zeros(len(vector), dtype=bool)
    pull = precision @ vector
    cost = float(vector @ pull)
    for _ in range(most):
        # each row by all the others that are left: its distance from what they say of it, squared
        squares = np.where(candidates & ~out, pull**2 / np.maximum(np.diag(precision), np.finfo(float).tiny), 0.0)
        worst = int(squares.argmax())
        if squares[worst] <= PRICE**2:
            break
        cost += PRICE**2 - float(squares[worst])
        column = precision[:, worst] / precision[worst, worst]
        pull = pull - column * pull[worst]
        precision = precision - np.outer(column, precision[worst])
        out[worst] = True
    return cost, out
