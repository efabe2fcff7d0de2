"""Drift with temperature: a straight line (S2) and a polynomial, with errors that hold under coloured noise.

A still sensor is regressed on its own temperature in a scaled variable, by normal equations summed over blocks of time
(conditioning and speed: METHODS S2). A slow wander of the sensor looks like drift; how much of it there is follows
from the residuals (:func:`calib.noise.coloured_regression`), so that the sd stays true.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.drift import DriftBlocks, DriftCurve, DriftData, repeated_rows, thermal_lag
from calib.errors import InvalidInputError
from calib.fit import AXES, FitResult, FitStatus, parameter_names, refused
from calib.noise import ColouredCovariance
from calib.quantisation import COARSE, impute, interval_regression
from calib.recording import Channel, Sensor
from calib.triad import ThermalPolynomial, TriadModel

Array = NDArray[np.float64]

LINEAR_METHOD = "thermal-linear"
POLYNOMIAL_METHOD = "thermal-poly"

_SMALLEST_NOISE = 0.02  # of a quantum
_MANY = 20_000  # samples beyond which equal ones are counted instead of listed


def fit_linear(
    channel: Channel,
    temperature: Array,
    *,
    t_ref: float = 25.0,
    through: Array | None = None,
    min_span: float = 2.0,
    relative: bool = False,
) -> FitResult:
    """Slope of every axis against temperature, ``corrected = raw - k (T - t_ref)`` (METHODS S2).

    Parameters
    ----------
    channel
        Samples of a motionless sensor, any unit.
    temperature : shape (N,)
        At every sample, degC.
    t_ref : float
        Temperature at which nothing is corrected; 0 is the published form.
    through : shape (3,) or None
        Values that the lines must take at `t_ref`: the slope through a fixed point, another estimator. None: least
        squares with an intercept.
    min_span : float
        Least range of temperature, degC.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        Slopes in ``model.polynomial``, with an sd that holds under slow wander of the sensor. Offsets are not part of
        this method and are named as undetermined; an axis that reads one constant value is named, not estimated.
    """
    data = DriftData.of(channel, temperature)
    reason = data.refusal(1, min_span)
    if reason:
        return _refused(LINEAR_METHOD, channel, reason)
    x = data.t - t_ref
    fixed = None if through is None else np.asarray(through, dtype=np.float64)
    repeated = repeated_rows(data)
    fresh = data.rows(~repeated)
    blocks = DriftBlocks.of(x, data.time, data.y, degree=1, origin=fixed)
    noise = DriftBlocks.of(x[~repeated], fresh.time, fresh.y, degree=1, origin=fixed).noise()
    slope_row = 0 if fixed is not None else 1
    slopes = blocks.ordinary[slope_row]
    variance = noise.covariances[:, slope_row, slope_row]
    estimated = ~data.constant
    covariance = np.zeros((15, 15))
    covariance[12:, 12:] = np.diag(np.where(estimated, variance, 0.0))
    residual = blocks.residual_sd()
    warnings = list(_common_warnings(data, estimated))
    if repeated.any():
        warnings.append(
            f"{int(repeated.sum())} of {data.n} rows repeat earlier rows exactly: they count as weights, and not as "
            "new information for the sd"
        )
    weak = ", ".join(AXES[i] for i in range(3) if estimated[i] and slopes[i] ** 2 < 4.0 * variance[i])
    if weak:
        warnings.append(f"the slope of {weak} is not larger than twice its own sd: it may be no drift of temperature")
    intercepts = blocks.ordinary[0] if fixed is None else fixed
    undetermined = parameter_names()[:3] + tuple(f"poly1_{AXES[i]}" for i in range(3) if not estimated[i])
    return FitResult(
        method=LINEAR_METHOD,
        sensor=channel.sensor,
        instance=channel.instance,
        status=FitStatus.OK if estimated.all() else FitStatus.PARTIAL,
        message=_said("slope", data, estimated),
        model=TriadModel(
            polynomial=ThermalPolynomial(t_ref, data.t_min, data.t_max, np.where(estimated, slopes, 0.0)[:, None])
        ),
        covariance=covariance,
        unit=channel.unit,
        n_samples=len(channel),
        n_used=data.n,
        residual_rms=float(np.sqrt((residual[estimated] ** 2).mean())) if estimated.any() else 0.0,
        condition_number=blocks.condition,
        relative=relative,
        undetermined=undetermined,
        warnings=tuple(warnings),
        temperature=t_ref,
        quality={**_quality(data, noise, estimated), "repeated_rows": int(repeated.sum())},
        native={
            "slopes": _or_none(slopes, estimated),
            "intercepts": _or_none(intercepts, estimated),
            "t_ref": t_ref,
            "form": "least_squares" if fixed is None else "through_point",
            "residual_sd": _or_none(residual, estimated),
            "raw_sd": _or_none(data.y.std(axis=0, ddof=1), estimated),
        },
    )


def fit_polynomial(
    channel: Channel,
    temperature: Array,
    *,
    degree: int = 3,
    t_ref: float = 35.0,
    min_span: float = 10.0,
    relative: bool = False,
) -> FitResult:
    """Polynomial of every axis against temperature about `t_ref`, as both firmwares store it.

    Parameters
    ----------
    channel
        Samples of a motionless sensor in the order of time; coarse bins are treated as intervals.
    temperature : shape (N,)
        At every sample, degC.
    degree : int
        1 to 5.
    t_ref : float
        Where the polynomial is zero, degC.
    min_span : float
        Least range of temperature, degC; less is refused by name.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        The offset is that at `t_ref` for a gyroscope; for an accelerometer in one pose it is undetermined (gravity and
        tilt are inside it) and only the shape counts. ``quality["drift"]`` is each axis' range over the span and
        ``quality["drift_sd"]`` the largest sd of the curve about its mean. An axis whose wander does not repeat with
        temperature, one of a constant value, and one seen on too few levels are named and left at zero.
    """
    if not 1 <= degree <= 5:
        raise InvalidInputError(f"the degree of a thermal polynomial is 1 to 5, not {degree}")
    data = DriftData.of(channel, temperature)
    reason = data.refusal(degree, min_span)
    if reason:
        return _refused(POLYNOMIAL_METHOD, channel, reason)
    middle, half_span = 0.5 * (data.t_min + data.t_max), 0.5 * data.span
    x = (data.t - middle) / half_span
    axes = _fit_axes(channel, data, x, degree)
    curve = DriftCurve.of(axes.coefficients, axes.noise, middle, half_span, t_ref)
    too_coarse = axes.too_coarse
    declined = ~data.constant & ~too_coarse & curve.not_repeatable(axes.noise)
    estimated = ~(data.constant | too_coarse | declined)
    shape_only = channel.sensor != Sensor.GYRO
    model, covariance, undetermined = curve.model(data, t_ref, estimated, shape_only=shape_only)
    residual = axes.residual_sd
    lag = thermal_lag(axes.blocks, middle, half_span, estimated)
    warnings = [*_common_warnings(data, estimated | too_coarse | declined)]
    warnings += _declined_warnings(declined, too_coarse, channel)
    if lag is not None:
        warnings.append(
            f"warming and cooling disagree: the sensor lags its thermometer by about {lag:.0f} s; let it change slower"
        )
    message = _said("polynomial", data, estimated)
    return FitResult(
        method=POLYNOMIAL_METHOD,
        sensor=channel.sensor,
        instance=channel.instance,
        status=FitStatus.OK if estimated.all() else FitStatus.PARTIAL,
        message=message,
        model=model,
        covariance=covariance,
        unit=channel.unit,
        n_samples=len(channel),
        n_used=data.n,
        residual_rms=float(np.sqrt((residual[estimated] ** 2).mean())) if estimated.any() else 0.0,
        condition_number=axes.blocks.condition,
        relative=relative,
        undetermined=undetermined,
        warnings=tuple(warnings),
        temperature=t_ref,
        quality={
            **_quality(data, axes.noise, estimated),
            "drift": _or_none(curve.drift, ~data.constant),
            "drift_sd": _or_none(curve.drift_sd, ~data.constant),
            "lag_s": lag,
        },
        native={"residual_sd": _or_none(residual, estimated), "degree": degree},
    )


@dataclass(frozen=True, eq=False)
class _Axes:
    """Curves of the three axes in the scaled variable, each with the treatment that its bins need."""

    blocks: DriftBlocks  # of the samples as they are
    coefficients: Array  # (p, 3)
    noise: ColouredCovariance
    residual_sd: Array
    too_coarse: NDArray[np.bool_]


def _fit_axes(channel: Channel, data: DriftData, x: Array, degree: int) -> _Axes:
    blocks = DriftBlocks.of(x, data.time, data.y, degree=degree)
    plain = blocks.noise()
    coefficients, residual = blocks.ordinary.copy(), blocks.residual_sd()
    covariances, whiteness, excess = plain.covariances.copy(), plain.whiteness.copy(), plain.excess.copy()
    too_coarse = np.zeros(3, dtype=np.bool_)
    for axis in range(3):
        if data.half is None:
            break
        y, half = data.y[:, axis], data.half[:, axis]
        wide = bool((half > 0.75 * channel.quantum).any())
        if data.constant[axis] or (residual[axis] > COARSE * channel.quantum and not wide):
            continue
        coarse = _coarse_axis(x, data.time, y, half, degree, channel.quantum)
        if coarse is None:
            too_coarse[axis] = True
            continue
        own, residual[axis] = coarse
        noise = own.noise()
        coefficients[:, axis], covariances[axis] = own.ordinary[:, 0], noise.covariances[0]
        whiteness[axis], excess[axis] = noise.whiteness[0], noise.excess[0]
    return _Axes(blocks, coefficients, ColouredCovariance(covariances, whiteness, excess), residual, too_coarse)


def _coarse_axis(
    x: Array, time: Array, y: Array, half: Array, degree: int, quantum: float
) -> tuple[DriftBlocks, float] | None:
    """Block sums of an axis whose noise is smaller than its bins, and that noise; None if too few bins are seen.

    The interval likelihood's estimate is least squares on ``expected + score/information`` with the information of
    each sample as its weight, so the same sums carry on from there.
    """
    design = x[:, None] ** np.arange(degree + 1)
    rows, counts = _distinct(x, y, half, quantum)
    fit = interval_regression(design[rows], y[rows], half[rows], weights=counts, smallest=_SMALLEST_NOISE * quantum)
    levels = len(np.unique(np.round(y[rows] / quantum, 3)))
    if fit.at_limit and levels < degree + 3:
        return None
    expected = design @ fit.coefficients
    mean, variance = impute(y, half, expected, fit.sigma)
    information = np.maximum(1.0 - variance / fit.sigma**2, 1e-9)
    pseudo = expected + (mean - expected) / information
    return DriftBlocks.of(x, time, pseudo[:, None], degree=degree, weights=information), fit.sigma


def _distinct(x: Array, y: Array, half: Array, quantum: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows that stand for all others with the same temperature and bin, and how many each stands for."""
    if len(x) <= _MANY:
        return np.arange(len(x)), np.ones(len(x), dtype=np.intp)
    key = np.round(x * 2e4).astype(np.int64) * 2_000_003 + np.round(y / (1e-3 * quantum)).astype(np.int64)
    _, rows, counts = np.unique(key, return_index=True, return_counts=True)
    return rows, counts


def _refused(method: str, channel: Channel, reason: str) -> FitResult:
    return refused(method, channel.sensor, channel.instance, reason, unit=channel.unit, n_samples=len(channel))


def _said(what: str, data: DriftData, estimated: NDArray[np.bool_]) -> str:
    axes = ", ".join(AXES[i] for i in range(3) if estimated[i]) or "no axis"
    return f"{what} of {axes} over {data.t_min:.1f} to {data.t_max:.1f} degC from {data.n} rows"


def _common_warnings(data: DriftData, estimated: NDArray[np.bool_]) -> tuple[str, ...]:
    warnings = []
    constant = ", ".join(AXES[i] for i in range(3) if data.constant[i] and not estimated[i])
    if constant and data.half is None:
        warnings.append(f"{constant} reads one constant value: not estimated")
    elif constant:
        warnings.append(f"{constant} reads one constant value: its drift is below one bin, not estimated")
    if data.ignored:
        warnings.append(f"{data.ignored} rows without finite numbers were left out")
    return tuple(warnings)


def _declined_warnings(declined: NDArray[np.bool_], too_coarse: NDArray[np.bool_], channel: Channel) -> tuple[str, ...]:
    warnings = []
    if declined.any():
        names = ", ".join(AXES[i] for i in range(3) if declined[i])
        warnings.append(
            f"{names} wanders as much by itself as with temperature: its drift is not repeatable, not estimated"
        )
    if too_coarse.any():
        names = ", ".join(AXES[i] for i in range(3) if too_coarse[i])
        warnings.append(
            f"{names} shows too few levels of {channel.quantum:.3g} {channel.unit}: its drift cannot be resolved"
        )
    return tuple(warnings)


def _quality(data: DriftData, noise: ColouredCovariance, estimated: NDArray[np.bool_]) -> dict[str, Any]:
    return {
        "span": data.span,
        "t_min": data.t_min,
        "t_max": data.t_max,
        "probability_of_white_noise": _or_none(noise.whiteness, estimated),
        "sd_over_white_noise": _or_none(np.sqrt(noise.excess), estimated),
    }


def _or_none(values: Array, known: NDArray[np.bool_]) -> list[float | None]:
    return [float(value) if ok else None for value, ok in zip(values, known, strict=True)]
