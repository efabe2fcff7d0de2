"""Methods for the magnetometer from ordinary flights."""

from __future__ import annotations

import dataclasses
from datetime import datetime
from typing import Any

import numpy as np

from mavcal.calib.earth import EarthField, decimal_year, earth_field
from mavcal.calib.errors import CalibError, InvalidInputError
from mavcal.calib.firmware import body_from_sensor, calibration_in_force
from mavcal.calib.firmware.compose.mag_motor import compensated, corrupt_compensation
from mavcal.calib.firmware.stream.messages import COMPASS_WINDOW
from mavcal.calib.fit import FitBuilder, FitResult, parameter_names
from mavcal.calib.mag.flight import METHOD as FLIGHT
from mavcal.calib.mag.flight import SOFT_IRON, fit_flight
from mavcal.calib.mag.flight_input import between, end_of_flight
from mavcal.calib.mag.flight_path import Turning
from mavcal.calib.mag.motor import fit_motor
from mavcal.calib.mag.motor_drives import METHOD as MOTOR
from mavcal.calib.mag.motor_drives import Drive, DriveKind
from mavcal.calib.methods import worthwhile
from mavcal.calib.methods.method import INSTANCE, FindingKind, Method, Options, Suggestion
from mavcal.calib.methods.source import Source
from mavcal.calib.option import Option
from mavcal.calib.recording import Channel, Sensor, Stage

_SENSORS = {
    DriveKind.CURRENT: Sensor.CURRENT,
    DriveKind.THROTTLE: Sensor.THROTTLE,
    DriveKind.MOTORS: Sensor.MOTOR,
}
_FIXED_BY = 1e-4  # degrees and more from the equator and Greenwich: a position of zeros is none
_FROM = (
    INSTANCE,
    Option("attitude", ("auto", "log", "gyro"), "auto", "log: its attitude; gyro: the gyroscope alone; auto: both"),
    Option("year", float, None, "decimal year of the flight, where the log's clock does not say it"),
    Option("field", float, None, "strength of the field in uT, where it is known and the place is not"),
    Option("gyro", int, None, "instance of the gyroscope, from 0; else the one with the most samples"),
)


def mag_flight(source: Source, options: Options) -> list[FitResult]:
    """Every compass of the flight."""
    drives = _drives(source, options["drive"])
    return [
        _fitted(
            source,
            mag,
            options,
            FLIGHT,
            lambda mag, turning, facts: fit_flight(
                mag, turning, drive=drives[0] if drives else None, soft_iron=options["soft_iron"], **facts
            ),
        )
        for mag in source.channels(Sensor.MAG)
    ]


def mag_motor(source: Source, options: Options) -> list[FitResult]:
    """Every compass against every drive signal in the flight."""
    drives = _drives(source, options["drive"])
    return [
        _fitted(source, mag, options, MOTOR, lambda mag, turning, facts: fit_motor(mag, turning, drives, **facts))
        for mag in source.channels(Sensor.MAG)
    ]


def _fitted(source: Source, mag: Channel, options: Options, method: str, fit: Any) -> FitResult:
    corrupt = corrupt_compensation(source.recording.identity.autopilot, source.recording.parameters, mag.instance)
    if corrupt:
        return FitBuilder.of(method, mag).refused(
            corrupt,
            parameter_names() if method == FLIGHT else (),
            "put the parameters right, then fly again",
            quality={"corrupt_parameters": True},
        )
    turning, end = _turning(source, options)
    cut = between(mag, end)
    found: FitResult = fit(cut if cut is not None else mag, turning, _facts(source, mag, turning, options))
    last = source.streamed.span[1]
    if end < last:
        note = f"nothing after {end:.1f} s was used: a crash. --until uses more"
        found = dataclasses.replace(found, warnings=(*found.warnings, note))
    return found


def _turning(source: Source, options: Options) -> tuple[Turning, float]:
    """Gyroscope and attitude as the vehicle corrects them, body axes, and the time at which the flight ends."""
    log = source.streamed
    accel = [log.channel(Sensor.ACCEL, i) for i in log.instances(Sensor.ACCEL)[:1]]
    attitude = next(iter(log.find(Sensor.ATTITUDE, 0)), None)
    gyro = _gyroscope(source, options["gyro"])
    end = options["until"]
    if end is None:
        end = end_of_flight(log.span[1], accel[0] if accel else None, attitude)
    if options["attitude"] == "log" and attitude is None:
        raise InvalidInputError("the recording has no attitude: use the gyroscope alone, --attitude gyro")
    if options["attitude"] == "gyro" and gyro is None:
        raise InvalidInputError("the recording has no gyroscope in rad/s: use the log's attitude, --attitude log")
    cut = np.nextafter(end, np.inf)
    return Turning(
        between(gyro, cut) if options["attitude"] != "log" else None,
        between(attitude, cut) if options["attitude"] != "gyro" else None,
    ), float(cut)


def _gyroscope(source: Source, asked: int | None) -> Channel | None:
    log = source.streamed
    instances = log.instances(Sensor.GYRO) if asked is None else (asked,)
    found = [c for i in instances for c in log.find(Sensor.GYRO, i) if c.stage != Stage.DEBIASED and c.unit == "rad/s"]
    return max(found, key=len, default=None)


def _facts(source: Source, mag: Channel, turning: Turning, options: Options) -> dict[str, Any]:
    autopilot = source.recording.identity.autopilot
    in_force, mounting, relative, motors = None, None, source.relative(mag), False
    if mag.stage == Stage.RAW and source.recording.parameters and autopilot in {"ardupilot", "px4"}:
        try:
            parameters = source.recording.parameters.at(float(mag.t[0]))
            in_force = calibration_in_force(autopilot, parameters, Sensor.MAG, mag.instance)
            mounting = body_from_sensor(autopilot, parameters, Sensor.MAG, mag.instance)
            motors = compensated(autopilot, parameters, mag.instance)
        except CalibError:
            in_force, mounting, relative = None, None, True
    return {
        "in_force": in_force,
        "window": COMPASS_WINDOW.get(autopilot or "", 0.0),
        "instance": mag.instance,
        "unit": mag.unit,
        "quantum": mag.quantum,
        "field": _field(source, mag, turning, options),
        "body_from_sensor": mounting,
        "relative": relative,
        "compensated": motors,
    }


def _field(source: Source, mag: Channel, turning: Turning, options: Options) -> EarthField | None:
    """Field of the magnetic model at the place and time of the flight; None: not known."""
    strength = options["field"]
    if mag.unit != "uT":
        return None
    year = options["year"] if options["year"] is not None else _year(source)
    position = source.maybe(Sensor.POSITION, 0)
    if strength is None and position is not None and year is not None:
        fixed = position.values[np.abs(position.values[:, :2]).max(axis=1) > _FIXED_BY]
        if len(fixed):
            latitude, longitude, altitude = np.median(fixed, axis=0)
            return earth_field(float(latitude), float(longitude), float(altitude), year)
    if strength is None:
        return None
    if not strength > 0.0:
        raise InvalidInputError(f"the strength of the field is positive, not {strength} uT")
    if turning.attitude is not None:
        raise InvalidInputError("a strength of the field without its dip needs --attitude gyro")
    return EarthField(np.array([0.0, 0.0, float(strength)]))


def _year(source: Source) -> float | None:
    """Decimal year by the log's satellite time; None: it has none."""
    for event in source.recording.events:
        if event.kind == "utc":
            return decimal_year(datetime.fromisoformat(event.text))
    return None


def _drives(source: Source, asked: str) -> list[Drive]:
    """Possible drive signals of the motors' field, the simplest first."""
    if asked == "none":
        return []
    kinds = list(DriveKind) if asked == "auto" else [DriveKind(asked)]
    found = []
    for kind in kinds:
        channel = next(iter(source.streamed.find(_SENSORS[kind], 0)), None)
        drive = None if channel is None else Drive.of(kind, channel)
        if drive is not None:
            found.append(drive)
    if not found and asked != "auto":
        raise InvalidInputError(f"the recording has no {asked} that changes")
    return found


_DRIVE = ("auto", *(str(kind) for kind in DriveKind))

METHODS = (
    Method(
        "mag-flight",
        "a compass with a gyroscope or an attitude; whole circles on the spot and banks",
        (
            *_FROM,
            Option("soft_iron", SOFT_IRON, "auto", "held: as in force; free: up to a tenth; auto: as the flight shows"),
            Option("drive", ("none", *_DRIVE), "auto", "what the motors' field is estimated against, beside"),
        ),
        mag_flight,
        suggestion=Suggestion(5, worthwhile.mag_flight),
    ),
    Method(
        "mag-motor",
        "a compass with a gyroscope or an attitude, and current, throttle or motor outputs that change",
        (*_FROM, Option("drive", _DRIVE, "auto", "what drives it; auto: what predicts unseen data best")),
        mag_motor,
        finds=FindingKind.MOTORS,
        suggestion=Suggestion(6, worthwhile.mag_motor),
    ),
)
"""In the order of the command line."""
