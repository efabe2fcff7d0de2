"""Whether a sensor follows its reference at all: one that does not has no scale of minus a hundred percent."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, correlation_lags

from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.reference.frames import turn_of

Array = NDArray[np.float64]

_OVER_S = 0.5  # changes over so long: what wanders is alike by chance, its changes are not
_LATEST_S = 1.0  # either is late by no more
_UNLIKE = 0.3  # correlation below which movements have nothing in common
_LEAST = 0.3  # share of the reference's movement that a sensor of any sort shows, beside noise of any size
_MOST = 0.8  # and share that is none by chance
_BY_CHANCE = 3.0  # standard errors
_FEWEST = 20  # changes that say something


def unrelated(trace: Trace, moves: float) -> NDArray[np.bool_]:
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
