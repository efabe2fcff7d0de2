"""Drift with temperature: a straight line (S2) and a polynomial, with errors that hold under coloured noise.

A still sensor is regressed on its own temperature in a scaled variable, by normal equations summed over blocks of time
(conditioning and speed: METHODS S2). A slow wander of the sensor looks like drift; how much of it there is follows
from the residuals (:func:`calib.noise.coloured_regression`), so that the sd stays true.
"""

from __future__ import annotations

import dataclasses
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

_SMALLEST_NOISE = 0.25
"""Of a quantum: quieter samples are treated as this noisy, or the few at the edges of the bins would decide alone."""


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
    blocks = DriftBlocks.of(x, data, degree=1, intercept=fixed is None, origin=fixed)
    fresh = (
        blocks
        if not repeated.any()
        else DriftBlocks.of(x[~repeated], data.rows(~repeated), degree=1, intercept=fixed is None, origin=fixed)
    )
    slope_row = 0 if fixed is not None else 1
    noise = fresh.noise()
    slopes = blocks.ordinary[slope_row]
    variance = noise.covariances[:, slope_row, slope_row]
    estimated = ~data.constant
    covariance = np.zeros((15, 15))
    covariance[12:, 12:] = np.diag(np.where(estimated, variance, 0.0))
    residual = blocks.residual_rms(estimated)
    warnings = list(_common_warnings(data, estimated))
    if repeated.any():
        warnings.append(
            f"{int(repeated.sum())} of {data.n} rows repeat earlier rows exactly: they count as weights, and not as "
            "new information for the sd"
        )
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
        residual_rms=float(np.sqrt((residual[estimated] ** 2).mean())),
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
    y, too_coarse = _resolved(channel, data, x, degree)
    blocks = DriftBlocks.of(x, dataclasses.replace(data, y=y), degree=degree, intercept=True, origin=None)
    noise = blocks.noise()
    curve = DriftCurve.of(blocks.ordinary, noise, middle, half_span, t_ref)
    declined = ~data.constant & ~too_coarse & curve.not_repeatable(noise)
    estimated = ~(data.constant | too_coarse | declined)
    shape_only = channel.sensor != Sensor.GYRO
    model, covariance, undetermined = curve.model(data, t_ref, estimated, shape_only=shape_only)
    residual = blocks.residual_rms(estimated)
    lag = thermal_lag(blocks, middle, half_span, estimated)
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
        status=FitStatus.OK if estimated.all() else FitStatus.PARTIAL if estimated.any() else FitStatus.REFUSED,
        message=message,
        model=model,
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
        quality={
            **_quality(data, noise, estimated),
            "drift": _or_none(curve.drift, ~data.constant),
            "drift_sd": _or_none(curve.drift_sd, ~data.constant),
            "lag_s": lag,
        },
        native={"residual_sd": _or_none(residual, estimated), "degree": degree},
    )


def _resolved(channel: Channel, data: DriftData, x: Array, degree: int) -> tuple[Array, NDArray[np.bool_]]:
    """The values with coarse axes replaced by what their bins say, and the axes that no fit can resolve.

    A sample of a coarse axis enters as ``expected + (E[x | bin] - expected)/f``, f the share of its information that
    the bins leave: least squares on these has the estimate and the scatter of the interval likelihood.
    """
    y = data.y.copy()
    too_coarse = np.zeros(3, dtype=np.bool_)
    if channel.quantum <= 0.0:
        return y, too_coarse
    design = x[:, None] ** np.arange(degree + 1)
    smooth = design @ np.linalg.lstsq(design, y, rcond=None)[0]
    residual = (y - smooth).std(axis=0)
    for axis in (int(i) for i in np.flatnonzero(~data.constant)):
        wide = (data.half[:, axis] > 0.75 * channel.quantum).any()
        if residual[axis] > COARSE * channel.quantum and not wide:
            continue
        fit = interval_regression(design, y[:, axis], data.half[:, axis], smallest=_SMALLEST_NOISE * channel.quantum)
        if fit.at_limit and len(np.unique(np.round(y[:, axis] / channel.quantum, 3))) < degree + 3:
            too_coarse[axis] = True
            continue
        y[:, axis] = _pseudo(channel, data, design, axis, fit.coefficients, fit.sigma)
    return y, too_coarse


def _pseudo(channel: Channel, data: DriftData, design: Array, axis: int, coefficients: Array, sigma: float) -> Array:
    expected = design @ coefficients
    half = data.half[:, axis]
    part = dataclasses.replace(
        channel, t=data.time, values=data.y[:, axis : axis + 1], zero_bin=half[:, None] > 0.75 * channel.quantum
    )
    surprise = impute(part, expected[:, None], np.array([sigma]))[:, 0] - expected
    share = float((surprise**2).mean()) / sigma**2  # information of a sample, E s^2, times sigma^2
    return np.asarray(expected + surprise / max(share, 1e-6), dtype=np.float64)


def _refused(method: str, channel: Channel, reason: str) -> FitResult:
    return refused(method, channel.sensor, channel.instance, reason, unit=channel.unit, n_samples=len(channel))


def _said(what: str, data: DriftData, estimated: NDArray[np.bool_]) -> str:
    axes = ", ".join(AXES[i] for i in range(3) if estimated[i]) or "no axis"
    return f"{what} of {axes} over {data.t_min:.1f} to {data.t_max:.1f} degC from {data.n} rows"


def _common_warnings(data: DriftData, estimated: NDArray[np.bool_]) -> tuple[str, ...]:
    warnings = []
    constant = ", ".join(AXES[i] for i in range(3) if data.constant[i] and not estimated[i])
    if constant:
        warnings.append(f"{constant} reads one constant value: not estimated")
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
