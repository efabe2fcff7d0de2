"""Methods for drift with temperature."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calib.drift import DriftData
from calib.errors import InvalidInputError
from calib.fit import FitResult
from calib.methods.method import INSTANCE, Method, Option, Options
from calib.methods.source import Source
from calib.procedures.drift_fit import fit_posed
from calib.recording import Channel, Sensor
from calib.thermal import fit_linear, fit_polynomial

Array = NDArray[np.float64]


SENSOR = Option("sensor", ("all", "accel", "gyro"), "all", "only this sensor")


def _thermal(source: Source, options: Options, fit: Callable[[Channel, Array, bool], FitResult]) -> list[FitResult]:
    fits = []
    sensors = [s for s in (Sensor.ACCEL, Sensor.GYRO) if options["sensor"] in {"all", s.value}]
    sensors = [s for s in sensors if source.recording.instances(s)]
    if not sensors:  # says what the recording has instead
        source.channels(Sensor.GYRO if options["sensor"] == "gyro" else Sensor.ACCEL)
    for sensor in sensors:
        for channel in source.channels(sensor):
            temperature = source.temperature(channel.instance)
            if temperature is None:
                raise InvalidInputError("the recording has no temperature: name its column, --map temperature=COLUMN")
            channel = _undisturbed(source, channel)
            good = np.isfinite(temperature.values[:, 0])
            if not good.any():
                raise InvalidInputError("the temperature column has no finite number")
            at = np.interp(channel.t, temperature.t[good], temperature.values[good, 0])
            fits.append(fit(channel, at, source.relative(channel)))
    return fits


def _undisturbed(source: Source, channel: Channel) -> Channel:
    """The samples of a vehicle's log in which it lay as in its longest rest; a table is taken whole."""
    stills = source.stills(channel.instance, held=True) if source.of_vehicle else ()
    if not stills:
        return channel
    longest = max(stills, key=lambda still: still.duration)
    keep = np.zeros(len(channel), dtype=np.bool_)
    for still in stills:
        same = still.accel is None or longest.accel is None or _together(still.accel, longest.accel)
        keep |= same & (channel.t >= still.start) & (channel.t < still.end)
    return channel.take(keep)


def _together(a: Array, b: Array) -> bool:
    return bool(np.linalg.norm(a - b) < 0.08 * np.linalg.norm(b))  # five degrees, or a strong drift


def thermal_linear(source: Source, options: Options) -> list[FitResult]:
    """Accelerometers and gyroscopes against their temperature, straight lines."""
    through = _point(options)
    if through is not None and options["sensor"] == "all" and len({c.sensor for c in _inertial(source)}) > 1:
        raise InvalidInputError("a fixed point is one sensor's: choose it with --sensor accel or --sensor gyro")

    def fit(channel: Channel, temperature: Array, relative: bool) -> FitResult:
        return fit_linear(
            channel,
            temperature,
            t_ref=options["tref"],
            through=through,
            min_span=options["min_span"],
            relative=relative,
        )

    return _thermal(source, options, fit)


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


def thermal_poly(source: Source, options: Options) -> list[FitResult]:
    """Accelerometers and gyroscopes against their temperature, polynomials."""
    fields = {"degree": options["degree"], "t_ref": options["tref"], "min_span": options["min_span"]}
    segments = source.recording.segments

    def fit(channel: Channel, temperature: Array, relative: bool) -> FitResult:
        common = {**fields, "lag": options["lag"] == "auto", "relative": relative}
        if channel.sensor != Sensor.ACCEL or len(segments) < 2:
            return fit_polynomial(channel, temperature, **common)
        number = np.searchsorted([s.start for s in segments], channel.t, side="right") - 1  # each its own pose
        inside = (number >= 0) & np.isfinite(channel.values).all(axis=1)
        data = DriftData.of(channel.take(inside), temperature[inside])
        return fit_posed(channel, data, number[inside].astype(np.intp), **common)

    return _thermal(source, options, fit)


METHODS = (
    Method(
        "thermal-linear",
        "Slope of accelerometer and gyroscope against temperature",
        "a motionless sensor whose temperature moves",
        (
            INSTANCE,
            SENSOR,
            Option("tref", float, 25.0, "temperature at which nothing is corrected, degC; 0 is the published form"),
            Option("through", str, None, "X,Y,Z: the lines go through these at tref; another estimator, never mixed"),
            Option("min_span", float, 2.0, "least range of temperature, degC"),
        ),
        thermal_linear,
    ),
    Method(
        "thermal-poly",
        "Polynomial drift of accelerometer and gyroscope against temperature",
        "a motionless sensor that warms up by ten degrees or more",
        (
            INSTANCE,
            SENSOR,
            Option("degree", int, 3, "of the polynomial, 1 to 5"),
            Option("tref", float, 35.0, "temperature at which the polynomial is zero, degC"),
            Option("min_span", float, 10.0, "least range of temperature, degC"),
            Option("lag", ("auto", "ignore"), "auto", "fit against the temperature of the die where it is seen to lag"),
        ),
        thermal_poly,
    ),
)
"""In the order of the command line."""
