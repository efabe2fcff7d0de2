"""The still poses of a recording: which spans they are, and what both sensors read in them, with honest noise.

The noise of a sensor is the same in every pose, so it is pooled; a pose keeps its own only where it is clearly more (a
hand that sways). Sway turns the body, so it shows across gravity and not along it. A movement begins and ends at the
mean direction of a pose, which sway makes uncertain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.geometry import frame_along, sphere_of
from mavcal.calib.imu.static import ScatterWindows, candidates, steady
from mavcal.calib.recording import Channel
from mavcal.calib.stats.correlated import long_run_variance
from mavcal.calib.stats.norm_fit import NormProblem, solve
from mavcal.calib.stats.quantisation import mean_of
from mavcal.calib.stats.stillness import HOLD_S

Array = NDArray[np.float64]

LEAST_POSES = 4
_CLEARLY = 2.5  # times the pooled long-run variance: more than chance, the pose has noise of its own
_SWAY = 1.3  # times the noise across gravity from which on it is sway
_TINY = 1e-9  # of a radius: noise that even exact numbers are given
_LEAST_VARIANCE = 1e-30  # of any unit
_WEAK_CROSS = 0.03  # prior sd of cross terms where candidates are compared


@dataclass(frozen=True, eq=False)
class Poses:
    """P still poses in the units of the sensors.

    `spans` (P, 2) s; `means` (P, 3) and their `covariances` (P, 3, 3); `wander` (P,) variance of the direction by
    sway, rad^2; `rates` (P, 3) means of the gyroscope with `rate_variances` (P, 3); `gyro_noise` (3,) long-run variance
    of a sample; `counts` and `gyro_counts` (P,) samples of either, `noise_sd` the noise of one of the accelerometer.
    """

    spans: Array
    means: Array
    covariances: Array
    wander: Array
    rates: Array
    rate_variances: Array
    gyro_noise: Array
    counts: NDArray[np.intp]
    gyro_counts: NDArray[np.intp]
    noise_sd: float

    def __len__(self) -> int:
        return len(self.spans)


def find_poses(accel: Channel, gyro: Channel, gravity: float | None, min_still: float = HOLD_S) -> Array:
    """Spans (P, 2) of the still poses, of the detector's limits that leave the accelerometer known best.

    For every rung of the ladder the accelerometer is fitted to the means of the poses; the rung with the smallest mean
    logarithm of its variances wins, times the residuals' reduced chi-square: more poses count, poses that were not
    still count against.

    Parameters
    ----------
    accel, gyro
        Finite samples of the same time.
    gravity
        In the unit of `accel`; None: the radius of the quiet readings.
    min_still
        s for which a pose was held at least.
    """
    size = gravity if gravity is not None else _radius(accel, gyro)
    watch = ScatterWindows.of(accel, gyro, size, min_still / HOLD_S)
    best, chosen = np.inf, np.zeros((0, 2))
    for spans in candidates(watch):
        spans = spans[steady(accel, spans, size)]
        if len(spans) < LEAST_POSES:
            if len(spans) > len(chosen) and not np.isfinite(best):
                chosen = spans
            continue
        uncertainty = _uncertainty(accel, spans, gravity, watch.accel_floor)
        if uncertainty < best or len(chosen) < LEAST_POSES:
            best, chosen = uncertainty, spans
    return chosen


def measure(accel: Channel, gyro: Channel, spans: Array) -> Poses:
    """What both channels read in `spans`; each span holds two or more samples of both."""
    parts = [accel.between(*span) for span in spans]
    frames = [frame_along(part.values.mean(axis=0)) for part in parts]
    estimates = [mean_of(part) for part in parts]
    counts = np.array([len(part) for part in parts])
    scatter = np.array([part.values.var(axis=0, ddof=1) for part in parts])
    pooled, quiet = _quietest(scatter)
    pooled = np.maximum(pooled, accel.quantum**2 / 12.0)
    radius = float(np.median([np.linalg.norm(e.mean) for e in estimates]))
    tiny = (_TINY * radius) ** 2 + _LEAST_VARIANCE
    expected = np.array([np.einsum("ij,i,ij->j", f, pooled, f) for f in frames]) + tiny
    series = [e.influence @ f for e, f in zip(estimates, frames, strict=True)]
    long_run = np.array([[long_run_variance(column) for column in s.T] for s in series])
    usual = max(float(np.median((long_run[:, 0] / expected[:, 0])[quiet])), 1.0)
    variance = np.where(long_run > _CLEARLY * usual * expected, long_run, usual * expected)
    covariances = np.array(
        [
            (f * v / n) @ f.T + np.diag(e.bin_variance)
            for f, v, n, e in zip(frames, variance, counts, estimates, strict=True)
        ]
    )
    across = np.array([s[:, 1:].var(axis=0, ddof=1) for s in series]).mean(axis=1)
    noise = expected[:, 1:].mean(axis=1)
    wander = np.where(across > _SWAY * noise, across - noise, 0.0) / max(radius**2, _LEAST_VARIANCE)
    rates, rate_variances, gyro_noise = _rates(gyro, spans)
    return Poses(
        spans=spans,
        means=np.array([e.mean for e in estimates]),
        covariances=covariances,
        wander=wander,
        rates=rates,
        rate_variances=rate_variances,
        gyro_noise=gyro_noise,
        counts=counts,
        gyro_counts=np.array([len(gyro.between(*span)) for span in spans]),
        noise_sd=float(np.sqrt(pooled.mean())),
    )


def _rates(gyro: Channel, spans: Array) -> tuple[Array, Array, Array]:
    """Mean rates (P, 3), the variance of each, and the long-run variance (3,) of a sample."""
    parts = [gyro.between(*span) for span in spans]
    estimates = [mean_of(part) for part in parts]
    scatter = np.array([part.values.var(axis=0, ddof=1) for part in parts])
    pooled, quiet = _quietest(scatter)
    pooled = np.maximum(pooled, gyro.quantum**2 / 12.0)
    pooled = np.maximum(pooled, (_TINY * float(np.abs(gyro.values).max())) ** 2 + _LEAST_VARIANCE)
    long_run = np.array([[long_run_variance(column) for column in e.influence.T] for e in estimates])
    usual = max(float(np.median((long_run / pooled)[quiet])), 1.0)
    noise = usual * pooled
    own = np.where(long_run > _CLEARLY * noise, long_run, noise)
    variances = own / np.array([[len(part)] for part in parts]) + np.array([e.bin_variance for e in estimates])
    return np.array([e.mean for e in estimates]), variances, noise


def _quietest(scatter: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Variance (3,) of a sample in the poses of `scatter` (P, 3) that nothing shakes, and which those are."""
    total = scatter.sum(axis=1)
    quiet = total <= 1.5 * np.quantile(total, 0.25)
    return scatter[quiet].mean(axis=0), quiet


def _uncertainty(accel: Channel, spans: Array, gravity: float | None, floor: float) -> float:
    """Mean logarithm of the accelerometer's variances by those poses, with the misfit in it."""
    means, counts = _plain_means(accel, spans)
    centre, radius = (np.zeros(3), gravity) if gravity is not None else sphere_of(means)
    prior = np.zeros(9)
    prior[6:] = 1.0 / _WEAK_CROSS**2
    variance = (floor**2 / 3.0 / counts + (_TINY * radius) ** 2) / radius**2
    problem = NormProblem(means / radius, variance[:, None, None] * np.eye(3), radius, centre / radius, 1.0, prior)
    solution = solve(problem, weak=True)
    if solution is None:
        return np.inf
    chi2 = float(solution.residuals @ solution.residuals)
    misfit = (chi2 + 2.0) / (max(len(spans) - 9, 0) + 2.0)
    return float(np.linalg.slogdet(solution.covariance)[1]) / 9.0 + float(np.log(max(misfit, 1.0)))


def _plain_means(channel: Channel, spans: Array) -> tuple[Array, NDArray[np.intp]]:
    """Means (P, 3) of the samples in `spans`, and how many they are."""
    i, j = np.searchsorted(channel.t, spans[:, 0]), np.searchsorted(channel.t, spans[:, 1])
    origin = channel.values.mean(axis=0)
    sums = np.vstack([np.zeros(3), np.cumsum(channel.values - origin, axis=0)])
    counts = np.maximum(j - i, 1)
    return origin + (sums[j] - sums[i]) / counts[:, None], counts


def _radius(accel: Channel, gyro: Channel) -> float:
    """Radius of the readings of the quietest windows, where gravity is not known in their unit."""
    watch = ScatterWindows.of(accel, gyro, np.inf)
    quiet = watch.still(4.0, 6.0)
    means = watch.accel.mean[quiet if quiet.sum() >= 8 else np.ones(len(quiet), dtype=np.bool_)]
    return sphere_of(means)[1]
