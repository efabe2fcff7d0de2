"""Fit of one compass over one flight: noise, outliers, gyroscope offset and soft iron."""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import EarthField
from mavcal.calib.mag.flight_path import GyroModel, Turning, first_bias, make_path
from mavcal.calib.mag.flight_problem import (
    OFFSET,
    SHAPE,
    Flight,
    FlightPrior,
    FlightSolution,
    Layout,
    predicted,
    solve,
    without,
)

Array = NDArray[np.float64]

SOFT_IRON_SD = 0.1
"""Largest prior standard deviation of the matrix entries that is tried."""
LEAST_SOFT_IRON_SD = 0.01
"""Smallest one: no compass is known better."""
DIRECTION_SD = math.radians(0.5)
"""Standard deviation of the field's direction about the model's, due to crust and site, rad."""
GYRO_BIAS_SD = 0.1  # rad/s
GYRO_SCALE_SD = 0.01
DELAY_SD = 0.05  # s
BLUR_SD = 4e-4
"""Standard deviation of the blur, s2, from unknown averages and filters of 0.1 s."""
MOUNTING_SD = math.radians(2.0)
"""Standard deviation of a compass's mounting about each axis, rad."""
JITTER = 3e-3
"""Standard deviation of a sample's time stamp, s, apart from the constant delay: one loop of the firmware."""
LEVEL_SD = math.radians(1.5)
_FIXED_SD = 1e-6  # rad, of the first attitude where it is a matter of choice
_OUTLIER = 6.0  # standard deviations of a sample's length
_PATHS = 4  # times the gyroscope is integrated again
_STRAIGHT = 0.03  # rad of error up to which that is not needed
_FIRST_NOISE = 0.02  # of the field
_MEDIAN_LENGTH = 1.538  # median length of three unit normals
_NOISE_TIME = 5.0  # s, over which the noise counts as the same
_LEAST_IN_MEDIAN = 8  # samples
_LEAST_NOISE = 1e-4  # of the field
_LONGEST_LAG = 0.1  # of the samples, over which residuals are held to be correlated


@dataclass(frozen=True, eq=False)
class Samples:
    """A compass in body axes: times (N,), values (N, 3), drives (N, p); correction in force, its `matrix` inverted.

    Each sample is a mean over the `window` (s) before its time; `quantum` as in :class:`calib.recording.Channel`.
    """

    t: Array
    y: Array
    drives: Array
    matrix: Array
    quantum: float
    window: float


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Priors: the field (None: unknown), sd of the soft iron (0: as in force), sd of the motors by drive."""

    field: EarthField | None
    soft_iron_sd: float


@dataclass(frozen=True, eq=False)
class FlightEstimate:
    """A fit: unknowns, the flight with its weights, the noise of a sample and how correlated it is in time."""

    solved: FlightSolution
    flight: Flight
    prior: FlightPrior
    layout: Layout
    model: GyroModel
    noise: Array
    """Noise of each sample (N,)."""
    inflation: float

    @property
    def x(self) -> Array:
        """The unknowns, :class:`calib.mag.flight_problem.Layout`."""
        return self.solved.x

    @property
    def used(self) -> int:
        """Number of samples with weight."""
        return int(np.count_nonzero(self.flight.weights > 0.0))

    def outside(self, rows: NDArray[np.bool_]) -> Array:
        """Residuals (M, 3) in `rows` of a fit that did not see them."""
        hidden = without(self.flight, rows)
        solved = solve(hidden, self.prior, self.solved.x, self.solved.knots)
        x, motor = solved.x.copy(), self.layout.motor
        half = 3 * (self.layout.drives // 2)
        x[motor][half:] = x[motor][:half]  # a firmware compensates fast changes like slow ones
        return np.asarray((hidden.y - predicted(hidden, x, solved.knots))[rows])


def estimate(samples: Samples, turning: Turning, known: Knowledge) -> FlightEstimate:
    """Fit `samples` of a vehicle that turned as `turning` says.

    Raises
    ------
    UndeterminedError
        If a parameter is entirely undetermined.
    """
    model = GyroModel.steady(first_bias(turning))
    path = make_path(turning, samples.t, model, None, samples.window)
    flight = Flight(samples.y, samples.drives, path, np.ones(len(samples.t)), np.ones(len(samples.t)))
    layout = Layout(samples.drives.shape[1])
    x, size = _start(samples, flight, layout, known)
    flight = dataclasses.replace(flight, variance=np.full(len(samples.t), (_FIRST_NOISE * size) ** 2))
    for number in range(_PATHS):
        prior = _prior(samples, turning, known, model, layout, x=x, size=size)
        solved = solve(flight, prior, x)
        flight, noise, inflation = _weighed(flight, solved, samples, size)
        solved = solve(flight, prior, solved.x, solved.knots)
        flight, noise, inflation = _weighed(flight, solved, samples, size)
        bent = float(np.abs(solved.knots[:, :3]).max())
        if turning.gyro is None or number == _PATHS - 1 or bent < _STRAIGHT:
            break
        model = GyroModel(
            flight.path.knots_t, flight.path.bias + solved.knots[:, 3:], model.scale + solved.x[layout.scale]
        )
        start = np.asarray(Rotation.from_rotvec(solved.knots[0, :3]).as_matrix()) @ flight.path.knot_rotations[0]
        x = solved.x.copy()
        x[layout.scale] = 0.0
        if turning.attitude is None:  # the world is where the flight begins: nothing turned it
            start = flight.path.knot_rotations[0]
        flight = dataclasses.replace(flight, path=make_path(turning, samples.t, model, start, samples.window))
    solved = solve(flight, prior, solved.x, solved.knots)
    return FlightEstimate(solved, flight, prior, layout, model, noise, inflation)


def estimated_soft_iron_sd(found: FlightEstimate) -> float:
    """Most likely sd of the soft-iron entries, from those that the data determine.

    `found` was fitted with :data:`SOFT_IRON_SD`. The information on the entries from its likelihood alone is ``P^-1 -
    1/sd^2``, which gives each prior's evidence in closed form.
    """
    inverse = np.linalg.inv(found.solved.covariance[SHAPE, SHAPE])
    change = found.x[SHAPE] - found.prior.mean[SHAPE]
    values, vectors = np.linalg.eigh(inverse - np.eye(6) / SOFT_IRON_SD**2)
    values = np.clip(values, 0.0, None)
    projected = vectors.T @ (inverse @ change)
    tried = np.geomspace(LEAST_SOFT_IRON_SD, SOFT_IRON_SD, 15)
    evidence = [
        float((-0.5 * np.log1p(sd**2 * values) + 0.5 * projected**2 / (values + 1.0 / sd**2)).sum()) for sd in tried
    ]
    return float(tried[int(np.argmax(evidence))])


def _start(samples: Samples, flight: Flight, layout: Layout, known: Knowledge) -> tuple[Array, float]:
    """Unknowns to begin with, and the strength of the field in the unit of the samples."""
    x = np.zeros(layout.size)
    x[SHAPE] = samples.matrix[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    through = samples.matrix @ np.swapaxes(flight.path.rotations, 1, 2)
    if known.field is not None:
        x[layout.field] = known.field.north_east_down
    else:
        # prefer a small field and a small offset: a flight that hardly turns cannot separate them
        rows = np.concatenate([through, np.broadcast_to(np.eye(3), through.shape)], axis=2).reshape(-1, 6)
        ridge = 0.02 * math.sqrt(len(samples.t)) * np.diag([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])
        both = np.vstack([rows, ridge])
        x[layout.field] = np.linalg.lstsq(both, np.append(samples.y.ravel(), np.zeros(6)), rcond=None)[0][:3]
    size = float(np.linalg.norm(x[layout.field])) or 1.0
    x[OFFSET] = np.median(samples.y - through @ x[layout.field], axis=0)
    return x, size


def _prior(
    samples: Samples,
    turning: Turning,
    known: Knowledge,
    model: GyroModel,
    layout: Layout,
    *,
    x: Array,
    size: float,
) -> FlightPrior:
    mean, sd = np.zeros(layout.size), np.full(layout.size, np.inf)
    mean[SHAPE] = samples.matrix[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    sd[SHAPE] = known.soft_iron_sd
    if layout.drives:
        strongest = np.abs(samples.drives).max(axis=0)
        sd[layout.motor] = np.repeat(size / np.maximum(strongest, 1e-9), 3)
    mean[layout.scale], sd[layout.scale] = -model.scale, GYRO_SCALE_SD
    sd[layout.delay], sd[layout.blur], sd[layout.level] = DELAY_SD, BLUR_SD, LEVEL_SD
    sd[layout.mounting] = MOUNTING_SD
    if turning.gyro is None:
        sd[layout.scale] = 0.0
    start = np.full(3, np.inf)
    if turning.attitude is None:
        start, sd[layout.level] = np.full(3, _FIXED_SD), 0.0
    if turning.attitude is not None and known.field is not None:
        mean[layout.field] = known.field.north_east_down
        sd[layout.field] = math.hypot(known.field.norm_sd, DIRECTION_SD * size)
    elif turning.attitude is not None:
        start = np.array([np.inf, np.inf, _FIXED_SD])  # where north is does not matter
        mean[layout.field], sd[layout.field] = x[layout.field], 2.0 * size
    else:
        mean[layout.field], sd[layout.field] = x[layout.field], 2.0 * size
    return FlightPrior(mean, sd, np.append(start, np.full(3, GYRO_BIAS_SD)))


def _weighed(flight: Flight, solved: FlightSolution, samples: Samples, size: float) -> tuple[Flight, Array, float]:
    """The flight with the noise of its residuals and without outliers; that noise (N,), and its correlation.

    The noise is local in time: a vehicle at rest is quieter than in flight.
    """
    length = np.linalg.norm(solved.residuals, axis=1)
    floor = math.hypot(samples.quantum / math.sqrt(12.0), _LEAST_NOISE * size)
    noise = np.maximum(_local_median(samples.t, length) / _MEDIAN_LENGTH, floor)
    weights = np.clip(1.0 - (length / (_OUTLIER * noise)) ** 2, 0.0, None) ** 2
    kept = weights > 0.0
    standard = solved.residuals[kept] / noise[kept, None]
    excess = math.sqrt(float((weights[kept, None] * standard**2).sum()) / float(3.0 * weights.sum()))
    swing = np.linalg.norm(flight.path.rates, axis=1)
    noise = np.hypot(noise * max(excess, 1.0), JITTER * size * swing)
    inflation = correlation_time(standard)
    return dataclasses.replace(flight, variance=noise**2 * inflation, weights=weights), noise, inflation


def _local_median(t: Array, length: Array) -> Array:
    """Median of `length` (N,) over some seconds about each of `t` (N,)."""
    edges = np.arange(t[0], t[-1] + _NOISE_TIME, _NOISE_TIME)
    rows = np.searchsorted(t, edges)
    middles, medians = [], []
    for first, last in itertools.pairwise(rows):
        if last - first >= _LEAST_IN_MEDIAN:
            middles.append(float(t[first:last].mean()))
            medians.append(float(np.median(length[first:last])))
    return np.interp(t, middles, medians) if middles else np.full(len(t), float(np.median(length)))


def correlation_time(residuals: Array) -> float:
    """Correlation time of `residuals` (N, 3), in samples: ``1 + 2 sum of correlations``, up to the first small one.

    >>> correlation_time(np.tile([[1.0, -1.0, 1.0], [-1.0, 1.0, -1.0]], (50, 1)))
    1.0
    """
    centred = residuals - residuals.mean(axis=0)
    power = float((centred**2).sum())
    if power <= 0.0 or len(residuals) < 8:
        return 1.0
    longest = max(int(_LONGEST_LAG * len(residuals)), 1)
    width = fft.next_fast_len(len(residuals) + longest, real=True)
    spectrum = np.abs(fft.rfft(centred, width, axis=0)) ** 2
    correlations = fft.irfft(spectrum.sum(axis=1), width)[1 : longest + 1] / power
    small = np.flatnonzero(correlations < 0.05)
    until = int(small[0]) if len(small) else len(correlations)
    return max(1.0 + 2.0 * float(correlations[:until].sum()), 1.0)
