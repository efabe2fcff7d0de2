"""Drift with temperature: a straight line (S2) and a polynomial, with errors valid under coloured noise.

A still sensor is regressed on its own temperature in a scaled variable. The normal equations are summed over blocks of
time (conditioning and speed: METHODS S2). A slow wander of the sensor looks like drift; its size follows from the
residuals (:func:`calib.stats.correlated.coloured_regression`) and is part of the sd.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import AXES, OFFSETS, FitBuilder, FitResult
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.stats.correlated import ColouredCovariance
from mavcal.calib.stats.quantisation import COARSE, impute, interval_regression
from mavcal.calib.thermal.drift import DriftBlocks, DriftCurve, DriftData, TemperatureBins, powers_about, repeated_rows
from mavcal.calib.thermal.quality import (
    attitude_quality,
    block_statistics,
    common_warnings,
    declined_warnings,
    fit_message,
    noise_quality,
    or_none,
    remedy_for,
    two_way_warnings,
)
from mavcal.calib.thermal.sweeps import (
    Die,
    DriftPrediction,
    ThermometerLag,
    both_ways,
    cross_validated,
    hysteresis,
    rates,
    sweeps,
    thermal_lag,
)
from mavcal.calib.triad import ThermalPolynomial, TriadModel

LINEAR_METHOD = "thermal-linear"
POLYNOMIAL_METHOD = "thermal-poly"

_ONLY_SLOPE = "a slope says nothing of the offset: rest a gyroscope (gyro-rest), turn an accelerometer on six faces"
_COLDER = "start with a cold board and let it warm up at rest through ten degrees or more, better down again too"
_SMALLEST_NOISE = 0.02  # of a quantum
_GRAIN = 1e-3  # of a quantum, by which equal edges differ after rounding
_STEPS = 512  # temperatures at which a curve is looked at
_MANY = 20_000  # samples beyond which equal ones are counted instead of listed


@dataclass(frozen=True)
class PolynomialOptions:
    """How a polynomial against temperature is fitted."""

    degree: int = 3
    """1 to 5."""
    t_ref: float = 35.0
    """Where the polynomial is zero, degC."""
    min_span: float = 10.0
    """Least range of temperature, degC."""
    lag: bool = True
    """Fit against the die temperature if the data show that it lags the thermometer."""


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
        Fixed values of the lines at `t_ref`, which is a different estimator. None: least squares with an intercept.
    min_span : float
        Least range of temperature, degC.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        Slopes in ``model.polynomial``, with an sd that includes slow wander of the sensor. Offsets are not part of this
        method and are named as undetermined; an axis that reads one constant value is named, not estimated.
    """
    data = DriftData.of(channel, temperature)
    made = FitBuilder.of(LINEAR_METHOD, channel, relative=relative, temperature=t_ref, movement=_COLDER)
    reason = data.refusal(1, min_span)
    if reason:
        return made.refused(reason)
    x = data.t - t_ref
    fixed = None if through is None else np.asarray(through, dtype=np.float64)
    repeated = repeated_rows(data)
    fresh = data.rows(~repeated)
    blocks = DriftBlocks.of(x, data.time, data.y, degree=1, origin=fixed)
    fresh_blocks = DriftBlocks.of(x[~repeated], fresh.time, fresh.y, degree=1, origin=fixed)
    noise = fresh_blocks.noise()
    slope_row = 0 if fixed is not None else 1
    slopes = blocks.ordinary[slope_row]
    variance = noise.covariances[:, slope_row, slope_row]
    estimated = ~data.constant
    covariance = np.zeros((15, 15))
    covariance[12:, 12:] = np.diag(np.where(estimated, variance, 0.0))
    residual = blocks.residual_sd()
    polynomial = ThermalPolynomial(t_ref, data.t_min, data.t_max, np.where(estimated, slopes, 0.0)[:, None])
    return made.fitted(
        TriadModel(polynomial=polynomial),
        covariance,
        message=fit_message("slope", data, estimated),
        n_used=data.n,
        residual_rms=_rms(residual, estimated),
        condition_number=blocks.condition,
        undetermined=_beside_slopes(data, estimated),
        partial=bool((~estimated | _weak(estimated, slopes, variance)).any()),
        warnings=_slope_warnings(data, repeated, slopes, variance),
        quality={
            **noise_quality(data, noise, estimated),
            **block_statistics(fresh_blocks, fresh_blocks.ordinary, estimated),
            "repeated_rows": int(repeated.sum()),
        },
        native={
            "slopes": or_none(slopes, estimated),
            "intercepts": or_none(blocks.ordinary[0] if fixed is None else fixed, estimated),
            "t_ref": t_ref,
            "form": "least_squares" if fixed is None else "through_point",
            "residual_sd": or_none(residual, estimated),
            "raw_sd": or_none(data.y.std(axis=0, ddof=1), estimated),
        },
    )


def _beside_slopes(data: DriftData, estimated: NDArray[np.bool_]) -> dict[str, str]:
    """Parameters that the slopes leave undetermined, each with the movement that would determine it."""
    none = np.zeros(3, dtype=np.bool_)
    flat = tuple(f"poly1_{AXES[i]}" for i in range(3) if not estimated[i])
    return dict.fromkeys(OFFSETS, _ONLY_SLOPE) | {name: remedy_for(name, data, none, none) for name in flat}


def _slope_warnings(data: DriftData, repeated: NDArray[np.bool_], slopes: Array, variance: Array) -> list[str]:
    estimated = ~data.constant
    warnings = list(common_warnings(data, estimated))
    if repeated.any():
        warnings.append(
            f"{int(repeated.sum())} of {data.n} rows repeat earlier rows exactly: they count as weights, and not as "
            "new information for the sd"
        )
    weak = ", ".join(AXES[i] for i in np.flatnonzero(_weak(estimated, slopes, variance)))
    if weak:
        warnings.append(f"the slope of {weak} is not larger than twice its own sd: it may be no drift of temperature")
    return warnings


def _weak(estimated: NDArray[np.bool_], slopes: Array, variance: Array) -> NDArray[np.bool_]:
    """Axes (3,) whose slope is within twice its sd."""
    return np.asarray(estimated & (slopes**2 < 4.0 * variance), dtype=np.bool_)


def _rms(residual: Array, estimated: NDArray[np.bool_]) -> float:
    """Rms residual over the estimated axes; 0 without any."""
    return float(np.sqrt((residual[estimated] ** 2).mean())) if estimated.any() else 0.0


def fit_polynomial(
    channel: Channel,
    temperature: Array,
    *,
    degree: int = 3,
    t_ref: float = 35.0,
    min_span: float = 10.0,
    lag: bool = True,
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
    lag : bool
        Fit against the die's temperature if warming and cooling show that it lags the thermometer.
    relative : bool
        The calibration in force was not known.

    Returns
    -------
    FitResult
        The offset is that at `t_ref` for a gyroscope; for an accelerometer in one pose it is undetermined (gravity and
        tilt are inside it) and only the shape counts. ``quality["drift"]`` is each axis' range over the span and
        ``quality["drift_sd"]`` the largest sd of the curve about its mean. An axis is named and left at zero in three
        cases: its change does not repeat with temperature, its value is constant, or it has too few quantisation
        levels. Where the temperature went through its span more than once, ``quality["cross_validation"]`` judges every
        sweep by the others; ``quality["hysteresis"]`` is warming less cooling.
    """
    data = DriftData.of(channel, temperature)
    return fit_drift_data(
        channel, data, len(channel), PolynomialOptions(degree, t_ref, min_span, lag), relative=relative
    )


def fit_drift_data(
    channel: Channel,
    data: DriftData,
    n_samples: int,
    options: PolynomialOptions = PolynomialOptions(),
    *,
    relative: bool = False,
) -> FitResult:
    """:func:`fit_polynomial` for samples already averaged in cells; `channel` may have no samples."""
    degree, t_ref = options.degree, options.t_ref
    if not 1 <= degree <= 5:
        raise InvalidInputError(f"the degree of a thermal polynomial is 1 to 5, not {degree}")
    made = FitBuilder(
        POLYNOMIAL_METHOD, channel.sensor, channel.instance, channel.unit, n_samples, relative, t_ref, _COLDER
    )
    reason = data.refusal(degree, options.min_span)
    if reason:
        return made.refused(reason)
    found, slower, data = _at_the_die(data, degree) if options.lag else (None, None, data)
    scaled = _Scaled.of(data)
    axes = _fit_axes(channel, data, scaled.x, degree)
    judged, repeats = _repeats(axes)
    curve = DriftCurve.of(axes.coefficients, axes.noise, scaled.middle, scaled.half_span, t_ref)
    if slower is not None:
        curve = curve.widened(_by_lag(curve, data, slower, degree, t_ref))
    too_coarse = axes.too_coarse
    declined = ~data.constant & ~too_coarse & (curve.not_repeatable(axes.noise) | ~repeats)
    estimated = ~(data.constant | too_coarse | declined)
    shape_only = channel.sensor != Sensor.GYRO
    model, covariance, undetermined = curve.model(data, t_ref, estimated, shape_only=shape_only)
    residual = axes.residual_sd
    warnings = [*common_warnings(data, estimated | too_coarse | declined)]
    warnings += declined_warnings(declined, too_coarse, channel)
    two_ways = hysteresis(axes.blocks, scaled.middle, scaled.half_span)
    warnings += two_way_warnings(found, two_ways, curve, estimated)
    return made.fitted(
        model,
        covariance,
        message=fit_message("polynomial", data, estimated),
        n_used=data.samples,
        residual_rms=_rms(residual, estimated),
        condition_number=axes.blocks.condition,
        undetermined={name: remedy_for(name, data, too_coarse, declined) for name in undetermined},
        partial=not estimated.all(),
        warnings=warnings,
        quality={
            **noise_quality(data, axes.noise, estimated),
            **block_statistics(axes.blocks, axes.coefficients, estimated),
            **attitude_quality(channel, curve, estimated),
            "drift": or_none(curve.drift, ~data.constant),
            "drift_sd": or_none(curve.drift_sd, ~(data.constant | too_coarse)),
            "lag_s": found.seconds if found else None,
            "lag_sd_s": found.sd if found else None,
            "hysteresis": None if two_ways is None else two_ways[0].tolist(),
            "hysteresis_sd": None if two_ways is None else two_ways[1].tolist(),
            "cross_validation": judged,
            "below_resolution": bool(((data.constant & data.quantised) | too_coarse).all()),
        },
        native={"residual_sd": or_none(residual, estimated), "degree": degree},
    )


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The temperature in the variable ``x = (T - middle)/half_span``, within -1 and 1."""

    middle: float
    half_span: float
    x: Array

    @classmethod
    def of(cls, data: DriftData) -> _Scaled:
        middle, half_span = 0.5 * (data.t_min + data.t_max), 0.5 * data.span
        return cls(middle, half_span, (data.t - middle) / half_span)


def _lag_of(data: DriftData, degree: int) -> tuple[ThermometerLag | None, Die | None]:
    """The lag of the die, and its temperature as a function of the lag; None if there is no evidence of one."""
    scaled = _Scaled.of(data)
    blocks = data.blocks(scaled.x, degree)
    rate = rates(blocks, scaled.middle, scaled.half_span)
    if not both_ways(rate):
        return None, None
    die = Die.of(data.time, data.t, blocks, rate)
    return thermal_lag(blocks, die, scaled.middle, scaled.half_span, ~data.constant), die


def _at_the_die(data: DriftData, degree: int) -> tuple[ThermometerLag | None, _Scaled | None, DriftData]:
    """The lag, the temperature if it were longer by one sd, and the data against the die's temperature."""
    found, die = _lag_of(data, degree)
    if found is None or die is None:
        return found, None, data
    slower = _Scaled.of(data.warmed(die.at(data.time, found.seconds + found.sd)))
    return found, slower, data.warmed(die.at(data.time, found.seconds))


def _by_lag(curve: DriftCurve, data: DriftData, slower: _Scaled, degree: int, t_ref: float) -> Array:
    """Change of the coefficients (p, 3) about `t_ref` when the lag is one sd longer."""
    blocks = data.blocks(slower.x, degree)
    shift = powers_about(t_ref, slower.middle, slower.half_span, degree + 1)
    return np.asarray(shift @ blocks.ordinary - curve.coefficients, dtype=np.float64)


def _repeats(axes: _Axes) -> tuple[dict[str, Any] | None, NDArray[np.bool_]]:
    """Cross-validation of the sweeps, and the axes that repeat: a correction that makes predictions worse is rejected.

    Noise alone may do so too, so only errors far above the white noise of the block means count.
    """
    found: DriftPrediction | None = cross_validated(axes.blocks)
    if found is None:
        return None, np.ones(3, dtype=np.bool_)
    white = axes.residual_sd / np.sqrt(axes.blocks.counts.mean())
    repeats = (found.explained > 0.0) | (found.after < 3.0 * white)
    judged = {
        "sweeps": len(sweeps(axes.blocks)),
        "before": found.before.tolist(),
        "after": found.after.tolist(),
        "explained": found.explained.tolist(),
    }
    return judged, np.asarray(repeats, dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class _Axes:
    """Curves of the three axes in the scaled variable, each with the treatment that its bins need."""

    blocks: DriftBlocks  # of the samples as they are
    coefficients: Array  # (p, 3)
    noise: ColouredCovariance
    residual_sd: Array
    too_coarse: NDArray[np.bool_]


def _fit_axes(channel: Channel, data: DriftData, x: Array, degree: int) -> _Axes:
    blocks = data.blocks(x, degree)
    plain = blocks.noise()
    coefficients, residual = blocks.ordinary.copy(), blocks.residual_sd()
    covariances, whiteness, excess = plain.covariances.copy(), plain.whiteness.copy(), plain.excess.copy()
    too_coarse = np.zeros(3, dtype=np.bool_)
    for axis in range(3):
        bins = data.bins(axis)
        if bins is None:
            continue
        wide = bool((bins.half > 0.75 * channel.quantum).any())
        if data.constant[axis] or (residual[axis] > COARSE * channel.quantum and not wide):
            continue
        coarse = _coarse_axis(x, data.time, bins, degree, channel.quantum)
        if coarse is None:
            too_coarse[axis] = True
            continue
        own, residual[axis] = coarse
        noise = own.noise()
        coefficients[:, axis], covariances[axis] = own.ordinary[:, 0], noise.covariances[0]
        whiteness[axis], excess[axis] = noise.whiteness[0], noise.excess[0]
    return _Axes(blocks, coefficients, ColouredCovariance(covariances, whiteness, excess), residual, too_coarse)


def _coarse_axis(
    x: Array, time: Array, bins: TemperatureBins, degree: int, quantum: float
) -> tuple[DriftBlocks, float] | None:
    """Block sums of an axis whose noise is smaller than its bins, and that noise; None if too few edges are passed.

    Repeats of a value between two edges carry almost no information: the data are the places at which the curve crosses
    an edge. As many crossings as coefficients fit exactly and leave no residual, so one more is required.

    The interval likelihood's estimate is least squares on ``expected + score/information``, with the information of
    each sample as its weight. The same sums therefore carry on from there.
    """
    at = x[bins.rows]
    design = at[:, None] ** np.arange(degree + 1)
    rows, counts = _distinct(at, bins, quantum)
    fit = interval_regression(
        design[rows], bins.values[rows], bins.half[rows], weights=counts, smallest=_SMALLEST_NOISE * quantum
    )
    levels = len(np.unique(np.round(bins.values[rows] / quantum, 3)))
    if (fit.at_limit and levels < degree + 3) or _crossings(at, bins, fit.coefficients, quantum) < degree + 2:
        return None
    expected = design @ fit.coefficients
    mean, variance = impute(bins.values, bins.half, expected, fit.sigma)
    information = np.maximum(1.0 - variance / fit.sigma**2, 1e-9)
    pseudo = expected + (mean - expected) / information
    weights = information * bins.counts
    means = len(bins.rows) > len(x)
    if means:  # their bins belong together
        total = np.bincount(bins.rows, weights, minlength=len(x)).astype(np.float64)
        sums = np.bincount(bins.rows, weights * pseudo, minlength=len(x)).astype(np.float64)
        pseudo = sums / np.maximum(total, 1e-300)
        weights, at = total, x
    else:
        time = time[bins.rows]
    blocks = DriftBlocks.of(at, time, pseudo[:, None], degree=degree, weights=weights, means=means)
    return blocks, fit.sigma


def _crossings(x: Array, bins: TemperatureBins, coefficients: Array, quantum: float) -> int:
    """Number of bin edges that the curve crosses over the temperature range; there and back counts as two."""
    lower = np.unique(np.round((bins.values - bins.half) / (_GRAIN * quantum))) * _GRAIN * quantum
    curve = np.linspace(x.min(), x.max(), _STEPS)[:, None] ** np.arange(len(coefficients)) @ coefficients
    return int(np.abs(np.diff(np.searchsorted(lower[1:], curve))).sum())


def _distinct(x: Array, bins: TemperatureBins, quantum: float) -> tuple[NDArray[np.intp], Array]:
    """One row for each distinct temperature and bin, and the number of samples that it represents."""
    if len(x) <= _MANY:
        return np.arange(len(x)), bins.counts
    key = np.round(x * 2e4).astype(np.int64) * 2_000_003 + np.round(bins.values / (1e-3 * quantum)).astype(np.int64)
    _, rows, which = np.unique(key, return_index=True, return_inverse=True)
    return rows, np.bincount(which, weights=bins.counts).astype(np.float64)
