"""The thermal fit of one sensor over several still spans, each with its own pose."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.fit import FitResult, FitStatus
from calib.procedures.pool import Pool
from calib.recording import Array, Channel, Sensor
from calib.thermal import fit_polynomial

DEGREE = 3
"""Order of the polynomial that both firmwares store."""

SHORTEST = 10.0
"""A still span shorter than this is left out where the pose changes between spans, s."""


@dataclass(frozen=True)
class Span:
    """A still span that began at `start` (s); `open` while it goes on."""

    start: float
    open: bool = True

    def closed(self) -> Span:
        """The span, ended."""
        return dataclasses.replace(self, open=False)


def fit_drift(pool: Pool, sensor: Sensor, instance: int, spans: Sequence[Span], *, relative: bool) -> FitResult:
    """Cubic drift of one sensor over its kept samples; a new span of an accelerometer is a new pose."""
    channel = pool.channel((sensor, instance))
    thermometer = pool.channel((Sensor.TEMPERATURE, instance))
    if sensor == Sensor.ACCEL and len(spans) > 1:
        number = np.searchsorted([s.start for s in spans], channel.t, side="right") - 1
        return _fit_poses(channel, thermometer, number.astype(np.intp), relative=relative)
    return fit_polynomial(channel, _temperature_at(channel.t, thermometer), degree=DEGREE, relative=relative)


def _temperature_at(t: Array, thermometer: Channel) -> Array:
    return np.asarray(np.interp(t, thermometer.t, thermometer.values[:, 0]), dtype=np.float64)


def _fit_poses(channel: Channel, thermometer: Channel, number: NDArray[np.intp], *, relative: bool) -> FitResult:
    """Offsets of the poses by joint least squares with the curve, then the curve with them taken away.

    Least squares of the curve on ``y - D d`` with the joint estimate d has the joint estimate of the curve; its
    covariance lacks the share of d, at most the largest ratio of the information without poses to that with them.
    """
    lengths = {int(k): float(np.ptp(channel.t[number == k])) for k in np.unique(number)}
    long = [k for k, seconds in lengths.items() if seconds >= SHORTEST]
    rows = np.isin(number, long)
    kept, number = channel.take(rows), number[rows]
    temperature = _temperature_at(kept.t, thermometer)
    if len(long) < 2 or np.ptp(temperature) < 1.0:
        return fit_polynomial(kept, temperature, degree=DEGREE, relative=relative)
    x = (temperature - temperature.mean()) / max(float(np.ptp(temperature)), 1e-9)
    curve = x[:, None] ** np.arange(1, DEGREE + 1)
    poses = (number[:, None] == np.array(long)).astype(np.float64)
    solution = np.linalg.lstsq(np.hstack([poses, curve]), kept.values, rcond=None)[0]
    steps = solution[: len(long)] - solution[0]
    level = dataclasses.replace(kept, values=kept.values - poses @ steps)
    fit = fit_polynomial(level, temperature, degree=DEGREE, relative=relative)
    return _widened(fit, _loss(curve, poses), len(long))


def _loss(curve: Array, poses: Array) -> float:
    """Largest factor by which the unknown poses raise the variance of a combination of the curve's terms."""
    one = curve - curve.mean(axis=0)
    each = curve - poses @ (poses.T @ curve / poses.sum(axis=0)[:, None])
    factor = np.linalg.cholesky(each.T @ each + 1e-12 * np.trace(one.T @ one) * np.eye(len(one.T)))
    half = np.linalg.solve(factor, one.T)
    return max(1.0, float(np.linalg.eigvalsh(half @ half.T)[-1]))


def _widened(fit: FitResult, loss: float, poses: int) -> FitResult:
    if fit.status == FitStatus.REFUSED:
        return fit
    sd = [None if s is None else s * math.sqrt(loss) for s in fit.quality["drift_sd"]]
    text = f"the vehicle was moved: {poses} still spans, each with its own pose"
    return dataclasses.replace(
        fit,
        covariance=fit.covariance * loss,
        warnings=(*fit.warnings, text),
        quality={**fit.quality, "drift_sd": sd, "poses": poses, "variance_for_poses": loss},
    )
