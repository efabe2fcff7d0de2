"""Magnetometer against accelerometer: offset, full matrix and mounting from turning in all directions (METHODS 3.2).

An ellipsoid leaves a rotation undetermined; the angle between field and vertical, equal in every attitude, determines
it. Both sensors' noise counts (:mod:`calib.mag.align_solve`). The accelerometer must be calibrated: its errors count as
noise of the vertical.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.errors import InvalidInputError, UndeterminedError, require_positive
from mavcal.calib.fit import FitResult
from mavcal.calib.mag.align_solve import (
    AlignmentNoise,
    AlignmentSolution,
    FieldLag,
    align,
    check_dip,
    lag_of,
    linear_start,
    misclosures,
    turning_of,
    two_stage_start,
)
from mavcal.calib.mag.coverage import mask_bytes, visited
from mavcal.calib.mag.orientation import QUIET, interpolated
from mavcal.calib.mag.result import (
    FIELD_TOLERANCE,
    SCALE_UNKNOWN,
    CompassFit,
    MagContext,
    MagFacts,
    array_forms,
    compass_result,
    field_quality,
    mounting_of,
    refusal,
    rotation_covariance,
    undetermined_parameters,
    with_strength_sd,
)
from mavcal.calib.mag.robust import MAD_TO_SD, MOST_OUTLIERS, OUTLIER
from mavcal.calib.mag.samples import axis_word, check_not_flat, check_samples
from mavcal.calib.mag.serial import LONGEST, weakened_information
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import Array, TriadModel

METHOD = "mag-align"

FEWEST = 30
"""Least number of samples."""

_ROUGHEST = 0.15  # of the field, residuals from which on nothing is explained
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


@dataclass(frozen=True, eq=False)
class AlignFit:
    """Solution in scaled samples ``(y - centre) / scale``, with its information and diagnostics."""

    alignment: AlignmentSolution
    centre: Array
    scale: float
    information: Array
    """(13, 13), reduced for serial correlation and for an unknown lag."""
    variance_inflation: float
    down: Array
    lag: FieldLag | None
    """Lag left after `shift`, and its uncertainty; None: it was stated, or the movement does not show it."""
    shift: float
    n_gated: int
    n_outliers: int

    @property
    def noise_sd(self) -> float:
        """Noise of one axis of the field, in the unit of the samples."""
        return self.alignment.noise.field * self.scale

    @property
    def radius(self) -> float:
        """Strength of the field in the unit of the samples: the geometric mean of the ellipsoid's axes."""
        return self.scale / float(np.cbrt(np.linalg.det(self.alignment.matrix)))

    @property
    def sine(self) -> float:
        """Sine of the dip."""
        return float(self.alignment.unknowns[12])

    def model(self, strength: float | None) -> tuple[TriadModel, Array]:
        """Offset and matrix ``F B`` with their covariance (12, 12); without a strength F makes ``det C = 1``."""
        B = self.alignment.matrix / self.scale
        inverse = np.linalg.inv(B)
        factor = strength if strength is not None else 1.0 / float(np.cbrt(np.linalg.det(B)))
        jacobian = np.zeros((12, 13))
        jacobian[:3, 9:12] = self.scale * np.eye(3)
        by_matrix = np.eye(9) if strength is not None else np.eye(9) - np.outer(B.ravel(), inverse.T.ravel()) / 3.0
        jacobian[3:, :9] = factor / self.scale * by_matrix
        size = np.sqrt(np.diag(self.information))
        covariance = np.linalg.inv(self.information / np.outer(size, size)) / np.outer(size, size)
        spread = jacobian @ covariance @ jacobian.T
        model = TriadModel(self.centre + self.scale * self.alignment.unknowns[9:12], factor * B)
        return model, 0.5 * (spread + spread.T)

    def sine_sd(self) -> float:
        """Standard deviation of the sine of the dip."""
        size = np.sqrt(np.diag(self.information))
        return math.sqrt(float(np.linalg.inv(self.information / np.outer(size, size))[12, 12])) / float(size[12])


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
        Sensor that shows the vertical.
    gate
        Departure of the specific force from gravity, relative, up to which it counts as the vertical.
    time_offset
        Delay of the magnetometer against the accelerometer, s. None: estimated, and removed if significant.
    **facts
        Known facts of sensor and field, as in :class:`calib.mag.result.MagContext`.

    Returns
    -------
    FitResult
        Refused, with the missing movement, where part of it is undetermined. ``quality`` has the dip, the mounting
        angle, both noises and the time offset, each with its standard deviation.

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
        return _result(fit, context, len(array))
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
    require_positive(vertical.gravity)
    if time_offset is not None and not math.isfinite(time_offset):
        raise InvalidInputError(f"a time offset is a number of seconds, not {time_offset}")


def _aligned(
    t: Array, samples: Array, vertical: Vertical, gate: float, time_offset: float | None, context: MagContext
) -> AlignFit:
    """The fit with the stated lag, or with a significant estimated one."""
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
    turning = turning_of(at, force, vertical.gyro_t, vertical.gyro) if search and vertical.timed else None
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
    """The alignment without samples beyond six standard deviations of the others, and the mask of those used.

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
    """Mask of rows (N, 2) within six standard deviations of the others, and of rounding."""
    size = np.abs(residuals)
    return np.asarray((size <= OUTLIER * MAD_TO_SD * np.median(size, axis=0) + 1e-9).all(axis=1))


def _information(alignment: AlignmentSolution, lag: FieldLag | None) -> tuple[Array, float]:
    """Information (13, 13) on the unknowns, reduced for serial correlation and for an unknown lag."""
    rows = alignment.rows if lag is None else np.concatenate([alignment.rows, lag.column[:, :, None]], axis=2)
    flat = rows.reshape(-1, rows.shape[2])
    size = np.sqrt((flat**2).sum(axis=0))
    scores = np.einsum("nki,nk->in", rows[:LONGEST], alignment.residuals[:LONGEST]) / size[:, None]
    weak, inflation = weakened_information((flat.T @ flat) / np.outer(size, size), scores, np.ones(scores.shape[1]))
    weak = weak * np.outer(size, size)
    if lag is None:
        return weak, inflation
    return weak[:13, :13] - np.outer(weak[:13, 13], weak[:13, 13]) / weak[13, 13], inflation


def _result(fit: AlignFit, context: MagContext, n_samples: int) -> FitResult:
    """The verdict on `fit`.

    Raises
    ------
    UndeterminedError
        If the data leave part of it undetermined; names the necessary movement or place.
    """
    noise = math.hypot(fit.noise_sd / fit.radius, fit.alignment.noise.vertical)
    if noise > _ROUGHEST:
        raise UndeterminedError(
            f"field and vertical disagree by {noise:.0%}: the field changed while turning, or the accelerometer felt "
            "more than gravity",
            remedy="keep away from steel, magnets and currents, turn slowly, calibrate the accelerometer, and repeat",
        )
    cosine = check_dip(fit.sine, noise)
    model, covariance = fit.model(context.strength)
    covariance = with_strength_sd(covariance, model, context.field)
    _check_determined(model, covariance, fit.radius)
    quality = _quality(fit, context, model, covariance, cosine)
    size = np.sqrt(np.diag(fit.information))
    return compass_result(
        CompassFit(
            METHOD,
            model,
            covariance,
            n_samples=n_samples,
            n_used=len(fit.alignment.residuals),
            message=(
                f"mounting {quality['mounting_deg']:.2f} deg known to {quality['mounting_sd_deg']:.2g} deg, heading "
                f"good to {quality['heading_sd_deg']:.2g} deg at a dip of {quality['dip_deg']:.1f} deg"
            ),
            residual_rms=quality["residual_rms"],
            condition_number=float(np.linalg.cond(fit.information / np.outer(size, size))),
            quality=quality,
            native={
                "B": (fit.alignment.matrix / fit.scale).tolist(),
                "b": model.offset.tolist(),
                "sin_dip": fit.sine,
                "rotation": model.rotation.tolist(),
                "symmetric": model.symmetric().matrix.tolist(),
                "form": "|B (y - b)| = 1, down . B (y - b) = sin_dip",
                **array_forms(model, context.instance),
            },
            warnings=_warnings(fit, context, quality),
        ),
        context,
    )


def _check_determined(model: TriadModel, covariance: Array, radius: float) -> None:
    names = undetermined_parameters(model, covariance, radius)
    if not names:
        return
    turn, offset = rotation_covariance(model, covariance), covariance[:3, :3] / radius**2
    (turn_worst, turn_axes), (worst, axes) = np.linalg.eigh(turn), np.linalg.eigh(offset)
    if turn_worst[-1] > worst[-1]:
        axis = axis_word(turn_axes[:, -1])
        remedy = f"hold the vehicle with its {axis} axis level, pointing east and west, and tilt it to all sides"
    else:
        remedy = f"turn the vehicle so that its {axis_word(axes[:, -1])} axis points up and down as well"
    raise UndeterminedError(f"the movement does not determine {', '.join(names)}", missing=names, remedy=remedy)


def _quality(fit: AlignFit, context: MagContext, model: TriadModel, covariance: Array, cosine: float) -> dict[str, Any]:
    found, lag = fit.alignment, fit.lag
    dof = 2 * len(found.residuals) - len(found.unknowns)
    of_field = found.residuals[:, 0] * fit.noise_sd
    noise = None if context.noise_variance is None else math.sqrt(context.noise_variance)
    chi2 = residual_statistics(of_field, len(of_field) - 9, noise)
    both = residual_statistics(found.residuals, dof, None)
    dip, seen = math.atan2(fit.sine, cosine), visited(found.corrected)
    return {
        **chi2,
        "first_correlation": both["first_correlation"],
        "white": both["white"],
        "residual_rms": math.sqrt(float((of_field**2).mean())),
        "noise_sd": fit.noise_sd,
        "vertical_noise_deg": math.degrees(found.noise.vertical),
        "variance_inflation": fit.variance_inflation,
        "n_outliers": fit.n_outliers,
        "n_gated": fit.n_gated,
        "dip_deg": math.degrees(dip),
        "dip_sd_deg": math.degrees(fit.sine_sd() / cosine),
        **mounting_of(model, covariance),
        **field_quality(model, covariance, fit.radius, dip, context),
        "time_offset": fit.shift,
        "time_offset_left": None if lag is None else lag.value,
        "time_offset_sd": None if lag is None else lag.sd * math.sqrt(fit.variance_inflation),
        "coverage_mask": mask_bytes(seen),
        "coverage": float(seen.mean()),
    }


def _warnings(fit: AlignFit, context: MagContext, quality: dict[str, Any]) -> tuple[str, ...]:
    found = []
    if context.strength is None:
        found.append(SCALE_UNKNOWN)
    ratio = quality["field_ratio"]
    if ratio is not None and abs(ratio - 1.0) > FIELD_TOLERANCE:
        found.append(f"the measured field is {ratio:.2f} times the stated one: steel or a magnet is near")
    if fit.n_gated:
        found.append(f"{fit.n_gated} samples were left out: the accelerometer felt more than gravity, or had no sample")
    if fit.n_outliers:
        found.append(f"{fit.n_outliers} samples do not fit the field and the vertical of the others and were left out")
    if quality["variance_inflation"] > 1.5:
        found.append(
            f"the residuals wander (variance x {quality['variance_inflation']:.1f}): motion, currents or an "
            "accelerometer that is not calibrated; the stated uncertainty includes it"
        )
    if fit.shift:
        found.append(f"the magnetometer was taken as {fit.shift * 1e3:.1f} ms later than the accelerometer")
    elif fit.lag is None:
        found.append("nothing is said of a time offset between the sensors: no times, or too little turning")
    return tuple(found)
