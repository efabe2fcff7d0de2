"""Gyroscope offset at rest, and the test that tells a rest from a steady turn."""

from __future__ import annotations

import numpy as np

from mavcal.calib.fit import AXES, OFFSETS, FitBuilder, FitResult
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.correlated import long_run_variance
from mavcal.calib.stats.quantisation import QuantisedMean, mean_of
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.triad import TriadModel, drift_sd_deg_per_min

PLAUSIBLE_BIAS = 0.1
"""Rate, rad/s (5.7 deg/s), above which a gyroscope alone does not count as at rest. Consumer gyroscopes are specified
within +-5 deg/s (ICM-20602, ICM-42688, BMI088: +-1); a hand or a turntable turns faster."""
LARGEST_BIAS = 0.35
"""Largest rate at rest, rad/s (20 deg/s: the zero-rate tolerance of the MPU-6000), if a compass stands still."""
METHOD = "gyro-rest"
MOVEMENT = "put it down and leave it alone for five seconds"
_LEAST_SAMPLES = 32
_WANDER = 0.002
"""Change of rate within a rest, rad/s (0.1 deg/s), below which drift does not count as motion."""


def fit_gyro_rest(
    gyro: Channel,
    *,
    accel: Channel | None = None,
    mag: Channel | None = None,
    temperature: float | None = None,
    relative: bool = False,
) -> FitResult:
    """Offset of a gyroscope from samples at rest: their mean (METHODS S1), by maximum likelihood where bins are coarse.

    Parameters
    ----------
    gyro : Channel
        Raw samples of one still span (or several, joined), rad/s or counts.
    accel, mag : Channel or None
        Accelerometer and compass over the same time, which tell a steady turn from a bias. None: only the size of the
        rate does. In counts nothing does, and the result says so.
    temperature : float or None
        Mean temperature of the sensor, degC.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        The offset with its covariance, serial correlation included; Earth's rate (7.3e-5 rad/s) is inside it. Refused
        if the vehicle moved or turned, or there are too few samples.
    """
    made = FitBuilder.of(METHOD, gyro, relative=relative, temperature=temperature, movement=MOVEMENT)
    gyro = gyro.take(finite_rows(gyro.values))
    if len(gyro) < _LEAST_SAMPLES:
        return made.refused(f"{len(gyro)} finite samples of the gyroscope: {_LEAST_SAMPLES} are needed", OFFSETS)
    if not gyro.t[-1] > gyro.t[0]:
        message = f"all {len(gyro)} samples carry one time: whether the vehicle rested cannot be told; record again"
        return made.refused(message, OFFSETS)
    estimate = mean_of(gyro)
    reason = _movement_reason(gyro, estimate)
    if reason is None and gyro.unit == "rad/s":
        reason = steady_turn(gyro, accel, mag)
    if reason is not None:
        return made.refused(f"{reason}; put the vehicle down, leave it alone and try again", OFFSETS)
    silent = np.array(estimate.constant) & (gyro.quantum <= 0.0)  # a constant of unknown resolution
    if silent.all():
        message = "the gyroscope reads one constant value on every axis: it is stuck or not connected"
        return made.refused(message, OFFSETS)
    covariance = np.zeros((12, 12))
    covariance[:3, :3] = estimate.covariance
    covariance[:3, :3][silent] = 0.0
    covariance[:3, :3][:, silent] = 0.0
    residual = gyro.values - estimate.mean
    model = TriadModel(offset=np.where(silent, 0.0, estimate.mean))
    finer = "record it on a stream of finer resolution, or see whether the axis is stuck"
    return made.fitted(
        model,
        covariance,
        message=f"offset of {len(gyro)} samples at rest",
        n_used=len(gyro),
        residual_rms=float(np.sqrt((residual**2).mean())),
        condition_number=1.0,
        undetermined={OFFSETS[i]: finer for i in range(3) if silent[i]},
        warnings=_warnings(gyro, estimate),
        quality={
            "n_effective": estimate.n_effective,
            "noise_sd": [float(sd) if np.isfinite(sd) else None for sd in estimate.sd],
            "one_bin": [AXES[i] for i in range(3) if estimate.constant[i]],
            "began": float(gyro.t[0]),
            "duration": float(gyro.t[-1] - gyro.t[0]),
            **residual_statistics(residual, 3 * (len(gyro) - 1), None),
            "attitude_sd_deg_per_min": drift_sd_deg_per_min(model, covariance) if gyro.unit == "rad/s" else None,
        },
        native={"mean": estimate.mean.tolist()},
    )


def steady_turn(gyro: Channel, accel: Channel | None = None, mag: Channel | None = None) -> str | None:
    """Why the constant rate of a still span is a turn and not a bias; None if it may be a bias.

    Gravity that turns with the rate, or a compass that turns, is evidence of a turn. A rate above
    :data:`PLAUSIBLE_BIAS` is evidence too, or above :data:`LARGEST_BIAS` where a compass stands still.
    """
    rate = mean_of(gyro).mean
    size = float(np.linalg.norm(rate))
    if accel is not None and finite_rows(accel.values).sum() >= 16 and _gravity_follows(rate, accel):
        return f"gravity turns with the {np.degrees(size):.2f} deg/s that the gyroscope reads: the vehicle is turning"
    compass_moves = _compass_moves(mag) if mag is not None and len(mag) >= 8 else None
    if compass_moves:
        return (
            f"the compass turns while the gyroscope reads a steady {np.degrees(size):.2f} deg/s: the vehicle is turning"
        )
    bound = PLAUSIBLE_BIAS if compass_moves is None else LARGEST_BIAS
    if size > bound:
        return (
            f"the gyroscope reads a steady {np.degrees(size):.1f} deg/s, more than a bias "
            f"({np.degrees(bound):.1f} deg/s): the vehicle is turning, or the sensor is broken"
        )
    return None


def _movement_reason(gyro: Channel, estimate: QuantisedMean) -> str | None:
    """Why the samples are not one rest: the means of the four quarters differ by more than noise and drift."""
    quarters = np.array_split(np.arange(len(gyro)), 4)
    for axis, name in enumerate(AXES):
        x = gyro.values[:, axis]
        means = np.array([x[rows].mean() for rows in quarters])
        variance = np.array([long_run_variance(x[rows]) / len(rows) for rows in quarters])
        variance += gyro.quantum**2 / 12.0
        spread = float(np.ptp(means))
        noise = 6.0 * float(np.sqrt(2.0 * variance.mean()))
        floor = _WANDER if gyro.unit == "rad/s" else 2.0 * float(np.nan_to_num(estimate.sd[axis]))
        if spread > floor + noise:
            text = f"{np.degrees(spread):.2f} deg/s" if gyro.unit == "rad/s" else f"{spread:.1f} {gyro.unit}"
            return f"the rate about {name} changed by {text} between the parts of the rest: the vehicle moved"
    return None


def _warnings(gyro: Channel, estimate: QuantisedMean) -> tuple[str, ...]:
    warnings = []
    names = ", ".join(AXES[i] for i in range(3) if estimate.constant[i])
    if names and gyro.quantum > 0.0:
        warnings.append(
            f"every sample of {names} lies in one bin of {gyro.quantum:.4g} {gyro.unit}: the offset is anywhere in it, "
            "and more samples do not help; a finer stream (HIGHRES_IMU) does"
        )
    elif names:
        warnings.append(f"{names} reads one constant value: not estimated, the axis is stuck or too coarse")
    if gyro.unit != "rad/s":
        warnings.append(f"in {gyro.unit} a steady turn cannot be told from a bias")
    return tuple(warnings)


def _gravity_follows(rate: Array, accel: Channel) -> bool:
    """Whether gravity moves through a span as with a turn at `rate`, ``da/dt = -w x a``."""
    accel = accel.take(finite_rows(accel.values))
    predicted = -np.cross(rate, accel.values.mean(axis=0))
    size = float(np.linalg.norm(predicted))
    since = accel.t - accel.t.mean()
    squares = float(since @ since)
    if size == 0.0 or squares == 0.0:
        return False
    along = (accel.values - accel.values.mean(axis=0)) @ (predicted / size)
    slope = float(since @ along) / squares
    sd = np.sqrt(long_run_variance(along - slope * since) / squares)
    return bool(slope > 0.5 * size and slope > 5.0 * sd)


def _compass_moves(mag: Channel) -> bool:
    """Whether a compass scatters by half a microtesla or more, and far more than from sample to sample."""
    values = mag.values[finite_rows(mag.values)]
    if len(values) < 8:
        return False
    scatter = float(np.sqrt(values.var(axis=0, ddof=1).sum()))
    step = float(np.sqrt(0.5 * (np.diff(values, axis=0) ** 2).mean(axis=0).sum()))
    return scatter > 3.0 * step and scatter > 0.5
