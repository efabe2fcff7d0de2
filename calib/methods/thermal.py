"""Methods for drift with temperature: of one recording, or of several tables of a device.

Several tables share one cross-validated temperature curve, with an offset each.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.flight.rest_temperatures import logs_of, no_temperature
from mavcal.calib.flight.thermal import ThermalRequest, fit_rests
from mavcal.calib.methods import worthwhile
from mavcal.calib.methods.method import INSTANCE, FindingKind, Method, Options, Suggestion, of_one
from mavcal.calib.methods.source import Source
from mavcal.calib.option import Option
from mavcal.calib.procedures.drift_fit import fit_posed
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.thermal.compass import fit_mag_thermal
from mavcal.calib.thermal.drift import DriftData
from mavcal.calib.thermal.fit import LINEAR_METHOD, PolynomialOptions, fit_drift_data, fit_linear

TABLES_WARNING = "{} tables, each with an offset of its own"
_ROWS = 20_000  # of a table, that are enough to compare curves
_SEEN = 50  # rows within and outside of the range of the others, with which one is judged
_BETTER = 0.95  # of what the polynomial leaves, that a slope has to leave to be taken
_LINEAR_SPAN, _POLY_SPAN = 2.0, 10.0  # degC
SENSOR = Option("sensor", ("all", "accel", "gyro"), "all", "only this sensor")
REFERENCE = Option(
    "reference",
    ("auto", "gravity", "difference"),
    "auto",
    "of an accelerometer in logs: gravity of each rest, or the difference to another accelerometer that does not drift",
)


@dataclass(frozen=True)
class Outside:
    """Residual of held-out tables outside the temperatures of the others, rms in the sensor's unit."""

    slope: float
    polynomial: float
    clamped: float
    """With the polynomial clamped at the ends of its range, as in the firmwares."""
    low: float
    high: float
    """Highest temperature of the others, degC."""


def fit_tables(tables: Sequence[tuple[Channel, Array]], options: PolynomialOptions, *, relative: bool) -> FitResult:
    """The common curve of one sensor in several tables: its samples and a temperature (N,) for each, degC.

    A straight line replaces the polynomial if it predicts held-out tables better outside the range of the others.
    """
    degree = options.degree
    found = outside_of(tables, degree)
    used_degree = 1 if found is not None and found.slope < _BETTER * found.polynomial else degree
    channel, temperature, number = _joined(tables)
    good = np.isfinite(channel.values).all(axis=1) & np.isfinite(temperature)
    data = DriftData.of(channel.take(good), temperature[good])
    number = number[good]
    if len(number) != data.n:  # spikes were left out: rows are told apart by their time
        number = number[np.searchsorted(channel.t[good], data.time)]
    fit = fit_posed(
        channel,
        data,
        number,
        dataclasses.replace(options, degree=used_degree),
        relative=relative,
        warning=TABLES_WARNING,
    )
    if found is None or fit.status == FitStatus.REFUSED:
        return fit
    held = dataclasses.asdict(found) | {"degree": used_degree}
    return dataclasses.replace(
        fit,
        warnings=(*fit.warnings, _comparison(found, degree, used_degree, fit.unit)),
        quality={**fit.quality, "held_out": held},
    )


def outside_of(tables: Sequence[tuple[Channel, Array]], degree: int) -> Outside | None:
    """Prediction of each held-out table; None if none exceeds the temperatures of the others, or `degree` is 1."""
    thinned = [_thinned(channel, temperature) for channel, temperature in tables]
    squares, count, reach = np.zeros(3), 0, (np.inf, -np.inf)
    for k, (t, y) in enumerate(thinned):
        others = [table for j, table in enumerate(thinned) if j != k]
        if degree < 2 or not others:
            return None
        low, high = min(float(u.min()) for u, _ in others), max(float(u.max()) for u, _ in others)
        inside = (t >= low) & (t <= high)
        if inside.sum() < _SEEN or (~inside).sum() < _SEEN:
            continue
        held = np.clip(t, low, high)
        slope, curve = _curve(others, 1, low, high), _curve(others, degree, low, high)
        for row, (coefficients, at) in enumerate(((slope, t), (curve, t), (curve, held))):
            left = y - np.asarray(_powers(at, len(coefficients), low, high) @ coefficients)
            left = left - left[inside].mean(axis=0)
            squares[row] += float((left[~inside] ** 2).mean(axis=1).sum())
        count += int((~inside).sum())
        reach = min(reach[0], low), max(reach[1], high)
    if not count:
        return None
    slope_rms, polynomial_rms, clamped_rms = np.sqrt(squares / count)
    return Outside(float(slope_rms), float(polynomial_rms), float(clamped_rms), reach[0], reach[1])


def _comparison(found: Outside, degree: int, used_degree: int, unit: str) -> str:
    """Sentence that compares polynomial and line outside the range, and states the cost of clamping."""
    better = "a slope is fitted" if used_degree == 1 else f"degree {used_degree} stays"
    cost = found.clamped / max(min(found.slope, found.polynomial), 1e-300)
    return (
        f"a held-out table is left, outside the temperatures of the others, with {found.slope:.2g} {unit} by a slope "
        f"and {found.polynomial:.2g} by degree {degree}: {better}. Firmwares clamp instead, which leaves "
        f"{found.clamped:.2g} {unit}, {cost:.1f} times as much. Warm it up through all temperatures that are flown"
    )


def _thinned(channel: Channel, temperature: Array) -> tuple[Array, Array]:
    good = np.isfinite(temperature) & np.isfinite(channel.values).all(axis=1)
    step = max(1, int(good.sum()) // _ROWS)
    return temperature[good][::step], channel.values[good][::step]


def _curve(tables: Sequence[tuple[Array, Array]], degree: int, low: float, high: float) -> Array:
    """Coefficients (degree, 3) of the powers of the scaled temperature, with a constant for every table."""
    rows = np.concatenate(
        [_powers(t, degree, low, high) - _powers(t, degree, low, high).mean(axis=0) for t, _ in tables]
    )
    values = np.concatenate([y - y.mean(axis=0) for _, y in tables])
    return np.asarray(np.linalg.lstsq(rows, values, rcond=None)[0])


def _powers(t: Array, degree: int, low: float, high: float) -> Array:
    x = (t - 0.5 * (low + high)) / max(0.5 * (high - low), 1e-9)
    return np.asarray(x[:, None] ** np.arange(1, degree + 1))


def _joined(tables: Sequence[tuple[Channel, Array]]) -> tuple[Channel, Array, NDArray[np.intp]]:
    """The channels one after the other on one clock, their temperatures, and the table of each row."""
    times, end = [], 0.0
    for channel, _ in tables:
        times.append(channel.t - channel.t[0] + end)
        end = float(times[-1][-1]) + 60.0
    zero = [channel.zero_bin for channel, _ in tables]
    joined = dataclasses.replace(
        tables[0][0],
        t=np.concatenate(times),
        values=np.concatenate([channel.values for channel, _ in tables]),
        zero_bin=np.concatenate([z for z in zero if z is not None]) if all(z is not None for z in zero) else None,
    )
    number = np.repeat(np.arange(len(tables)), [len(channel) for channel, _ in tables])
    return joined, np.concatenate([t for _, t in tables]), number.astype(np.intp)


def _thermal(source: Source, options: Options, fit: Callable[[Channel, Array, bool], FitResult]) -> list[FitResult]:
    fits = []
    sensors = [s for s in (Sensor.ACCEL, Sensor.GYRO) if options["sensor"] in {"all", s.value}]
    sensors = [s for s in sensors if source.recording.instances(s)]
    if not sensors:  # says what the recording has instead
        source.channels(Sensor.GYRO if options["sensor"] == "gyro" else Sensor.ACCEL)
    for sensor in sensors:
        for channel in source.channels(sensor):
            fits.append(fit(channel, _temperature_at(source, channel), source.relative(channel)))
    return fits


def _from_logs(sources: Sequence[Source], options: Options, wish: ThermalRequest) -> list[FitResult]:
    """Fits from vehicle logs, using only their rests on the ground."""
    for source in sources:
        if not source.recording.instances(Sensor.TEMPERATURE):
            raise InvalidInputError(no_temperature(source.recording))
    logs = logs_of([source.recording for source in sources])
    sensors = [s for s in (Sensor.ACCEL, Sensor.GYRO) if options["sensor"] in {"all", s.value}]
    fits = []
    for sensor in sensors:
        having = [source for source in sources if source.recording.instances(sensor)]
        instances = sorted({c.instance for source in having for c in source.channels(sensor)})
        for instance in instances:
            found = [c for source in having if (c := source.maybe(sensor, instance)) is not None]
            relative = any(source.relative(c) for source in having for c in found)
            fits.append(fit_rests(logs, sensor, instance, wish, relative=relative))
    if not fits:
        sources[0].channels(Sensor.GYRO if options["sensor"] == "gyro" else Sensor.ACCEL)  # says what there is instead
    return fits


def _logged(sources: Sequence[Source]) -> bool:
    """Whether the sources are unlabelled streams or logs of vehicles.

    Raises
    ------
    InvalidInputError
        If logs and tables are mixed.
    """
    logged = [source.of_vehicle and not source.recording.segments for source in sources]
    if any(logged) and not all(logged):
        raise InvalidInputError(
            "logs and tables do not pool: give the logs of one vehicle, or the tables of one device"
        )
    return all(logged)


def thermal_linear(sources: Sequence[Source], options: Options) -> list[FitResult]:
    """Straight lines of accelerometers and gyroscopes over temperature; several logs of one vehicle together."""
    through = _point(options)
    if through is not None and options["sensor"] == "all" and len({c.sensor for c in _inertial(sources[0])}) > 1:
        raise InvalidInputError("a fixed point is one sensor's: choose it with --sensor accel or --sensor gyro")
    if _logged(sources):
        wish = ThermalRequest(0, options["tref"], options["min_span"], through=through, reference=options["reference"])
        return _from_logs(sources, options, wish)

    if len(sources) > 1:
        if through is not None:
            raise InvalidInputError("a fixed point belongs to one table: leave --through out, or give one table")
        return [dataclasses.replace(fit, method=LINEAR_METHOD) for fit in _of_tables(sources, options, 1)]

    def fit(channel: Channel, temperature: Array, relative: bool) -> FitResult:
        return fit_linear(
            channel,
            temperature,
            t_ref=options["tref"],
            through=through,
            min_span=options["min_span"],
            relative=relative,
        )

    return _thermal(sources[0], options, fit)


def _inertial(source: Source) -> list[Channel]:
    return [c for c in source.recording.channels if c.sensor in {Sensor.ACCEL, Sensor.GYRO} and len(c)]


def _point(options: Options) -> Array | None:
    """The values at `tref` through which the lines are forced; None: least squares with an intercept.

    Raises
    ------
    InvalidInputError
        If they are not three finite numbers.
    """
    if options["through"] is None:
        return None
    try:
        values = np.array([float(part) for part in options["through"].split(",")])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InvalidInputError(f"through takes three numbers X,Y,Z at tref, not {options['through']!r}")
    return values


def thermal_poly(sources: Sequence[Source], options: Options) -> list[FitResult]:
    """Polynomials of accelerometers and gyroscopes over temperature; several logs of one vehicle together."""
    if _logged(sources):
        degree = options["degree"]
        if not 1 <= degree <= 5:
            raise InvalidInputError(f"the degree of a thermal polynomial is 1 to 5, not {degree}")
        lag = options["lag"] == "auto"
        wish = ThermalRequest(degree, options["tref"], options["min_span"], lag=lag, reference=options["reference"])
        return _from_logs(sources, options, wish)
    return _poly_of_table(sources[0], options) if len(sources) == 1 else _of_tables(sources, options, options["degree"])


def _of_tables(sources: Sequence[Source], options: Options, degree: int) -> list[FitResult]:
    """Every sensor over all tables of one device."""
    wanted = [s for s in (Sensor.ACCEL, Sensor.GYRO) if options["sensor"] in {"all", s.value}]
    fits = []
    for sensor in (s for s in wanted if sources[0].recording.instances(s)):
        for first in sources[0].channels(sensor):
            having = [(source, c) for source in sources if (c := source.maybe(sensor, first.instance)) is not None]
            fits.append(
                fit_tables(
                    [(channel, _temperature_at(source, channel)) for source, channel in having],
                    PolynomialOptions(
                        degree, options["tref"], options["min_span"], options.get("lag", "ignore") == "auto"
                    ),
                    relative=any(source.relative(channel) for source, channel in having),
                )
            )
    if not fits:
        sources[0].channels(Sensor.GYRO if options["sensor"] == "gyro" else Sensor.ACCEL)  # says what there is instead
    return fits


def _poly_of_table(source: Source, options: Options) -> list[FitResult]:
    wanted = PolynomialOptions(options["degree"], options["tref"], options["min_span"], options["lag"] == "auto")
    segments = source.recording.segments

    def fit(channel: Channel, temperature: Array, relative: bool) -> FitResult:
        if channel.sensor != Sensor.ACCEL or len(segments) < 2:
            data = DriftData.of(channel, temperature)
            return fit_drift_data(channel, data, len(channel), wanted, relative=relative)
        number = np.searchsorted([s.start for s in segments], channel.t, side="right") - 1  # each its own pose
        inside = (number >= 0) & np.isfinite(channel.values).all(axis=1)
        data = DriftData.of(channel.take(inside), temperature[inside])
        return fit_posed(channel, data, number[inside].astype(np.intp), wanted, relative=relative)

    return _thermal(source, options, fit)


def mag_thermal(sources: Sequence[Source], options: Options) -> list[FitResult]:
    """Every compass over temperature, in one or several labelled poses; or several recordings of one device."""
    fits = []
    for mag in sources[0].channels(Sensor.MAG):
        poses, relative = [], False
        for source in sources:
            channel = source.maybe(Sensor.MAG, mag.instance)
            if channel is None:
                continue
            relative |= source.relative(channel)
            at = _temperature_at(source, channel)
            for start, end in [(s.start, s.end) for s in source.recording.segments] or [(-np.inf, np.inf)]:
                inside = (channel.t >= start) & (channel.t < end)
                poses.append((channel.take(inside), at[inside]))
        fits.append(fit_mag_thermal(poses, t_ref=options["tref"], min_span=options["min_span"], relative=relative))
    return fits


def _temperature_at(source: Source, channel: Channel) -> Array:
    """Temperature (N,) at every sample of `channel`, degC.

    Raises
    ------
    InvalidInputError
        If there is none.
    """
    temperature = source.temperature(channel.instance)
    if temperature is None:
        raise InvalidInputError(no_temperature(source.recording))
    good = np.isfinite(temperature.values[:, 0])
    if not good.any():
        raise InvalidInputError("the temperature column has no finite number")
    return np.asarray(np.interp(channel.t, temperature.t[good], temperature.values[good, 0]))


METHODS = (
    Method(
        "thermal-linear",
        "a motionless sensor whose temperature moves",
        (
            INSTANCE,
            SENSOR,
            Option("tref", float, 25.0, "temperature at which nothing is corrected, degC; 0 is the published form"),
            Option("through", str, None, "X,Y,Z: the lines go through these at tref; another estimator, never mixed"),
            Option("min_span", float, _LINEAR_SPAN, "least range of temperature, degC"),
            REFERENCE,
        ),
        of_one(thermal_linear),
        thermal_linear,
        finds=FindingKind.DRIFT,
        suggestion=Suggestion(3, partial(worthwhile.drift, least=_LINEAR_SPAN)),
    ),
    Method(
        "thermal-poly",
        "a motionless sensor that warms up by ten degrees or more",
        (
            INSTANCE,
            SENSOR,
            Option("degree", int, 3, "of the polynomial, 1 to 5"),
            Option("tref", float, 35.0, "temperature at which the polynomial is zero, degC"),
            Option("min_span", float, _POLY_SPAN, "least range of temperature, degC"),
            REFERENCE,
            Option("lag", ("auto", "ignore"), "auto", "fit against the temperature of the die where it is seen to lag"),
        ),
        of_one(thermal_poly),
        thermal_poly,
        finds=FindingKind.DRIFT,
        suggestion=Suggestion(2, partial(worthwhile.drift, least=_POLY_SPAN)),
    ),
    Method(
        "mag-thermal",
        "a motionless compass that warms up by five degrees or more; two poses or more, one recording or segment each",
        (
            INSTANCE,
            Option("tref", float, 25.0, "temperature at which nothing is corrected, degC"),
            Option("min_span", float, 5.0, "least range of temperature of a pose, degC"),
        ),
        of_one(mag_thermal),
        mag_thermal,
        finds=FindingKind.FIGURES,
    ),
)
"""In the order of the command line."""
