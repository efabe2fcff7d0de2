"""Exchanges of axes and signs between a sensor and its reference, and how alike two movements are."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BETTER = 0.25  # share of the misfit that another frame must leave
_TIED = 1.1  # times the least misfit, within which the frame that turns least is taken
_UNIT = 3.0  # ratio of sizes from which the unit is another


def turn_of(measured: Array, ideal: Array, slight: float = 0.0) -> Array:
    """The exchange of axes and signs that fits best; the identity unless another leaves a quarter of its misfit.

    It is kept as well where its misfit is less than the share `slight`. Scale and offset are left out of the
    comparison: among turns the sum ``m . P i`` decides. Of those that fit alike, the one that changes least.
    """
    cross = measured.T @ ideal
    best = float(np.sqrt((measured**2).sum() * (ideal**2).sum()))
    misfit = {key: max(best - float((cross * turn).sum()), 1e-12 * best) for key, turn in TURNS.items()}
    least = min(misfit.values())
    if misfit[_IDENTITY] <= max(least / _BETTER, slight * best):
        return TURNS[_IDENTITY]
    tied = [key for key, value in misfit.items() if value <= _TIED * least + 1e-3 * best]
    return TURNS[max(tied, key=lambda key: float(np.trace(TURNS[key])))]


def _turns() -> dict[tuple[tuple[int, ...], tuple[int, ...]], Array]:
    found = {}
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            found[order, signs] = turn
    return found


TURNS = _turns()
_IDENTITY = ((0, 1, 2), (1, 1, 1))


def turned_correlation(a: Array, b: Array) -> float:
    """Correlation of the movements (N, 3) in whichever frame of `b` it is highest."""
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    return max(correlation(a, b @ turn.T) for turn in TURNS.values())


def likened(measured: Array, ideal: Array) -> Array:
    """`measured` in the frame and the unit of `ideal`, both (N, 3), where they are not its own."""
    turn = turn_of(measured, ideal)
    turned = measured @ turn
    size = float(np.sum(turned * ideal) / max(float(np.sum(ideal**2)), 1e-300))
    return turned / size if size > _UNIT or 0.0 < size < 1.0 / _UNIT else turned


def correlation(a: Array, b: Array) -> float:
    """Correlation of two movements (N, 3) as a whole, 1 at best; their means are not taken off."""
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0.0 else 0.0
