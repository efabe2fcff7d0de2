"""The thermal fit of one sensor over several still spans, each with its own pose."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.limits import THERMAL_DEGREE
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.roster import Instance, TickChannels
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.thermal.cells import DriftCells
from mavcal.calib.thermal.drift import DriftData, powers_about
from mavcal.calib.thermal.fit import PolynomialOptions, fit_drift_data
from mavcal.calib.thermal.thermometer import Thermometer
from mavcal.calib.triad import ThermalPolynomial

_KEPT = frozenset({Sensor.ACCEL, Sensor.GYRO})

SHORTEST = 10.0
"""A still span shorter than this is left out where the pose changes between spans, s."""

_CUBIC = PolynomialOptions(degree=THERMAL_DEGREE)
MOVED = "the vehicle was moved: {} still spans, each with its own pose"
"""Warning about several poses."""


class DriftPool:
    """Samples of every sensor and thermometer over the still spans, in bounded memory."""

    def __init__(self) -> None:
        self._cells: dict[Instance, DriftCells] = {}
        self._thermometers: dict[int, Thermometer] = {}

    def add(self, frame: TickChannels, span: int) -> None:
        """Keep the samples of a tick that belongs to the still span of that number."""
        for (sensor, unit), channel in frame.items():
            if sensor == Sensor.TEMPERATURE:
                self._thermometers.setdefault(unit, Thermometer()).add(channel)
            elif sensor in _KEPT:
                if (sensor, unit) not in self._cells:
                    self._cells[sensor, unit] = DriftCells(channel.values.shape[1])
                self._cells[sensor, unit].add(channel, span)

    def data(self, sensor: Sensor, instance: int) -> tuple[DriftData, NDArray[np.intp]]:
        """Drift data of one sensor, and the number of the still span of each row."""
        cells, thermometer = self._cells[sensor, instance], self._thermometers[instance]
        table = cells.table()
        data = cells.data(thermometer.at(table.time))
        return dataclasses.replace(data, limits=thermometer.limits), table.span

    def __contains__(self, instance: Instance) -> bool:
        sensor, unit = instance
        if sensor == Sensor.TEMPERATURE:
            return unit in self._thermometers and len(self._thermometers[unit]) > 0
        return instance in self._cells and len(self._cells[instance]) > 0

    def __getitem__(self, instance: Instance) -> DriftCells:
        return self._cells[instance]


def fit_drift(pool: DriftPool, sensor: Sensor, instance: int, *, relative: bool) -> FitResult:
    """Cubic drift of one sensor over its kept samples; a new span of an accelerometer is a new pose."""
    data, span = pool.data(sensor, instance)
    channel = pool[sensor, instance].channel
    assert channel is not None
    if sensor == Sensor.ACCEL and len(np.unique(span)) > 1:
        return fit_posed(channel, data, span, _CUBIC, relative=relative)
    return fit_drift_data(channel, data, data.samples, _CUBIC, relative=relative)


def fit_posed(
    channel: Channel,
    data: DriftData,
    number: NDArray[np.intp],
    options: PolynomialOptions,
    *,
    relative: bool = False,
    warning: str = MOVED,
) -> FitResult:
    """Drift of a sensor with one curve, and one offset for each pose, the `number` (N,) of a row.

    The offsets are fitted jointly with the curve, then subtracted before the curve is fitted again. Least squares on
    ``y - D d`` with the joint estimate d gives the joint estimate of the curve. Its covariance lacks the contribution
    of d, which :meth:`PoseOffsets.widened` adds. `warning` has a placeholder for the number of poses.
    """
    poses = PoseOffsets.of(data, number, options.degree)
    one_offset = _of_long(data, number)[0] if poses is None else poses.lowered
    fit = fit_drift_data(channel, one_offset, data.samples, options, relative=relative)
    return fit if poses is None else poses.widened(fit, warning)


@dataclass(frozen=True, eq=False)
class PoseOffsets:
    """Samples with each pose's offset removed, and the covariance that estimating these offsets adds."""

    lowered: DriftData
    steps: Array  # (K, 3) offset of each pose less that of the last
    numbers: NDArray[np.intp]  # (K,) of the poses
    plain: Array  # (d, d) covariance of the powers of the scaled temperature with one constant, noise of one
    posed: Array  # (d, d) the same with a constant for every pose
    middle: float  # degC, where the scaled temperature is zero
    scale: float  # degC

    @classmethod
    def of(cls, data: DriftData, number: NDArray[np.intp], degree: int) -> PoseOffsets | None:
        """Offsets by joint least squares with a curve of that degree; None: fewer than two poses are long enough."""
        data, number = _of_long(data, number)
        long = np.unique(number)
        if len(long) < 2 or data.span < 1.0:
            return None
        x = (data.t - data.t.mean()) / max(data.span, 1e-9)
        root = np.ones(data.n) if data.counts is None else np.sqrt(data.counts)
        curve = x[:, None] ** np.arange(1, degree + 1)
        poses = (number[:, None] == long).astype(np.float64)
        solution = np.linalg.lstsq(root[:, None] * np.hstack([poses, curve]), root[:, None] * data.y, rcond=None)[0]
        steps = solution[: len(long)] - solution[len(long) - 1]
        plain, posed = _covariances(root[:, None] * curve, root[:, None] * poses)
        return cls(data.lowered(poses @ steps), steps, long, plain, posed, float(data.t.mean()), max(data.span, 1e-9))

    @property
    def loss(self) -> float:
        """Largest factor by which unknown poses increase the variance of a combination of the coefficients."""
        half = np.linalg.solve(np.linalg.cholesky(self.plain), np.linalg.cholesky(self.posed))
        return max(1.0, float(np.linalg.eigvalsh(half @ half.T)[-1]))

    def widened(self, fit: FitResult, warning: str = MOVED) -> FitResult:
        """A fit of :attr:`lowered` with its covariance widened for the unknown poses, and a `warning` of their number.

        The congruence between both covariances under white noise is applied to the one under coloured noise. An offset,
        which is that of one pose, gets the largest factor.
        """
        poly = fit.model.polynomial
        if fit.status == FitStatus.REFUSED or poly is None:
            return fit
        degree = fit.degree
        shift = powers_about(poly.t_ref, self.middle, self.scale, degree + 1)[1:, 1:]
        apart = shift @ np.linalg.cholesky(self.posed) @ np.linalg.inv(shift @ np.linalg.cholesky(self.plain))
        whole = np.eye(len(fit.names))
        for axis in range(3):
            rows = slice(12 + axis * degree, 12 + (axis + 1) * degree)
            whole[rows, rows] = apart
            whole[axis, axis] = math.sqrt(self.loss)
        covariance = whole @ fit.covariance @ whole.T
        quality = {**fit.quality, "poses": len(self.numbers), "variance_for_poses": self.loss}
        if "drift_sd" in fit.quality:
            sd = _curve_sd(covariance, poly)
            quality["drift_sd"] = [None if s is None else v for s, v in zip(fit.quality["drift_sd"], sd, strict=True)]
        warnings = (*fit.warnings, warning.format(len(self.numbers)))
        return dataclasses.replace(fit, covariance=covariance, warnings=warnings, quality=quality)


def _curve_sd(covariance: Array, poly: ThermalPolynomial) -> list[float]:
    """Largest sd of every axis' curve about its mean over the range."""
    degree = poly.coefficients.shape[1]
    grid = (np.linspace(poly.t_min, poly.t_max, 33) - poly.t_ref)[:, None] ** np.arange(1, degree + 1)
    centred = grid - grid.mean(axis=0)
    blocks = [covariance[12 + k * degree :, 12 + k * degree :][:degree, :degree] for k in range(3)]
    return [float(np.sqrt(np.maximum(np.einsum("gp,pq,gq->g", centred, b, centred), 0.0)).max()) for b in blocks]


def _of_long(data: DriftData, number: NDArray[np.intp]) -> tuple[DriftData, NDArray[np.intp]]:
    """Only the rows of poses that were held for :data:`SHORTEST`."""
    long = [k for k in np.unique(number) if float(np.ptp(data.time[number == k])) >= SHORTEST]
    keep = np.isin(number, long)
    return data.rows(keep), number[keep]


def _covariances(curve: Array, poses: Array) -> tuple[Array, Array]:
    """Covariances of the curve's terms with one constant, and with one per pose, for unit noise."""
    whole = poses.sum(axis=1, keepdims=True)  # the root of the samples of each row
    one = curve - whole @ (whole.T @ curve) / float((whole**2).sum())
    each = curve - poses @ (poses.T @ curve / (poses**2).sum(axis=0)[:, None])
    least = 1e-12 * float(np.trace(one.T @ one)) * np.eye(len(one.T))
    plain, posed = (np.linalg.inv(part.T @ part + least) for part in (one, each))
    return 0.5 * (plain + plain.T), 0.5 * (posed + posed.T)
