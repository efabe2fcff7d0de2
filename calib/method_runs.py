"""How each method takes what it needs out of a recording, one function a method."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib import STANDARD_GRAVITY
from calib.accel import fit_one_axis, fit_poses
from calib.earth import EarthField, earth_field
from calib.errors import InvalidInputError
from calib.fit import FitResult
from calib.gyro import fit_gyro_rest
from calib.mag.blur import fit_ellipsoid_deblurred, rates_during
from calib.mag.ellipsoid import fit_ellipsoid
from calib.mag.heading import DEFAULT_INCLINATION
from calib.method_source import Source
from calib.procedures.mag import COMPASS_WINDOW
from calib.quantisation import mean_of
from calib.recording import Channel, Sensor
from calib.six_face import Face, down_of, fit_six_face
from calib.stillness import pose_means
from calib.thermal import fit_linear, fit_polynomial
from calib.windows import finite_rows

Array = NDArray[np.float64]
Options = Mapping[str, Any]


def accel_one_axis(source: Source, options: Options) -> list[FitResult]:
    """The longest rest, else every sample."""
    fits = []
    for accel in source.channels(Sensor.ACCEL):
        part = source.longest_rest(accel)
        gravity = _gravity(options, accel)
        fits.append(
            fit_one_axis(part, gravity=gravity, fixture_sd=options["fixture_sd"], relative=source.relative(accel))
        )
    return fits


def accel_six_face(source: Source, options: Options) -> list[FitResult]:
    """Faces by label, by stillness, or row by row."""
    fits = []
    for accel in source.channels(Sensor.ACCEL):
        faces, temperature = _faces(source, accel, all_samples=options["samples"] == "all")
        fits.append(
            fit_six_face(
                faces,
                gravity=options["gravity"],
                convention=options["convention"],
                fixture_sd=options["fixture_sd"],
                instance=accel.instance,
                unit=accel.unit,
                temperature=temperature,
                relative=source.relative(accel),
            )
        )
    return fits


def _faces(source: Source, accel: Channel, *, all_samples: bool) -> tuple[list[Face], float | None]:
    """Faces by label, by stillness, or row by row in a table without time; and the mean temperature."""
    accel = accel.take(finite_rows(accel.values))
    if source.recording.segments:
        parts = [(down_of(s.label), accel.between(s.start, s.end)) for s in source.recording.segments]
        faces = [face for down, part in parts if len(part) for face in _face(part, down, all_samples=all_samples)]
        return faces, None
    if not source.timed:
        groups: dict[tuple[int, bool], list[int]] = {}
        middle = 0.5 * (accel.values.max(axis=0) + accel.values.min(axis=0))
        for row, value in enumerate(accel.values - middle):
            axis = int(np.argmax(np.abs(value)))
            groups.setdefault((axis, bool(value[axis] > 0)), []).append(row)
        parts = [(None, accel.take(np.array(rows))) for rows in groups.values()]
        return [face for _, part in parts for face in _face(part, None, all_samples=all_samples)], None
    stills = source.stills(accel.instance, held=True)
    gyro, temperature = source.maybe(Sensor.GYRO, accel.instance), source.temperature(accel.instance)
    poses = pose_means(accel, stills, gyro=gyro, temperature=temperature)
    square = [p for p in poses if np.abs(p.mean).max() > 0.9 * np.linalg.norm(p.mean)]
    known = [p.temperature for p in square if p.temperature is not None]
    if all_samples:
        spans = [accel.between(p.start, p.end) for p in square]
        return [face for part in spans for face in _face(part, None, all_samples=True)], _mean(known)
    return [Face(p.mean, p.covariance, n=p.n) for p in square], _mean(known)


def _face(part: Channel, down: Array | None, *, all_samples: bool) -> list[Face]:
    if all_samples or len(part) < 2:
        return [Face(value, None, down) for value in part.values]
    mean = mean_of(part)
    known = len(part) >= 16 and not any(mean.constant)
    return [Face(mean.mean, mean.covariance if known else None, down, n=len(part))]


def accel_multi(source: Source, options: Options) -> list[FitResult]:
    """The means of every still pose."""
    fits = []
    for accel in source.channels(Sensor.ACCEL):
        if not source.timed and not source.recording.segments:
            raise InvalidInputError("still poses are found by time: the table has none; give --rate, or a column t")
        stills = source.stills(accel.instance, held=True)
        gyro, temperature = source.maybe(Sensor.GYRO, accel.instance), source.temperature(accel.instance)
        fits.append(
            fit_poses(
                pose_means(accel, stills, gyro=gyro, temperature=temperature),
                gravity=options["gravity"] or STANDARD_GRAVITY,
                cross_sd=options["cross_sd"],
                form=options["form"],
                instance=accel.instance,
                unit=accel.unit,
                relative=source.relative(accel),
            )
        )
    return fits


def gyro_rest(source: Source, options: Options) -> list[FitResult]:
    """The longest rest, with accelerometer and compass as witnesses."""
    fits = []
    for gyro in source.channels(Sensor.GYRO):
        part = source.longest_rest(gyro)
        span = (part.t[0], np.nextafter(part.t[-1], np.inf))
        accel, mag = source.maybe(Sensor.ACCEL, gyro.instance), source.maybe(Sensor.MAG, 0)
        temperature = source.temperature(gyro.instance)
        fits.append(
            fit_gyro_rest(
                part,
                accel=accel.between(*span) if accel is not None else None,
                mag=mag.between(*span) if mag is not None and mag.unit == "uT" else None,
                temperature=_mean(temperature.between(*span).values[:, 0]) if temperature is not None else None,
                relative=source.relative(gyro),
            )
        )
    return fits


def _mag_facts(source: Source, mag: Channel, options: Options) -> dict[str, Any]:
    return {
        "instance": mag.instance,
        "unit": mag.unit,
        "quantum": mag.quantum,
        "field": _field(source, mag, options),
        "relative": source.relative(mag),
    }


def _field(source: Source, mag: Channel, options: Options) -> EarthField | None:
    """The field that is known: stated, or the model's where and when it was recorded; None: the scale stays open."""
    year, strength = options["year"], options["field"]
    if (year is None and strength is None) or mag.unit != "uT":
        return None
    if strength is not None:
        if not strength > 0.0:
            raise InvalidInputError(f"the strength of the field is positive, not {strength} uT")
        dip = np.array([np.cos(DEFAULT_INCLINATION), 0.0, np.sin(DEFAULT_INCLINATION)])
        return EarthField(float(strength) * dip)
    position = source.maybe(Sensor.POSITION, 0)
    if position is None:
        raise InvalidInputError("the recording has no position: state the strength of the field instead, --field UT")
    latitude, longitude, altitude = np.median(position.values, axis=0)
    return earth_field(float(latitude), float(longitude), float(altitude), float(year))


def mag_of(fit: Callable[..., FitResult]) -> Callable[[Source, Options], list[FitResult]]:
    """A method that takes nothing but the samples."""

    def run(source: Source, options: Options) -> list[FitResult]:
        return [
            fit(mag.values[finite_rows(mag.values)], **_mag_facts(source, mag, options))
            for mag in source.channels(Sensor.MAG)
        ]

    return run


def mag_ellipsoid(source: Source, options: Options) -> list[FitResult]:
    """The full ellipsoid; where the firmware averages the compass and a gyroscope is there, its blur is undone."""
    fits = []
    robust = {"auto": None, "yes": True, "no": False}[options["robust"]]
    window = COMPASS_WINDOW.get(source.recording.identity.autopilot or "", 0.0)
    for mag in source.channels(Sensor.MAG):
        mag = mag.take(finite_rows(mag.values))
        facts = {**_mag_facts(source, mag, options), "robust": robust, "prior_sd": options["prior_sd"]}
        gyro = source.maybe(Sensor.GYRO, 0)
        if window > 0.0 and gyro is not None:
            gyro = gyro.take(finite_rows(gyro.values) & np.append(True, np.diff(gyro.t) > 0))
            fits.append(fit_ellipsoid_deblurred(mag.values, rates_during(mag.t, gyro.t, gyro.values, window), **facts))
        else:
            fits.append(fit_ellipsoid(mag.values, **facts))
    return fits


def _thermal(source: Source, fit: Callable[[Channel, Array, bool], FitResult]) -> list[FitResult]:
    fits = []
    sensors = [s for s in (Sensor.ACCEL, Sensor.GYRO) if source.recording.instances(s)]
    if not sensors:
        source.channels(Sensor.ACCEL)  # says what the recording has instead
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

    def fit(channel: Channel, temperature: Array, relative: bool) -> FitResult:
        return fit_linear(channel, temperature, t_ref=options["tref"], min_span=options["min_span"], relative=relative)

    return _thermal(source, fit)


def thermal_poly(source: Source, options: Options) -> list[FitResult]:
    """Accelerometers and gyroscopes against their temperature, polynomials."""

    def fit(channel: Channel, temperature: Array, relative: bool) -> FitResult:
        return fit_polynomial(
            channel,
            temperature,
            degree=options["degree"],
            t_ref=options["tref"],
            min_span=options["min_span"],
            relative=relative,
        )

    return _thermal(source, fit)


def _mean(values: Sequence[float] | Array) -> float | None:
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    return float(finite.mean()) if len(finite) else None


def _gravity(options: Options, accel: Channel) -> float:
    if options["gravity"] is not None:
        return float(options["gravity"])
    if accel.unit != "m/s2":
        raise InvalidInputError(f"gravity in {accel.unit} is not known: state it with --gravity")
    return STANDARD_GRAVITY
