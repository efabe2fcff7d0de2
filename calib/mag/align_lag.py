"""Delay of a magnetometer behind the accelerometer, as one more unknown of the likelihood (METHODS 3.5).

A rate of 1 rad/s turns ten milliseconds into 0.6 degrees, and a steady turn makes that look like a mounting angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.mag.align_solve import AlignmentSolution
from mavcal.calib.mag.orientation import interpolated

Array = NDArray[np.float64]

_MOVES = 0.02  # rad/s, rms: slower turns do not show a lag
_LOUD = 0.05  # of the square of the turning, the noise in it: more would shrink the lag
_WIDEST = 16  # samples to either side that a turn is taken over
_LONGEST_LAG = 1.0  # s: a lag that is open by more is no lag


@dataclass(frozen=True, eq=False)
class FieldLag:
    """Delay of the field behind the vertical, s, with its derivatives."""

    value: float
    sd: float
    column: Array
    """(N, 2): derivatives of the whitened residuals."""


def turning_of(at: Array, force: Array, gyro_t: Array | None, gyro: Array | None) -> Array | None:
    """Rate of change (N, 3) of the unit vector down at the times `at`, 1/s; None: it hardly turns, or cannot be told.

    With rates `gyro` (K, 3), rad/s, at the times `gyro_t` (K,) it is ``dg/dt = g x w``. Without, it is the difference
    of its neighbours, as near as noise allows.
    """
    down = -force / np.maximum(np.sqrt(np.einsum("ij,ij->i", force, force)), 1e-12)[:, None]
    if gyro is not None and gyro_t is not None and len(gyro) > 1:
        rate = np.cross(down, interpolated(at, gyro_t, gyro))
        return rate if np.vdot(rate, rate) > len(rate) * _MOVES**2 else None
    reach = 1
    while 2 * reach + 1 < len(at) and reach <= _WIDEST:
        rate, noise = _difference(at, down, reach)
        power = float(np.vdot(rate, rate)) / len(rate)
        if noise < _LOUD * power and power - noise > _MOVES**2:
            return rate
        reach *= 2
    return None


def _difference(at: Array, down: Array, reach: int) -> tuple[Array, float]:
    """Central difference over `reach` samples to either side, zero at the ends, and the noise in its mean square.

    The noise of the vertical shows in its third differences; a smooth turn adds little to them.
    """
    rate = np.zeros_like(down)
    span = at[2 * reach :] - at[: -2 * reach]
    usable = span > 0.0
    middle = rate[reach:-reach]
    middle[usable] = (down[2 * reach :] - down[: -2 * reach])[usable] / span[usable, None]
    third = np.diff(down, n=3, axis=0)
    variance = float(np.vdot(third, third)) / len(third) / 20.0 if len(third) else np.inf
    typical = float(np.median(span))
    return rate, 2.0 * variance / typical**2 if typical > 0.0 else np.inf


def lag_of(alignment: AlignmentSolution, turning: Array) -> FieldLag | None:
    """The lag that one more Gauss-Newton step gives to `alignment`, whose vertical turns by `turning` (N, 3).

    The field of ``t`` belongs to the vertical of ``t - lag``, so the second condition changes by ``-dg/dt . B (y - b)``
    a second. None: the movement does not show it.
    """
    column = np.zeros_like(alignment.residuals)
    column[:, 1] = -(turning * alignment.corrected).sum(axis=1) * alignment.sine_weight
    rows = np.concatenate([alignment.rows, column[:, :, None]], axis=2).reshape(-1, alignment.rows.shape[2] + 1)
    size = np.sqrt((rows**2).sum(axis=0))
    if not size[-1] > 0.0:
        return None
    normal = (rows.T @ rows) / np.outer(size, size)
    if not np.linalg.cond(normal) < 1e13:
        return None
    inverse = np.linalg.inv(normal)
    step = -(inverse @ (rows.T @ alignment.residuals.ravel() / size)) / size
    sd = float(np.sqrt(inverse[-1, -1]) / size[-1])
    return FieldLag(float(step[-1]), sd, column) if sd < _LONGEST_LAG else None
