"""Magnetometer against accelerometer: offset, full matrix and mounting from turning in all directions (METHODS 3.2).

An ellipsoid leaves a rotation open; the angle between field and vertical, which is the same in every attitude, closes
it. Both sensors' noise counts (:mod:`calib.mag.align_solve`). The accelerometer must be calibrated: its errors are
taken for noise of the vertical.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError, UndeterminedError
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.align_lag import FieldLag, lag_of, turning_of
from mavcal.calib.mag.align_result import AlignFit, aligned_result
from mavcal.calib.mag.align_solve import AlignmentNoise, AlignmentSolution, align, misclosures
from mavcal.calib.mag.align_start import linear_start, two_stage_start
from mavcal.calib.mag.context import MagContext, MagFacts
from mavcal.calib.mag.orientation import QUIET, interpolated
from mavcal.calib.mag.result import refusal
from mavcal.calib.mag.robust import MAD_TO_SD, MOST_OUTLIERS, OUTLIER
from mavcal.calib.mag.samples import check_not_flat, check_samples
from mavcal.calib.mag.serial import LONGEST, weakened_information

Array = NDArray[np.float64]

METHOD = "mag-align"

FEWEST = 30
"""Samples below which nothing is said."""

_TRIMS = 5
_SHIFTS = 4
_SURE = 3.0  # standard deviations from which on a lag is believed and taken out
_SETTLED = 0.3  # standard deviations, of a lag that is the last
ALL_SIDES = "turn the vehicle slowly so that every side points up and down once, about two axes or more"


@dataclass(frozen=True, eq=False)
class Vertical:
    """An accelerometer, and a gyroscope that may be None, each at its own times.

    `accel` (M, 3) is corrected specific force; `gravity` its length at rest, in the same unit. `gyro` (K, 3) in rad/s
    only serves the time offset. `timed` False: the times are counted rows, and no time offset is looked for.
    """

    t: Array
    accel: Array
    gravity: float = STANDARD_GRAVITY
    gyro_t: Array | None = None
    gyro: Array | None = None
    timed: bool = True


def fit_alignment(
    t: ArrayLike,
    samples: ArrayLike,
    vertical: Vertical,
    *,
    gate: float = QUIET,
    time_offset: float | None = None,
    **facts: Unpack[MagFacts],
) -> FitResult:
    """Offset and full matrix of a magnetometer in the axes of an accelerometer.

    Parameters
    ----------
    t : shape (N,)
        Times of the samples, s, on the clock of `vertical`.
    samples : shape (N, 3)
        N >= 30 in different directions, in order of time.
    vertical
        What shows which way is down.
    gate
        Departure of the specific force from gravity, relative, up to which it counts as the vertical.
    time_offset
        By how much the magnetometer is later than the accelerometer, s. None: tested, and taken out where it is sure.
    **facts
        What is known of sensor and field: :class:`calib.mag.result.MagContext`.

    Returns
    -------
    FitResult
        Refused, with the movement that is missing, where the data leave part of it open. ``quality`` has the dip, the
        mounting angle, both noises and the time offset, each with its standard deviation.

    Raises
    ------
    InvalidInputError
        If shapes do not match, numbers are not finite, or an option is impossible.
    """
    context = MagContext(**facts)
    times, array = np.asarray(t, dtype=np.float64), np.asarray(samples, dtype=np.float64)
    _check(times, array, vertical, gate, time_offset)
    try:
        fit = _aligned(times, check_samples(array, FEWEST), vertical, gate, time_offset, context)
        return aligned_result(METHOD, fit, context, len(array))
    except UndeterminedError as error:
        return refusal(METHOD, error, len(array), context)


def _check(t: Array, samples: Array, vertical: Vertical, gate: float, time_offset: float | None) -> None:
    accel = vertical.accel
    if samples.ndim != 2 or len(t) != len(samples) or accel.ndim != 2 or len(vertical.t) != len(accel):
        raise InvalidInputError(
            f"{len(t)} times for samples of shape {samples.shape}, {len(vertical.t)} for accelerations of shape "
            f"{accel.shape}: one row a time is needed"
        )
    if not (np.isfinite(accel).all() and np.isfinite(t).all() and np.isfinite(vertical.t).all()):
        raise InvalidInputError("times and accelerations must be finite: drop the other rows first")
    if (np.diff(vertical.t) < 0.0).any() or (np.diff(t) < 0.0).any():
        raise InvalidInputError("times go back: sort the samples, or cut the recording there")
    if not 0.0 < gate < 1.0:
        raise InvalidInputError(f"the gate on specific force is between 0 and 1, not {gate}")
    if not (math.isfinite(vertical.gravity) and vertical.gravity > 0.0):
        raise InvalidInputError(f"gravity must be positive, not {vertical.gravity}")
    if time_offset is not None and not math.isfinite(time_offset):
        raise InvalidInputError(f"a time offset is a number of seconds, not {time_offset}")


def _aligned(
    t: Array, samples: Array, vertical: Vertical, gate: float, time_offset: float | None, context: MagContext
) -> AlignFit:
    """The fit, with the lag that is stated, or found and sure."""
    shift = time_offset or 0.0
    fit = _at_lag(t, samples, vertical, gate, shift, context, search=time_offset is None)
    for _ in range(_SHIFTS):
        lag = fit.lag
        if lag is None or time_offset is not None or not abs(lag.value) > _SURE * lag.sd:
            break
        shift += lag.value
        fit = _at_lag(t, samples, vertical, gate, shift, context, search=True)
        if fit.lag is None or abs(fit.lag.value) < _SETTLED * fit.lag.sd:
            break
    return fit


def _at_lag(
    t: Array, samples: Array, vertical: Vertical, gate: float, shift: float, context: MagContext, *, search: bool
) -> AlignFit:
    """The fit of samples whose vertical is that of `shift` seconds before."""
    at = t - shift
    force = interpolated(at, vertical.t, vertical.accel)
    inside = (at >= vertical.t[0]) & (at <= vertical.t[-1])
    length = np.sqrt(np.einsum("ij,ij->i", force, force))
    used = inside & (np.abs(length / vertical.gravity - 1.0) <= gate)
    n_used = int(np.count_nonzero(used))
    if n_used < FEWEST:
        raise UndeterminedError(
            f"{n_used} of {len(samples)} samples show the vertical (|accel| within {gate:.0%} of "
            f"{vertical.gravity:.4g}; its median is {np.median(length):.4g}): {FEWEST} are needed",
            remedy="turn the vehicle more slowly; check the unit and the calibration of the accelerometer",
        )
    turning = turning_of(at, vertical, force) if search and vertical.timed else None
    down = -force[used] / length[used, None]
    field = samples[used]
    centre = field.mean(axis=0)
    scale = float(np.sqrt(((field - centre) ** 2).sum(axis=1).mean()))
    if not scale > 0.0:
        raise UndeterminedError("the field never changes", remedy=ALL_SIDES)
    scaled = (field - centre) / scale
    check_not_flat(scaled.T @ scaled / len(scaled))
    least = AlignmentNoise(context.quantum / math.sqrt(12.0) / scale, 0.0)
    alignment, kept = _without_outliers(scaled, down, scale, least)
    lag = None if turning is None else lag_of(alignment, turning[used][kept])
    information, inflation = _information(alignment, lag)
    return AlignFit(
        alignment=alignment,
        centre=centre,
        scale=scale,
        information=information,
        variance_inflation=inflation,
        down=down[kept],
        lag=lag,
        shift=shift,
        n_gated=len(samples) - n_used,
        n_outliers=int(np.count_nonzero(~kept)),
    )


def _without_outliers(
    field: Array, down: Array, scale: float, least: AlignmentNoise
) -> tuple[AlignmentSolution, NDArray[np.bool_]]:
    """The alignment without samples beyond six standard deviations of the others, and which ones it is of.

    Raises
    ------
    UndeterminedError
        Naming what is missing.
    """
    try:
        return _trimmed(field, down, linear_start(field, down), least)
    except UndeterminedError:  # outliers, or a movement that leaves the linear system open
        return _trimmed(field, down, two_stage_start(field, down, scale), least)


def _trimmed(
    field: Array, down: Array, start: Array, least: AlignmentNoise
) -> tuple[AlignmentSolution, NDArray[np.bool_]]:
    kept = _near(misclosures(start, field, down))
    for trims_left in range(_TRIMS, -1, -1):
        if np.count_nonzero(kept) < max(FEWEST, (1.0 - MOST_OUTLIERS) * len(field)):
            raise UndeterminedError(
                f"{np.count_nonzero(~kept)} of {len(field)} samples fit no common field and vertical",
                remedy="keep away from steel, magnets and currents, turn slowly, and repeat",
            )
        found = align(field[kept], down[kept], start, None, least)
        good = _near(found.residuals)
        if good.all() or not trims_left:
            break
        kept[np.flatnonzero(kept)[~good]] = False
        start = found.unknowns
    return found, kept


def _near(residuals: Array) -> NDArray[np.bool_]:
    """Which rows (N, 2) are within six standard deviations of the others, and of rounding."""
    size = np.abs(residuals)
    return np.asarray((size <= OUTLIER * MAD_TO_SD * np.median(size, axis=0) + 1e-9).all(axis=1))


def _information(alignment: AlignmentSolution, lag: FieldLag | None) -> tuple[Array, float]:
    """Information (13, 13) on the unknowns, less what is correlated in time and what an unknown lag takes."""
    rows = alignment.rows if lag is None else np.concatenate([alignment.rows, lag.column[:, :, None]], axis=2)
    flat = rows.reshape(-1, rows.shape[2])
    size = np.sqrt((flat**2).sum(axis=0))
    scores = np.einsum("nki,nk->in", rows[:LONGEST], alignment.residuals[:LONGEST]) / size[:, None]
    weak, inflation = weakened_information((flat.T @ flat) / np.outer(size, size), scores, np.ones(scores.shape[1]))
    weak = weak * np.outer(size, size)
    if lag is None:
        return weak, inflation
    return weak[:13, :13] - np.outer(weak[:13, 13], weak[:13, 13]) / weak[13, 13], inflation
