"""How alike two movements are, in which exchange of axes and signs, and on which axes a sensor follows its reference.

A sensor that does not follow its reference has no scale of minus a hundred percent.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, correlation_lags

from mavcal.calib.gap.problem import Trace

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


_OVER_S = 0.5  # changes over so long: what wanders is alike by chance, its changes are not
_LATEST_S = 1.0  # either is late by no more
_UNLIKE = 0.3  # correlation below which movements have nothing in common
_LEAST = 0.3  # share of the reference's movement that a sensor of any sort shows, beside noise of any size
_MOST = 0.8  # and share that is none by chance
_BY_CHANCE = 3.0  # standard errors
_FEWEST = 20  # changes that say something


def uncorrelated_axes(trace: Trace, moves: float) -> NDArray[np.bool_]:
    """Axes (3,) on which the reference changes by `moves` (rms over half a second) or more, and the sensor otherwise.

    The share of the reference's movement that is in the readings is asked for and not the correlation alone: a sensor
    that shakes follows as well. Where exchanged axes are nearer, that is another matter.
    """
    step = max(1, round(_OVER_S * trace.fs))
    both = trace.observed[step:] & trace.observed[:-step]
    apart = both.sum() / step
    if apart < _FEWEST:
        return np.zeros(3, dtype=bool)
    measured, ideal = (_changes(values, step, both) for values in (trace.measured, trace.ideal))
    if not np.array_equal(turn_of(measured, ideal), np.eye(3)):
        return np.zeros(3, dtype=bool)
    latest = round(_LATEST_S * trace.fs)
    return np.array([_unrelated(measured[:, c], ideal[:, c], moves, latest, apart) for c in range(3)])


def _changes(values: Array, step: int, both: NDArray[np.bool_]) -> Array:
    change = np.where(both[:, None], values[step:] - values[:-step], 0.0)
    return np.asarray(change - np.where(both[:, None], change[both].mean(axis=0), 0.0))


def _unrelated(measured: Array, ideal: Array, moves: float, latest: int, apart: float) -> bool:
    own, its = float(measured @ measured), float(ideal @ ideal)
    if its < moves**2 * len(ideal) or own == 0.0:
        return False
    products = correlate(measured, ideal, method="fft")
    lags = np.abs(correlation_lags(len(measured), len(ideal)))
    common = float(np.abs(products[lags <= latest]).max())
    by_chance = min(_BY_CHANCE * math.sqrt(own * its / apart), _MOST * its)
    return common < _UNLIKE * math.sqrt(own * its) and common < max(_LEAST * its, by_chance)
