"""Still poses of a recording: their spans, and both sensors' means with noise.

A sensor's noise is the same in every pose, so it is pooled. A pose keeps its own noise only if that is clearly larger,
as with a swaying hand. Sway turns the body, so it shows across gravity and not along it. A movement begins and ends at
the mean direction of a pose, which sway makes uncertain.

Windows begin every quarter of their length. In each, the scatter of accelerometer and gyroscope about a straight line
is measured. A window is still if both stay below a multiple of the scatter of the quietest windows. Half a window is
cut off at both ends of every still span; a span whose halves disagree is discarded (METHODS 3.3). Several multiples are
tried; the one that leaves the accelerometer known best, misfit included, is taken. This criterion is per residual, so
it does not favour few poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.geometry import frame_along, sphere_of
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.correlated import long_run_variance
from mavcal.calib.stats.norm_fit import NormProblem, solve
from mavcal.calib.stats.quantisation import mean_of
from mavcal.calib.stats.still_limits import HOLD_S
from mavcal.calib.stats.windows import Windows, occupied_starts, window_statistics

LEAST_POSES = 4
_CLEARLY = 2.5  # times the pooled long-run variance: more than chance, the pose has noise of its own
_SWAY = 1.3  # times the noise across gravity from which on it is sway
_TINY = 1e-9  # of a radius: noise that even exact numbers are given
_LEAST_VARIANCE = 1e-30  # of any unit
_WEAK_CROSS = 0.03  # prior sd of cross terms where candidates are compared
ACCEL_LADDER = (1.5, 2.5, 4.0, 8.0)
GYRO_LADDER = (1.5, 3.0, 6.0, 12.0)
"""Multiples of the quietest windows' scatter that are tried."""
_WINDOW = 0.5  # s
_LEAST_SAMPLES = 10  # of a window
_TILT = 0.01  # rad across a window, beyond its noise: it turns slowly
_HALVES = 0.01  # of gravity, beyond their noise: the halves of a pose differ
_SHORTEST = 1.0  # windows that a span must last after its guards
_QUIET = 0.1  # quantile that is called the quietest


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
    """Spans (P, 2) of the still poses, by the detector limits that leave the accelerometer known best.

    For every pair of limits the accelerometer is fitted to the means of the poses. Its variances are multiplied by the
    residuals' reduced chi-square; the smallest mean logarithm wins. More poses lower it, and poses that were not still
    raise it.

    Parameters
    ----------
    accel, gyro
        Finite samples of the same time.
    gravity
        Gravity in the unit of `accel`; None: the radius of the quiet readings.
    min_still
        Least time that a pose was held, s.
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
    """Means of both channels over `spans`; each span holds two or more samples of both."""
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
    """Variance (3,) of a sample in the undisturbed poses of `scatter` (P, 3), and the mask (P,) of these."""
    total = scatter.sum(axis=1)
    quiet = total <= 1.5 * np.quantile(total, 0.25)
    return scatter[quiet].mean(axis=0), quiet


def _uncertainty(accel: Channel, spans: Array, gravity: float | None, floor: float) -> float:
    """Mean logarithm of the accelerometer's variances from these poses, misfit included."""
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


@dataclass(frozen=True, eq=False)
class ScatterWindows:
    """Scatter of both sensors over windows that begin at `starts` (M,), `length` long."""

    starts: Array
    length: float
    accel: Windows
    gyro: Windows
    accel_floor: float
    gyro_floor: float
    gravity: float

    @classmethod
    def of(cls, accel: Channel, gyro: Channel, gravity: float, part: float = 1.0) -> ScatterWindows:
        """The scatter of two channels of finite samples over their common time; `gravity` in the unit of `accel`.

        `part` scales the usual window, for poses held for less or more time than usual.
        """
        begin, end = max(accel.t[0], gyro.t[0]), min(accel.t[-1], gyro.t[-1])
        step = max(_median_step(accel), _median_step(gyro))
        length = max(part * _WINDOW, _LEAST_SAMPLES * step)
        starts = occupied_starts(accel.t, begin, end, length)
        both = [window_statistics(c.t, c.values, begin, starts, length) for c in (accel, gyro)]
        floors = [_floor(windows, c.quantum) for windows, c in zip(both, (accel, gyro), strict=True)]
        return cls(starts, length, both[0], both[1], floors[0], floors[1], gravity)

    def still(self, accel_factor: float, gyro_factor: float) -> NDArray[np.bool_]:
        """Mask of the windows that are still at those multiples of the quietest scatter."""
        limit = gyro_factor * self.gyro_floor
        quiet = (self.accel.scatter <= accel_factor * self.accel_floor) & (self.gyro.scatter <= limit)
        full = (self.accel.n >= _LEAST_SAMPLES // 2) & (self.gyro.n >= _LEAST_SAMPLES // 2)
        noise = 4.0 * self.accel.scatter * np.sqrt(12.0 / np.maximum(self.accel.n, 1))
        level = np.linalg.norm(self.accel.change, axis=1) <= _TILT * self.gravity + noise
        quiet &= full & level
        if not quiet.any():
            return quiet
        usual = np.median(self.gyro.mean[quiet], axis=0)
        return np.asarray(quiet & (np.linalg.norm(self.gyro.mean - usual, axis=1) <= limit))


def candidates(watch: ScatterWindows) -> Iterator[Array]:
    """Spans (P, 2) of the still poses for every pair of limits, without repetition."""
    seen = set()
    for gyro_factor in GYRO_LADDER:
        for accel_factor in ACCEL_LADDER:
            still = watch.still(accel_factor, gyro_factor)
            if still.tobytes() in seen:
                continue
            seen.add(still.tobytes())
            yield _spans(watch, still)


def _spans(watch: ScatterWindows, still: NDArray[np.bool_]) -> Array:
    """Spans of consecutive still windows, cut by half a window at each end that borders on motion."""
    apart = np.diff(watch.starts) > 0.3 * watch.length  # a hole in the recording
    first = np.flatnonzero(still & np.concatenate([[True], ~still[:-1] | apart]))
    last = np.flatnonzero(still & np.concatenate([~still[1:] | apart, [True]]))
    guard = 0.5 * watch.length
    begins = watch.starts[first] + np.where(first > 0, guard, 0.0)
    ends = watch.starts[last] + watch.length - np.where(last < len(still) - 1, guard, 0.0)
    spans = np.column_stack([begins, ends])
    return spans[ends - begins >= _SHORTEST * watch.length]


def steady(accel: Channel, spans: Array, gravity: float) -> NDArray[np.bool_]:
    """Mask of `spans` (P, 2): True where both halves read the same, within noise and a hand's sway."""
    keep = np.zeros(len(spans), dtype=np.bool_)
    for k, (start, end) in enumerate(spans):
        values = accel.between(start, end).values
        if len(values) < _LEAST_SAMPLES:
            continue
        halves = values[: len(values) // 2], values[len(values) // 2 :]
        noise = np.sqrt(sum(half.var(axis=0, ddof=1).sum() / len(half) for half in halves))
        apart = float(np.linalg.norm(halves[0].mean(axis=0) - halves[1].mean(axis=0)))
        keep[k] = apart <= _HALVES * gravity + 4.0 * float(noise)
    return keep


def _median_step(channel: Channel) -> float:
    return float(np.median(np.diff(channel.t)))


def _floor(windows: Windows, quantum: float) -> float:
    """Scatter of the quietest windows; that of the quantisation alone if there is no noise."""
    usable = windows.n >= _LEAST_SAMPLES // 2
    quietest = float(np.quantile(windows.scatter[usable], _QUIET)) if usable.any() else 0.0
    largest = float(np.abs(windows.mean[usable]).max(initial=0.0))
    return float(max(quietest, quantum * np.sqrt(3.0 / 12.0), 1e-7 * largest, 1e-300))
