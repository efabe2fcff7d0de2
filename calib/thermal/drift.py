"""Samples against temperature: block sums, and curves with covariance under coloured noise.

The parts of :mod:`calib.thermal.fit`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.polynomial import polynomial as power
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import AXES
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.correlated import ColouredCovariance, coloured_covariance
from mavcal.calib.stats.quantisation import half_widths
from mavcal.calib.triad import ThermalPolynomial, TriadModel

_BLOCKS = 64
_NOT_REPEATABLE = 2.0  # half the drift below this many of its own sd, under coloured noise, is no drift of temperature
_LEAST_SAMPLES = 5
_REPEATED_RUN = 8
_FAR = 2e3  # steps of the samples: beyond that they are shifted before they are squared
_TINY = 1e-300
_COLDEST, _HOTTEST = -100.0, 160.0  # degC, that a sensor works at
_SPIKES_AMONG = 50  # rows below which an extreme is not told from a spike


@dataclass(frozen=True, eq=False)
class TemperatureBins:
    """The bins of one axis: row of the data, middle, half width, and number of samples."""

    rows: NDArray[np.intp]
    values: Array
    half: Array
    counts: Array


@dataclass(frozen=True, eq=False)
class DriftData:
    """The finite samples, or means of many of them, with checks before a fit."""

    time: Array
    t: Array  # degC
    y: Array  # (N, 3)
    half: Array | None  # (N, 3) half widths of the bins; None: not quantised
    constant: NDArray[np.bool_]
    ignored: int
    unsorted: int = 0
    spiked: int = 0
    counts: Array | None = None
    """Number of samples (N,) averaged in each row; None: one."""
    scatter: Array | None = None
    """Sums (3,) of squared deviations of the samples from their rows; None: zero."""
    cell_bins: tuple[TemperatureBins | None, ...] | None = None
    """Per axis, where the rows are means of quantised samples."""
    limits: tuple[float, float] | None = None
    """Lowest and highest temperature, degC, if the rows are means; None: those of `t`."""

    @classmethod
    def of(cls, channel: Channel, temperature: Array) -> DriftData:
        """The finite rows of `channel` (three axes) with one temperature each."""
        t = np.asarray(temperature, dtype=np.float64)
        if t.shape != (len(channel),) or channel.values.shape[1] != 3:
            raise InvalidInputError(
                f"{channel.sensor}: {len(channel)} rows of {channel.values.shape[1]} axes with temperatures of shape "
                f"{t.shape}; one temperature a row of three axes is needed"
            )
        good = np.ones(len(t), dtype=np.bool_)
        if not (np.isfinite(t.sum()) and np.isfinite(channel.values.sum())):  # one pass tells the usual case
            good = np.isfinite(t) & np.isfinite(channel.values).all(axis=1)
        time, y, half = channel.t, channel.values, half_widths(channel) if channel.quantum > 0.0 else None
        if not good.all():
            time, t, y, half = time[good], t[good], y[good], None if half is None else half[good]
        unsorted = int((np.diff(time) < 0).sum())
        if unsorted:
            order = np.argsort(time, kind="stable")
            time, t, y, half = time[order], t[order], y[order], None if half is None else half[order]
        reach = np.array([[y[:, i].min(), y[:, i].max()] for i in range(3)]) if len(y) else np.zeros((3, 2))
        constant = reach[:, 0] == reach[:, 1]
        data = cls(time, t, y, half, constant, int((~good).sum()), unsorted)
        spikes = _spiked(data, reach)
        return data if spikes is None else dataclasses.replace(data.rows(~spikes), spiked=int(spikes.sum()))

    def rows(self, keep: NDArray[np.bool_]) -> DriftData:
        """Only the rows to `keep`; the scatter of means is assumed to be evenly distributed."""
        half = None if self.half is None else self.half[keep]
        counts = None if self.counts is None else self.counts[keep]
        scatter = self.scatter
        if scatter is not None and counts is not None:
            scatter = scatter * (counts.sum() / self.samples)
        bins = None if self.cell_bins is None else tuple(_kept(b, keep) for b in self.cell_bins)
        return dataclasses.replace(
            self,
            time=self.time[keep],
            t=self.t[keep],
            y=self.y[keep],
            half=half,
            counts=counts,
            scatter=scatter,
            cell_bins=bins,
            limits=None,
        )

    def warmed(self, temperature: Array) -> DriftData:
        """The same samples at other temperatures (N,)."""
        return dataclasses.replace(self, t=temperature, limits=None)

    def lowered(self, shift: Array) -> DriftData:
        """The data minus `shift` (N, 3)."""
        if self.cell_bins is None:
            return dataclasses.replace(self, y=self.y - shift)
        bins = tuple(
            None if b is None else dataclasses.replace(b, values=b.values - shift[b.rows, axis])
            for axis, b in enumerate(self.cell_bins)
        )
        return dataclasses.replace(self, y=self.y - shift, cell_bins=bins)

    @property
    def quantised(self) -> bool:
        """Whether the samples are quantised."""
        return self.half is not None or self.cell_bins is not None

    def bins(self, axis: int) -> TemperatureBins | None:
        """The bins of one axis; None where they are fine."""
        if self.cell_bins is not None:
            return self.cell_bins[axis]
        if self.half is None:
            return None
        return TemperatureBins(np.arange(self.n), self.y[:, axis], self.half[:, axis], np.ones(self.n))

    def blocks(self, x: Array, degree: int) -> DriftBlocks:
        """Sums on the powers of `x` (N,)."""
        found = DriftBlocks.of(x, self.time, self.y, degree=degree, weights=self.counts, means=self.counts is not None)
        scatter = 0.0 if self.scatter is None else self.scatter
        return dataclasses.replace(found, squares=found.squares + scatter, n=self.samples)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.n if self.counts is None else int(self.counts.sum())

    @property
    def n(self) -> int:
        """Number of rows."""
        return len(self.t)

    @cached_property
    def t_min(self) -> float:
        """Lowest temperature, degC."""
        return float(self.t.min()) if self.limits is None else self.limits[0]

    @cached_property
    def t_max(self) -> float:
        """Highest temperature, degC."""
        return float(self.t.max()) if self.limits is None else self.limits[1]

    @property
    def span(self) -> float:
        """Range of temperature, degC."""
        return self.t_max - self.t_min

    def refusal(self, degree: int, min_span: float) -> str:
        """Why nothing can be fitted; empty if it can."""
        if self.n < max(_LEAST_SAMPLES, degree + 2):
            return f"{self.n} finite rows: {max(_LEAST_SAMPLES, degree + 2)} are needed for degree {degree}"
        if self.t_min < _COLDEST or self.t_max > _HOTTEST:
            return (
                f"temperatures of {self.t_min:.0f} to {self.t_max:.0f} are no degrees Celsius: is it the raw column, "
                "or another unit?"
            )
        if self.span < min_span:
            return (
                f"the temperature moved by {self.span:.1f} degC ({self.t_min:.1f} to {self.t_max:.1f}): "
                f"{min_span:.0f} are needed; start with a cold board and let it warm up"
            )
        levels = len(np.unique(self.t[:: 1 + self.n // 20_000]))
        if levels < degree + 2:
            return f"{levels} different temperatures are not enough for degree {degree}"
        if self.constant.all() and not self.quantised:
            return "every axis reads one constant value: the sensor is stuck or not connected"
        return ""


def _kept(bins: TemperatureBins | None, keep: NDArray[np.bool_]) -> TemperatureBins | None:
    if bins is None:
        return None
    stay = keep[bins.rows]
    number = np.cumsum(keep) - 1
    return TemperatureBins(number[bins.rows[stay]], bins.values[stay], bins.half[stay], bins.counts[stay])


def _spiked(data: DriftData, reach: Array) -> NDArray[np.bool_] | None:
    """Mask of rows far from their neighbours in time; None if the extremes show no reason to search."""
    if data.n < _SPIKES_AMONG:
        return None
    sample = np.sort(data.y[:: 1 + data.n // 2000], axis=0)
    low, high = sample[len(sample) // 50], sample[-1 - len(sample) // 50]
    margin = 4.0 * (high - low)
    if not ((reach[:, 0] < low - margin) | (reach[:, 1] > high + margin))[margin > 0.0].any():
        return None
    outside = ((data.y < low - margin) | (data.y > high + margin)) & (margin > 0.0)
    return np.asarray(outside.any(axis=1), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class DriftBlocks:
    """Sums over consecutive blocks of time of k series on p powers: the sufficient statistics of a fit."""

    design: Array  # (B, p) means
    series: Array  # (B, k) means
    counts: Array  # (B,) sums of the weights
    time: Array  # (B,)
    gram: Array  # (p, p) over all samples
    ordinary: Array  # (p, k) least squares over all samples
    squares: Array  # (k,) sums of squared residuals
    n: int

    @classmethod
    def of(
        cls,
        x: Array,
        time: Array,
        y: Array,
        *,
        degree: int,
        origin: Array | None = None,
        weights: Array | None = None,
        means: bool = False,
    ) -> DriftBlocks:
        """Sums of the powers of `x` (N,) and of the series `y` (N, k).

        With `origin` (k,) the curves go through it at x = 0 and have no other constant. Without `weights` (N,) every
        sample counts the same. Rows that are `means` of many samples make blocks of fewer rows.
        """
        n, k = y.shape
        edges = np.linspace(0, n, _block_count(n, 2 if means else 8) + 1).astype(int)
        sample = y[:: 1 + n // 1000]
        shift = sample.mean(axis=0)
        if np.abs(shift).max() > _FAR * max(float(np.diff(sample, axis=0).std()) if n > 2 else 0.0, _TINY):
            y, shifted = y - shift, shift  # squares about zero would lose the digits of the scatter
        else:
            shifted = np.zeros(k)
        first = 0 if origin is None else 1
        p = degree + 1 - first
        gram, sums = np.zeros((p + k, p + k)), np.zeros((len(edges) - 1, p + k))
        counts, times = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
        powers = np.empty((degree + 1, int(np.diff(edges).max())))
        powers[0] = 1.0
        for row, (i, j) in enumerate(pairwise(edges)):
            V, Y = powers[:, : j - i], y[i:j]
            for power_of in range(1, degree + 1):
                np.multiply(V[power_of - 1], x[i:j], out=V[power_of])
            W = V if weights is None else V * weights[i:j]
            moments, products = W @ V.T, W @ Y
            gram[:p, :p] += moments[first:, first:]
            gram[:p, p:] += products[first:]
            gram[p:, p:] += Y.T @ (Y if weights is None else Y * weights[i:j, None])
            counts[row] = moments[0, 0]
            sums[row, :p], sums[row, p:] = moments[0, first:], products[0]
            times[row] = time[i:j].mean()
        gram, sums = _about_origin(gram, sums, counts, p, shift - shifted if origin is None else origin - shifted)
        kept = counts > 1e-6 * counts.mean()
        averages = sums[kept] / counts[kept, None]
        ordinary = _least_squares(gram, p)
        squares = np.maximum(np.diag(gram[p:, p:] - gram[p:, :p] @ ordinary), 0.0)
        series = averages[:, p:]
        if origin is None:  # the series were shifted
            ordinary[0] += shift
            series = series + shift
        return cls(averages[:, :p], series, counts[kept], times[kept], gram[:p, :p], ordinary, squares, n)

    @property
    def condition(self) -> float:
        """Condition number of the normal equations."""
        return float(np.linalg.cond(self.gram))

    def residual_sd(self) -> Array:
        """Standard deviation about the curve, per series."""
        return np.asarray(np.sqrt(self.squares / max(self.n - len(self.gram), 1)), dtype=np.float64)

    def noise(self) -> ColouredCovariance:
        """Covariance of the coefficients under coloured noise."""
        return coloured_covariance(self.design, self.series, self.counts, self.time, gram=self.gram)


def _about_origin(gram: Array, sums: Array, counts: Array, p: int, shift: Array) -> tuple[Array, Array]:
    """The sums after subtracting `shift` (k,) from the series."""
    gram, sums = gram.copy(), sums.copy()
    design = sums[:, :p].sum(axis=0)
    total, n = sums[:, p:].sum(axis=0), counts.sum()
    gram[:p, p:] -= np.outer(design, shift)
    gram[p:, p:] += n * np.outer(shift, shift) - np.outer(total, shift) - np.outer(shift, total)
    gram[p:, :p] = gram[:p, p:].T
    sums[:, p:] -= counts[:, None] * shift
    return gram, sums


def _least_squares(gram: Array, p: int) -> Array:
    scale = np.sqrt(np.diag(gram)[:p])
    scaled = gram[:p, :p] / np.outer(scale, scale)
    return np.asarray(np.linalg.solve(scaled, gram[:p, p:] / scale[:, None]) / scale[:, None], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class DriftCurve:
    """The polynomials about t_ref with their covariances, and their range over the span."""

    coefficients: Array  # (p, 3) about t_ref, degC, constant first
    covariances: Array  # (3, p, p)
    drift: Array  # (3,) range over the span
    drift_sd: Array  # (3,) largest sd of the curve about its mean

    @classmethod
    def of(
        cls, coefficients: Array, noise: ColouredCovariance, middle: float, half_span: float, t_ref: float
    ) -> DriftCurve:
        """Curve in powers of ``T - t_ref``, from coefficients of powers of ``(T - middle)/half_span``."""
        p = len(coefficients)
        grid = np.linspace(-1.0, 1.0, 33)[:, None] ** np.arange(p)
        centred = grid - grid.mean(axis=0)
        drift = np.ptp(centred @ coefficients, axis=0)
        spread = np.sqrt(np.maximum(np.einsum("gp,kpq,gq->kg", centred, noise.covariances, centred), 0.0)).max(axis=1)
        shift = powers_about(t_ref, middle, half_span, p)
        return cls(shift @ coefficients, shift @ noise.covariances @ shift.T, drift, spread)

    def widened(self, change: Array) -> DriftCurve:
        """The fit with a nuisance's covariance added: one sd of it changes the coefficients by `change` (p, 3)."""
        return dataclasses.replace(self, covariances=self.covariances + np.einsum("pk,qk->kpq", change, change))

    def not_repeatable(self, noise: ColouredCovariance) -> NDArray[np.bool_]:
        """Mask of axes whose drift does not exceed their slow wander."""
        coloured = (noise.whiteness < 0.05) & (noise.excess > 9.0)
        return np.asarray(coloured & (self.drift < 2.0 * _NOT_REPEATABLE * self.drift_sd), dtype=np.bool_)

    def model(
        self, data: DriftData, t_ref: float, estimated: NDArray[np.bool_], *, shape_only: bool
    ) -> tuple[TriadModel, Array, tuple[str, ...]]:
        """Model, covariance over its parameters, and the names that are not determined."""
        degree = len(self.coefficients) - 1
        covariance = np.zeros((12 + 3 * degree, 12 + 3 * degree))
        undetermined = []
        for axis in range(3):
            rows = [axis, *range(12 + axis * degree, 12 + (axis + 1) * degree)]
            if estimated[axis]:
                covariance[np.ix_(rows, rows)] = self.covariances[axis]
            if shape_only or not estimated[axis]:
                undetermined.append(f"offset_{AXES[axis]}")
                covariance[axis, :] = covariance[:, axis] = 0.0
            if not estimated[axis]:
                undetermined += [f"poly{j}_{AXES[axis]}" for j in range(1, degree + 1)]
        offset = np.zeros(3) if shape_only else np.where(estimated, self.coefficients[0], 0.0)
        shape = np.where(estimated, self.coefficients[1:], 0.0).T
        model = TriadModel(offset=offset, polynomial=ThermalPolynomial(t_ref, data.t_min, data.t_max, shape))
        return model, covariance, tuple(undetermined)


def powers_about(t_ref: float, middle: float, half_span: float, p: int) -> Array:
    """Matrix from coefficients of ``((T - middle)/half_span)^j`` to those of ``(T - t_ref)^k``."""
    line = np.array([(t_ref - middle) / half_span, 1.0 / half_span])
    matrix = np.zeros((p, p))
    for j in range(p):
        expanded = power.polypow(line, j)
        matrix[: len(expanded), j] = expanded
    return matrix


def _block_count(n: int, least: int) -> int:
    """Number of blocks for `n` rows: of `least` rows or more, unless that leaves less than half of the usual number."""
    return n if n <= _BLOCKS // 2 else int(np.clip(n // least, _BLOCKS // 2, _BLOCKS))


def repeated_rows(data: DriftData) -> NDArray[np.bool_]:
    """Mask of rows of a small table that repeat an earlier part of it."""
    repeated = np.zeros(data.n, dtype=np.bool_)
    if data.n > 2000:
        return repeated
    rows = np.column_stack([data.t, data.y])
    for lag in range(1, data.n - _REPEATED_RUN + 1):
        same = np.append((rows[lag:] == rows[:-lag]).all(axis=1), False)
        starts = np.flatnonzero(same & ~np.append(False, same[:-1]))
        ends = np.flatnonzero(~same)
        for start in starts:
            end = int(ends[np.searchsorted(ends, start)])
            if end - start >= _REPEATED_RUN and len(np.unique(rows[start:end], axis=0)) >= _REPEATED_RUN // 2:
                repeated[start + lag : end + lag] = True
    return repeated
