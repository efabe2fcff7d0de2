"""Methods for the gyroscope."""

from __future__ import annotations

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import OFFSETS, FitBuilder, FitResult
from mavcal.calib.gyro.g_sensitivity import fit_g_sensitivity
from mavcal.calib.gyro.rest import fit_gyro_rest
from mavcal.calib.gyro.thread import fit_thread
from mavcal.calib.gyro.turntable import fit_turntable
from mavcal.calib.methods import worthwhile
from mavcal.calib.methods.method import (
    GRAVITY,
    INSTANCE,
    FindingKind,
    Method,
    Options,
    Suggestion,
    gravity_of,
    mean_or_none,
)
from mavcal.calib.methods.source import Source
from mavcal.calib.option import Option
from mavcal.calib.recording import Channel, Sensor


def gyro_rest(source: Source, options: Options) -> list[FitResult]:
    """The longest rest, with accelerometer and compass as witnesses."""
    fits = []
    for gyro in source.channels(Sensor.GYRO):
        if source.flown_throughout(gyro.instance):
            fits.append(_never_at_rest(gyro))
            continue
        part = source.longest_rest(gyro)
        span = (part.t[0], np.nextafter(part.t[-1], np.inf))
        accel, mag = source.companion(Sensor.ACCEL, gyro.instance), source.maybe(Sensor.MAG, 0)
        temperature = source.temperature(gyro.instance)
        fits.append(
            fit_gyro_rest(
                part,
                accel=accel.between(*span) if accel is not None else None,
                mag=mag.between(*span) if mag is not None and mag.unit == "uT" else None,
                temperature=mean_or_none(temperature.between(*span).values[:, 0]) if temperature is not None else None,
                relative=source.relative(gyro),
            )
        )
    return fits


def _never_at_rest(gyro: Channel) -> FitResult:
    return FitBuilder.of("gyro-rest", gyro).refused(
        "the vehicle was armed and never at rest with its motors off: log some seconds on the ground before arming",
        OFFSETS,
        "leave the vehicle still on the ground, disarmed, for some seconds",
    )


def gyro_turntable(source: Source, options: Options) -> list[FitResult]:
    """Labelled turns, or steady ones that are found, at the stated rate."""
    channels = source.channels(Sensor.GYRO)
    if options["rate_true"] is None:
        raise InvalidInputError("the rate of the table is needed: --rate-true 90, or by label --rate-true x+=90,x-=-90")
    segments = source.recording.segments
    if not segments and not source.timed:
        raise InvalidInputError("turns are found by time: the table has none; give --rate, or a column segment")
    rate_true = _rates_of(options["rate_true"])
    return [
        fit_turntable(
            gyro,
            rate_true,
            segments=segments,
            accel=source.companion(Sensor.ACCEL, gyro.instance),
            rate_sd=float(np.radians(options["rate_sd"])),
            latitude=options["latitude"],
            temperature=_mean_temperature(source, gyro),
            relative=source.relative(gyro),
        )
        for gyro in channels
    ]


def gyro_thread(source: Source, options: Options) -> list[FitResult]:
    """Turns by label, or the spans of turning that are found; counted by a compass where none are stated."""
    if not source.timed:
        raise InvalidInputError("turns are integrated over time: the table has none; give --rate, or a column t")
    return [
        fit_thread(
            gyro,
            turns=options["turns"],
            mag=source.maybe(Sensor.MAG, 0),
            segments=source.recording.segments,
            angle_sd=float(np.radians(options["angle_sd"])),
            temperature=_mean_temperature(source, gyro),
            relative=source.relative(gyro),
        )
        for gyro in source.channels(Sensor.GYRO)
    ]


def gyro_g_sensitivity(source: Source, options: Options) -> list[FitResult]:
    """The rests of every inertial unit that has both sensors."""
    if not source.timed and not source.recording.segments:
        raise InvalidInputError("rests are found by time: the table has none; give --rate, or a column segment")
    fits = []
    for gyro in source.channels(Sensor.GYRO):
        accel = source.maybe(Sensor.ACCEL, gyro.instance)
        if accel is None:
            raise InvalidInputError(f"the recording has no accelerometer {gyro.instance}: acceleration must be known")
        stills = source.stills(gyro.instance, held=False)
        fits.append(
            fit_g_sensitivity(
                gyro,
                accel,
                np.array([[still.start, still.end] for still in stills]),
                gravity=gravity_of(options, accel),
                latitude=options["latitude"],
                drift=options["drift"] == "yes",
                temperature=_mean_temperature(source, gyro),
                relative=source.relative(gyro),
            )
        )
    return fits


def _mean_temperature(source: Source, gyro: Channel) -> float | None:
    temperature = source.temperature(gyro.instance)
    return mean_or_none(temperature.values[:, 0]) if temperature is not None else None


def _rates_of(text: str) -> float | dict[str, float]:
    """Rates in rad/s from degrees a second: one number, or ``LABEL=RATE,LABEL=RATE``.

    Raises
    ------
    InvalidInputError
        If the text is neither.
    """
    try:
        if "=" not in text:
            return float(np.radians(float(text)))
        pairs = [part.rpartition("=") for part in text.split(",")]
        return {label.strip(): float(np.radians(float(rate))) for label, _, rate in pairs}
    except ValueError:
        raise InvalidInputError(
            f"a rate is a number of degrees a second, or LABEL=RATE,LABEL=RATE; {text!r} is neither"
        ) from None


_LATITUDE = Option("latitude", float, None, "degrees; takes the Earth's rate about the vertical off")

METHODS = (
    Method(
        "gyro-rest",
        "five seconds at rest",
        (INSTANCE,),
        gyro_rest,
        suggestion=Suggestion(1, worthwhile.gyro_rest),
    ),
    Method(
        "gyro-turntable",
        "steady turns of five seconds about one axis or three, both ways",
        (
            INSTANCE,
            Option("rate_true", str, None, "true rate, deg/s: one for all turns, or LABEL=RATE,... with its sign"),
            Option("rate_sd", float, 0.0, "uncertainty of the true rate, deg/s"),
            _LATITUDE,
        ),
        gyro_turntable,
    ),
    Method(
        "gyro-thread",
        "whole turns about one axis one way, and as many back",
        (
            INSTANCE,
            Option("turns", float, None, "turns each way, from rest to rest; else a compass counts whole ones"),
            Option("angle_sd", float, 0.0, "how far from whole the stated turns may be, degrees"),
        ),
        gyro_thread,
    ),
    Method(
        "gyro-g-sensitivity",
        "a rest on each of six sides, ten seconds or more",
        (
            INSTANCE,
            GRAVITY,
            _LATITUDE,
            Option("drift", ("no", "yes"), "no", "also fit an offset that moves steadily over time"),
        ),
        gyro_g_sensitivity,
        finds=FindingKind.FIGURES,
    ),
)
"""In the order of the command line."""
