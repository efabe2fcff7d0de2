"""Drift with temperature from the rests in ordinary logs, pooled over several logs of one vehicle.

Unknown constants are nuisances: each rest of an accelerometer has one for its pose, which includes gravity. Each log of
a gyroscope has one for its turn-on bias. The difference of two accelerometers side by side does not depend on the pose.
All rests of a log then share one constant, and a rest after the flight shows the drift during the flight. Where even
the rests of both cover too narrow a range, the flight itself is used. The difference depends on both units, so it is
used only if the other one, by its own rests, does not drift. In flight ``f_1 - f_2 = c + N f_2 + p(T) + noise``. The
motion cancels except for N, the difference in scale and mounting, which the flight determines. Each cell of a second is
weighted by its scatter.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.log_options import how_to_log_disarmed
from mavcal.calib.fit import AXES, FitBuilder, FitResult, FitStatus
from mavcal.calib.flight.rest import ground
from mavcal.calib.flight.rest_temperatures import Log, RestTemperatures, difference, rest_temperatures
from mavcal.calib.procedures.drift_fit import PoseOffsets, fit_posed
from mavcal.calib.recording import Array, Channel, Recording, Sensor
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.thermal.drift import DriftData
from mavcal.calib.thermal.fit import LINEAR_METHOD, POLYNOMIAL_METHOD, PolynomialOptions, fit_drift_data, fit_linear

STEADY = {Sensor.ACCEL: 0.02, Sensor.GYRO: float(np.radians(0.05))}
"""Drift over the span, m/s2 and rad/s, below which a unit may be a reference: the default residual of a thermal
calibration."""
_UNITS = ("m/s2", "rad/s")
_WIDER = 1.25  # a difference must see this many times the span of the sensor by itself
_LEAST_SPAN = 2.0  # degC, for the reference to be judged
COLDER = f"log a warm-up at rest from cold, disarmed ({how_to_log_disarmed(None)}), better the cooling down too"
_WARNINGS = {
    Sensor.ACCEL: "{} rests or logs, each with a constant of its own: only the shape is common to them",
    Sensor.GYRO: "{} logs, each with a turn-on bias of its own: the offset is that of the last one",
}
_CELL = 1.0  # s
_LEAST_CELLS = 30
_LEAST_SAMPLES = 8  # of a cell


@dataclass(frozen=True)
class ThermalRequest:
    """The requested fit; `degree` 0 is the straight line of thermal-linear."""

    degree: int
    t_ref: float
    min_span: float
    lag: bool = True
    through: Array | None = None
    reference: str = "auto"  # auto, gravity or difference

    @property
    def method(self) -> str:
        """Its name."""
        return POLYNOMIAL_METHOD if self.degree else LINEAR_METHOD


def fit_rests(logs: Sequence[Log], sensor: Sensor, instance: int, wish: ThermalRequest, *, relative: bool) -> FitResult:
    """Drift of one sensor over the rests of `logs`; a refusal states the available and the necessary span."""
    own = rest_temperatures(logs, sensor, instance)
    if own is None:
        return _refused(logs, sensor, instance, wish, "the vehicle never rested with its motors off in this log")
    if sensor == Sensor.GYRO:
        alone, best, why = (
            _described(_fit(own, own.log, wish, relative), own, "each log with its own turn-on bias"),
            None,
            "",
        )
    else:
        alone = _described(_fit(own, own.rest, wish, relative), own, "each rest with its own pose")
        best, why = (None, "") if wish.reference == "gravity" else _by_difference(logs, own, wish, relative)
    if best is None and alone.status == FitStatus.REFUSED and wish.reference != "gravity" and wish.degree:
        best, why = _in_flight(logs, own, wish, relative)
    if best is not None:
        return best
    if wish.reference == "difference" and sensor == Sensor.ACCEL:
        return _refused(logs, sensor, instance, wish, f"no other accelerometer can be the reference: {why}")
    return alone if not why else dataclasses.replace(alone, warnings=(*alone.warnings, why))


def _fit(rows: RestTemperatures, number: NDArray[np.intp], wish: ThermalRequest, relative: bool) -> FitResult:
    """The drift with one constant for every `number` (N,)."""
    covered = rows.covered(number)
    if covered < wish.min_span:
        return _narrow(rows, wish, covered)
    if wish.degree:
        return fit_posed(
            rows.channel,
            rows.data,
            number,
            PolynomialOptions(wish.degree, wish.t_ref, wish.min_span, wish.lag),
            relative=relative,
            warning=_WARNINGS[rows.channel.sensor],
        )
    poses = PoseOffsets.of(rows.data, number, 1)
    data = rows.data if poses is None else poses.lowered
    channel = dataclasses.replace(rows.channel, t=data.time, values=data.y, zero_bin=None)
    fit = fit_linear(channel, data.t, t_ref=wish.t_ref, through=wish.through, min_span=wish.min_span, relative=relative)
    return fit if poses is None else poses.widened(fit, _WARNINGS[rows.channel.sensor])


def _by_difference(
    logs: Sequence[Log], own: RestTemperatures, wish: ThermalRequest, relative: bool
) -> tuple[FitResult | None, str]:
    """The drift against an accelerometer without drift, where that covers a wider range; or why not."""
    instance = own.channel.instance
    others = sorted({i for log in logs for i in log.recording.instances(Sensor.ACCEL)} - {instance})
    why = ""
    for other in others:
        rows = rest_temperatures(logs, Sensor.ACCEL, instance, other=other)
        if rows is None:
            continue
        if wish.reference == "auto" and rows.covered(rows.log) < _WIDER * own.covered(own.rest):
            continue
        steady = _steady(logs, Sensor.ACCEL, other, rows.data.span)
        if isinstance(steady, str):
            why = steady
            continue
        fit = _fit(rows, rows.log, wish, relative)
        if fit.status != FitStatus.REFUSED:
            return _described(_against(fit, other, steady), rows, "each log with its own difference of offsets"), ""
        why = fit.message
    return None, why


def _in_flight(
    logs: Sequence[Log], own: RestTemperatures, wish: ThermalRequest, relative: bool
) -> tuple[FitResult | None, str]:
    """The drift against another unit over whole logs, flights included; or why not."""
    sensor, instance = own.channel.sensor, own.channel.instance
    why = ""
    for other in sorted({i for log in logs for i in log.recording.instances(sensor)} - {instance}):
        flown = flight_difference(logs, sensor, instance, other, wish.degree)
        if flown is None or flown.data.span < wish.min_span:
            continue
        steady = _steady(logs, sensor, other, flown.data.span)
        if isinstance(steady, str):
            why = steady
            continue
        fit = fit_drift_data(
            flown.channel,
            flown.data,
            flown.data.samples,
            PolynomialOptions(wish.degree, wish.t_ref, wish.min_span, wish.lag),
            relative=relative,
        )
        if fit.status == FitStatus.REFUSED:
            why = fit.message
            continue
        text = (
            f"the rests span too few degC: the difference of the units in {flown.flight:.0f} s of flight counts as well"
        )
        fit = dataclasses.replace(fit, covariance=fit.covariance * flown.loss, warnings=(*fit.warnings, text))
        return _described(_against(_without_offset(fit), other, steady), own, "and the flights between them"), ""
    return None, why


def _without_offset(fit: FitResult) -> FitResult:
    """The fit without an offset, which a difference of two units does not determine."""
    names = tuple(f"offset_{axis}" for axis in AXES)
    open_names = tuple(n for n in fit.names if n in {*fit.undetermined, *names})
    covariance = fit.covariance.copy()
    covariance[:3] = covariance[:, :3] = 0.0
    model = dataclasses.replace(fit.model, offset=np.zeros(3))
    movements = {
        n: fit.movements.get(n, "only the difference to another unit was seen: rest it (gyro-rest)") for n in open_names
    }
    return dataclasses.replace(
        fit, model=model, covariance=covariance, undetermined=open_names, movements=movements, status=FitStatus.PARTIAL
    )


def _steady(logs: Sequence[Log], sensor: Sensor, other: int, span: float) -> Array | str:
    """Slopes (3,) of the reference by its own rests, with their sd; or why it is no reference over `span` degC."""
    rows = rest_temperatures(logs, sensor, other)
    name = f"{'accelerometer' if sensor == Sensor.ACCEL else 'gyroscope'} {other + 1}"
    if rows is None:
        return f"{name} never rested"
    groups = rows.rest if sensor == Sensor.ACCEL else rows.log
    line = _fit(rows, groups, ThermalRequest(degree=1, t_ref=35.0, min_span=_LEAST_SPAN, lag=False), relative=False)
    if line.status == FitStatus.REFUSED or line.model.polynomial is None or len(line.undetermined) > 3:
        return f"{name} cannot be judged as a reference: {line.message}"
    slope = line.model.polynomial.coefficients[:, 0]
    sd = np.sqrt(np.diag(line.covariance)[12:])
    drift = float((np.abs(slope) + 2.0 * sd).max()) * span
    if line.unit not in _UNITS or drift > STEADY[sensor]:
        seen = line.model.polynomial.t_max - line.model.polynomial.t_min
        return (
            f"{name} may drift by itself by {drift:.2g} {line.unit} over {span:.1f} degC, as its {seen:.1f} degC at "
            "rest say: it is no reference"
        )
    return np.asarray(np.hypot(slope, sd), dtype=np.float64)


def _against(fit: FitResult, other: int, slopes: Array) -> FitResult:
    """A fit of a difference, whose covariance includes a linear drift of the reference."""
    covariance = fit.covariance.copy()
    poly = fit.model.polynomial
    assert poly is not None
    degree = poly.coefficients.shape[1]
    for axis in range(3):
        k = 12 + axis * degree
        if covariance[k, k] > 0.0:
            covariance[k, k] += slopes[axis] ** 2
    text = (
        f"the reference is {fit.sensor} {other + 1}: the drift is that of the difference of the two. Where the "
        f"reference had no rest, it is taken to drift by at most {1e6 * slopes.max():.3g}e-6 {fit.unit}/degC"
    )
    quality = {**fit.quality, "reference": "difference", "reference_instance": other}
    return dataclasses.replace(fit, covariance=covariance, warnings=(*fit.warnings, text), quality=quality)


def _described(fit: FitResult, rows: RestTemperatures, constants: str) -> FitResult:
    """The fit with its sources in message, warnings and quality."""
    logs = f"{rows.logs} log{'s' if rows.logs > 1 else ''}"
    warnings = list(fit.warnings)
    if rows.only_still:
        warnings.append("the log does not say when the motors ran: stillness is taken for rest on the ground")
    quality = {
        **fit.quality,
        "rests": len(rows.rests),
        "rest_duration": rows.duration,
        "logs": rows.logs,
        "reference": fit.quality.get("reference", "gravity" if fit.sensor == Sensor.ACCEL else "rest"),
    }
    if fit.status == FitStatus.REFUSED:
        return dataclasses.replace(fit, warnings=tuple(warnings), quality=quality)
    still = _none(fit)
    if still:
        warnings.append(f"{still} shows no drift larger than its own sd: there is nothing to correct")
    message = f"{fit.message}; {len(rows.rests)} rests of {rows.duration:.0f} s in {logs}, {constants}"
    return dataclasses.replace(fit, message=message, warnings=tuple(warnings), quality=quality)


def _none(fit: FitResult) -> str:
    """Axes whose drift is within twice its sd."""
    drift, sd = fit.quality.get("drift"), fit.quality.get("drift_sd")
    if not drift or not sd:
        return ""
    small = [d is not None and s is not None and d < 2.0 * 2.0 * s for d, s in zip(drift, sd, strict=True)]
    return ", ".join(a for a, none in zip(AXES, small, strict=True) if none)


def _narrow(rows: RestTemperatures, wish: ThermalRequest, covered: float) -> FitResult:
    data, channel = rows.data, rows.channel
    return FitBuilder(wish.method, channel.sensor, channel.instance, channel.unit, data.samples).refused(
        f"at rest the temperature moved by {covered:.1f} degC ({data.t_min:.1f} to {data.t_max:.1f} over "
        f"{len(rows.rests)} rests of {rows.duration:.0f} s): {wish.min_span:.0f} are needed; {COLDER}",
        movement=COLDER,
        quality={"span": covered, "t_min": data.t_min, "t_max": data.t_max, "rests": len(rows.rests)},
    )


def _refused(logs: Sequence[Log], sensor: Sensor, instance: int, wish: ThermalRequest, reason: str) -> FitResult:
    channels = [c for log in logs for c in log.recording.find(sensor, instance)]
    unit, count = channels[0].unit if channels else "", sum(len(c) for c in channels)
    made = FitBuilder(wish.method, sensor, instance, unit, count)
    return made.refused(f"{reason}; {COLDER}", movement=COLDER)


@dataclass(frozen=True, eq=False)
class FlightDifference:
    """Difference of two units after N and each log's constant are eliminated, with the cost of these nuisances."""

    channel: Channel
    """No samples yet; says the sensor and its unit."""
    data: DriftData
    loss: float  # largest factor by which the nuisances raise a variance of the curve
    flight: float  # s
    logs: int


def flight_difference(
    logs: Sequence[Log], sensor: Sensor, instance: int, other: int, degree: int
) -> FlightDifference | None:
    """Difference in cells of one second over whole logs; None: too few cells, or no difference can be taken."""
    cells = [cell for k, log in enumerate(logs) if (cell := _cells(log, sensor, instance, other, k)) is not None]
    if not cells:
        return None
    rows = np.concatenate(cells)
    time, log, flying, count, t = rows[:, :5].T
    y, second, variance = rows[:, 5:8], rows[:, 8:11], rows[:, 11]
    if len(rows) < _LEAST_CELLS + 3 * degree or np.ptp(t) < 1.0:
        return None
    constants = (log[:, None] == np.unique(log)).astype(np.float64)
    nuisance = np.hstack([constants, second - second.mean(axis=0)])
    curve = ((t - t.mean()) / np.ptp(t))[:, None] ** np.arange(1, degree + 1)
    weight = count / _noise(variance, count, flying)
    for _ in range(2):  # the second time by what is left, which knows of what is slower than a cell
        root = np.sqrt(weight)[:, None]
        whole = np.hstack([nuisance, curve])
        solution = np.linalg.lstsq(root * whole, root * y, rcond=1e-10)[0]
        left = y - whole @ solution
        weight = count / _noise((left**2).mean(axis=1) * count, count, flying)
    curve_alone = y - nuisance @ solution[: nuisance.shape[1]]
    quiet = float(_noise(variance, count, flying).min())
    counts = np.maximum(weight * quiet, 1e-6)  # worth as many quiet samples
    channel = next(c for item in logs for c in item.recording.find(sensor, instance)).take(slice(0, 0))
    data = DriftData(
        time=time,
        t=t,
        y=curve_alone,
        half=None,
        constant=np.zeros(3, dtype=np.bool_),
        ignored=0,
        counts=counts,
        scatter=np.full(3, float((quiet * count).sum())),
    )
    root = np.sqrt(weight)[:, None]
    loss = _loss(root * curve, root * np.ones((len(rows), 1)), root * nuisance)
    return FlightDifference(channel, data, loss, float(flying.sum()) * _CELL, len(cells))


def _cells(log: Log, sensor: Sensor, instance: int, other: int, number: int) -> Array | None:
    """Rows of time, log, flying, samples, temperature, difference (3), second unit (3), variance of a sample."""
    recording = log.recording
    try:
        first, second = recording.channel(sensor, instance), recording.channel(sensor, other)
    except InvalidInputError:
        return None
    apart = difference(first, second)
    thermometers = log.temperature_of
    thermometer = thermometers.get(instance, thermometers.get(0))
    if apart is None or thermometer is None or len(apart) < _LEAST_SAMPLES:
        return None
    apart = apart.take(finite_rows(apart.values))
    warm = thermometer.take(finite_rows(thermometer.values))
    if not len(apart) or not len(warm):
        return None
    cell = np.floor((apart.t - apart.t[0]) / _CELL).astype(np.intp)
    size = int(cell[-1]) + 1
    count = np.bincount(cell, minlength=size)
    beside = np.column_stack([np.interp(apart.t, second.t, column) for column in second.values.T])
    columns = [apart.t, *apart.values.T, *beside.T, (apart.values**2).sum(axis=1)]
    used = count >= _LEAST_SAMPLES
    means = np.array([np.bincount(cell, column, minlength=size) for column in columns])[:, used] / count[used]
    variance = np.maximum(means[7] - (means[1:4] ** 2).sum(axis=0), 0.0) / 3.0
    flying = _airborne(recording, means[0])
    temperature = np.interp(means[0], warm.t, warm.values[:, 0])
    return np.column_stack(
        [
            means[0] + log.shift,
            np.full(means.shape[1], number),
            flying,
            count[used],
            temperature,
            means[1:4].T,
            means[4:7].T,
            variance,
        ]
    )


def _airborne(recording: Recording, t: Array) -> NDArray[np.bool_]:
    flying = np.zeros(len(t), dtype=np.bool_)
    for span in ground(recording).running:
        flying |= (t > span.start - _CELL) & (t < span.end + _CELL)
    return flying


def _noise(variance: Array, count: Array, flying: Array) -> Array:
    """Variance of a sample for every cell: one value for the rests, one for the flights."""
    found = np.empty(len(variance))
    for kind in (flying > 0, flying == 0):
        if kind.any():
            found[kind] = max(float(np.average(variance[kind], weights=count[kind])), 1e-18)
    return found


def _loss(curve: Array, one: Array, nuisance: Array) -> float:
    """Largest ratio of the variance of a combination of the curve's terms beside `nuisance` to that beside `one`."""
    plain, each = (curve - n @ np.linalg.lstsq(n, curve, rcond=1e-10)[0] for n in (one, nuisance))
    factor = np.linalg.cholesky(each.T @ each + 1e-12 * np.trace(plain.T @ plain) * np.eye(len(plain.T)))
    half = np.linalg.solve(factor, plain.T)
    return max(1.0, float(np.linalg.eigvalsh(half @ half.T)[-1]))
