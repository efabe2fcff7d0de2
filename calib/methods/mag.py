"""Methods for the magnetometer, each on the parts of a recording with the same magnetic surroundings.

A bench and a flight differ: nearby steel, the field of running motors, a changed battery. A recording is split where
the vehicle was armed or disarmed, and at pauses. The others are compared with the part that determines the compass
best.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from mavcal.calib.accel.faces import down_of
from mavcal.calib.accel.rest_reference import SAMPLES, SensorTolerances, fit_rest_reference
from mavcal.calib.earth import EarthField, earth_field
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.stream.messages import COMPASS_WINDOW
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.mag.align import Vertical, fit_alignment
from mavcal.calib.mag.blur import deblurred, rates_during
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.mag.ellipsoid import fit_ellipsoid
from mavcal.calib.mag.gyro_aided import fit_gyro_aided
from mavcal.calib.mag.heading import DEFAULT_INCLINATION
from mavcal.calib.mag.result import plausible_field
from mavcal.calib.mag.ring_centres import CENTRES, LABELS
from mavcal.calib.mag.rings import fit_rings
from mavcal.calib.mag.simple_fits import fit_ellipsoid_axis, fit_minmax, fit_sphere
from mavcal.calib.methods import worthwhile
from mavcal.calib.methods.method import FIXTURE, GRAVITY, INSTANCE, FindingKind, Method, Options, Suggestion, gravity_of
from mavcal.calib.methods.source import Source
from mavcal.calib.option import Option
from mavcal.calib.recording import Array, Channel, Recording, Sensor, concatenated
from mavcal.calib.stats.windows import finite_rows

_PAUSE = 10.0
"""Pause, s (and twenty sample intervals), after which the surroundings of the compass may have changed."""
_FEWEST = 30  # samples of a stretch that is looked at
_BORDERS = ("armed", "disarmed", "reboot")  # kinds of events between which surroundings stay
_WORSE = 1.5  # times the residual of the measure that a stretch of the same surroundings may have
_VISIBLE = 0.005  # of the field: less is no other surroundings
_UPRIGHT = np.cos(np.radians(10.0))
"""Cosine of the angle to the vertical within which an axis counts as down, or up."""

_DEBLURRED = 2
"""Iterations of blur correction and fit, since each needs the result of the other."""

_FIELD = (
    Option("year", float, None, "decimal year: ties the scale to the World Magnetic Model at the recorded place"),
    Option("field", float, None, "strength of the field in uT, where it is known: ties the scale to it"),
)


@dataclass(frozen=True)
class _Part:
    """One contiguous part of a compass's samples, and its fit."""

    mag: Channel
    fit: FitResult

    @property
    def text(self) -> str:
        return f"{self.mag.t[0]:.0f} to {self.mag.t[-1]:.0f} s"


def of_one_surroundings(source: Source, mag: Channel, fit: Callable[[Channel], FitResult]) -> FitResult:
    """Fit of the parts of `mag` with the same surroundings; its warnings name the parts left out."""
    parts = _parts(source, mag)
    if len(parts) < 2:
        return fit(mag)
    alone = [_Part(part, fit(part)) for part in parts]
    known = [part for part in alone if part.fit.status != FitStatus.REFUSED and _plausible(part.fit)]
    if not known:
        return fit(mag)
    measure = min(known, key=lambda part: float(part.fit.quality["heading_sd_deg"]))
    own = _departure(measure.fit, measure.mag, measure.mag)
    limit = max(_WORSE * own, float(np.hypot(own, _VISIBLE)))
    off = [_departure(measure.fit, measure.mag, part.mag) for part in alone]
    same = [part for part, by in zip(alone, off, strict=True) if by <= limit]
    other = [(part, by) for part, by in zip(alone, off, strict=True) if by > limit]
    if not other:
        return fit(mag)
    found = fit(concatenated([part.mag for part in same])) if len(same) > 1 else measure.fit
    listed = ", ".join(f"{part.text} by {100.0 * by:.1f} %" for part, by in other)
    note = (
        f"only {', '.join(part.text for part in same)} was used: the field of other stretches departs from it "
        f"({listed}). Bench and flight differ so. --from and --until choose another stretch"
    )
    return dataclasses.replace(found, n_samples=len(mag), warnings=(note, *found.warnings))


def _plausible(fit: FitResult) -> bool:
    return fit.unit != "uT" or plausible_field(float(fit.quality["radius"]))


def _parts(source: Source, mag: Channel) -> list[Channel]:
    """The parts between which the surroundings may have changed, without very short ones."""
    if not source.timed or len(mag) < 2 * _FEWEST:
        return []
    steps = np.diff(mag.t)
    pause = max(_PAUSE, 20.0 * float(np.median(steps)))
    borders = [float(t) for t in mag.t[1:][steps > pause]]
    borders += [event.t for event in source.recording.events if event.kind in _BORDERS]
    edges = [-np.inf, *sorted(borders), np.inf]
    parts = [mag.between(a, b) for a, b in pairwise(edges)]
    return [part for part in parts if len(part) >= _FEWEST]


def _departure(fit: FitResult, measure: Channel, part: Channel) -> float:
    """Robust relative spread of the field strength in `part` after correction by `fit`."""
    length = float(np.median(np.linalg.norm(fit.model.apply(measure.values), axis=1)))
    off = np.abs(np.linalg.norm(fit.model.apply(part.values), axis=1) / length - 1.0)
    return float(np.sqrt(np.mean(np.minimum(off, np.percentile(off, 95.0)) ** 2)))


def _mag_facts(source: Source, mag: Channel, options: Options) -> dict[str, Any]:
    return {
        "instance": mag.instance,
        "unit": mag.unit,
        "quantum": mag.quantum,
        "field": _field(source, mag, options),
        "relative": source.relative(mag),
    }


def _times(source: Source, mag: Channel) -> Array | None:
    """Times of the samples of `mag`; None where rows were counted."""
    return mag.t if source.timed else None


def _field(source: Source, mag: Channel, options: Options) -> EarthField | None:
    """Known field: stated, or the model's at the place and time; None: the scale stays undetermined."""
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
    """A method that takes the samples alone."""

    def run(source: Source, options: Options) -> list[FitResult]:
        def alone(mag: Channel) -> FitResult:
            return fit(mag.values, times=_times(source, mag), **_mag_facts(source, mag, options))

        channels = [mag.take(finite_rows(mag.values)) for mag in source.channels(Sensor.MAG)]
        return [of_one_surroundings(source, mag, alone) for mag in channels]

    return run


def mag_ellipsoid(source: Source, options: Options) -> list[FitResult]:
    """The full ellipsoid; if the firmware averages the compass and there is a gyroscope, the blur is removed."""
    robust = {"auto": None, "yes": True, "no": False}[options["robust"]]
    window = COMPASS_WINDOW.get(source.recording.identity.autopilot or "", 0.0)
    gyro = source.maybe(Sensor.GYRO, 0)
    if gyro is not None:
        gyro = gyro.take(finite_rows(gyro.values) & np.append(True, np.diff(gyro.t) > 0))

    def alone(mag: Channel) -> FitResult:
        facts = {**_mag_facts(source, mag, options), "robust": robust, "prior_sd": options["prior_sd"]}
        facts["model"] = options["model"]
        if window > 0.0 and gyro is not None:
            return fit_ellipsoid_deblurred(mag.values, rates_during(mag.t, gyro.t, gyro.values, window), **facts)
        return fit_ellipsoid(mag.values, times=_times(source, mag), **facts)

    channels = [mag.take(finite_rows(mag.values)) for mag in source.channels(Sensor.MAG)]
    return [of_one_surroundings(source, mag, alone) for mag in channels]


def mag_rings(source: Source, options: Options) -> list[FitResult]:
    """Rings by the segment column, else by the axis that is down according to the accelerometer."""
    fits = []
    order = _stated_order(options["order"])
    for mag in source.channels(Sensor.MAG):
        mag = mag.take(finite_rows(mag.values))
        rings, downs = _rings(source, mag)
        if order and len(order) != len(rings):
            raise InvalidInputError(f"the order names {len(order)} rings, the recording has {len(rings)}")
        fits.append(
            fit_rings(
                rings,
                order or downs,
                centre=options["centre"],
                fixture_sd=options["fixture_sd"],
                diameter=options["diameter"],
                **_mag_facts(source, mag, options),
            )
        )
    return fits


def _stated_order(text: str | None) -> list[Array | None]:
    """The axes of ``x-down,x-up,...``; none where nothing is stated."""
    found: list[Array | None] = []
    for label in (text or "").split(","):
        down = down_of(label)
        if down is None and label.strip():
            raise InvalidInputError(f"{label!r} names no axis: the order is made of {LABELS}")
        if down is not None:
            found.append(down)
    return found


def _rings(source: Source, mag: Channel) -> tuple[list[Array], list[Array | None]]:
    """Samples of every ring, and the axis that was down; None: not labelled."""
    if source.recording.segments:
        parts = [(down_of(s.label), mag.between(s.start, s.end).values) for s in source.recording.segments]
        return [values for _, values in parts if len(values)], [down for down, values in parts if len(values)]
    accel = source.maybe(Sensor.ACCEL, 0)
    if accel is None or not source.timed:
        raise InvalidInputError(
            f"nothing tells the rings apart: label them in a column segment ({LABELS}), or record the accelerometer too"
        )
    accel = accel.take(finite_rows(accel.values))
    down = -np.column_stack([np.interp(mag.t, accel.t, column) for column in accel.values.T])
    down /= np.maximum(np.linalg.norm(down, axis=1), 1e-12)[:, None]
    ways = np.vstack([np.eye(3), -np.eye(3)])
    return [mag.values[down @ way > _UPRIGHT] for way in ways], list(ways)


def rest_reference(source: Source, options: Options) -> list[FitResult]:
    """The longest rest, else every sample."""
    fits = []
    for accel in source.channels(Sensor.ACCEL):
        part = source.longest_rest(accel)
        mag = source.maybe(Sensor.MAG, accel.instance) or source.maybe(Sensor.MAG, 0)
        if mag is not None and len(part):
            mag = mag.between(part.t[0], np.nextafter(part.t[-1], np.inf))
        field = None if mag is None else _field(source, mag, {**options, "field": None})
        fits.append(
            fit_rest_reference(
                part,
                mag,
                samples=options["samples"],
                sensors=SensorTolerances(options["accel_sd"], options["mag_sd"]),
                field=field,
                relative=source.relative(accel),
            )
        )
    return fits


def mag_align(source: Source, options: Options) -> list[FitResult]:
    """Every magnetometer against the accelerometer that reads gravity best, as the vehicle corrects it."""
    fits = []
    accel = _steadiest(source.streamed, options)
    gyro = source.maybe(Sensor.GYRO, accel.instance)
    gyro = None if gyro is None or gyro.unit != "rad/s" else gyro.take(finite_rows(gyro.values))
    vertical = Vertical(
        t=accel.t,
        accel=accel.values,
        gravity=gravity_of(options, accel),
        gyro_t=None if gyro is None else gyro.t,
        gyro=None if gyro is None else gyro.values,
        timed=source.timed,
    )
    window = COMPASS_WINDOW.get(source.recording.identity.autopilot or "", 0.0)
    for mag in source.channels(Sensor.MAG):
        fit = _aligned(source, mag.take(finite_rows(mag.values)), vertical, window, options)
        fits.append(dataclasses.replace(fit, quality={**fit.quality, "accel_instance": accel.instance}))
    return fits


def _aligned(source: Source, mag: Channel, vertical: Vertical, window: float, options: Options) -> FitResult:
    """One magnetometer against the vertical, without the blur of averaging over `window` seconds."""
    facts = {"gate": options["gate"], "time_offset": options["time_offset"], **_mag_facts(source, mag, options)}
    if window == 0.0 or vertical.gyro is None or vertical.gyro_t is None:
        return fit_alignment(mag.t, mag.values, vertical, **facts)
    increasing = np.append(True, np.diff(vertical.gyro_t) > 0)
    rates = rates_during(mag.t, vertical.gyro_t[increasing], vertical.gyro[increasing], window)
    sharp = rates.sharp()
    mag, rates = mag.take(sharp), rates.take(sharp)
    fit = fit_alignment(mag.t, mag.values, vertical, **facts)
    for _ in range(_DEBLURRED):
        if fit.status == FitStatus.REFUSED:
            break
        fit = fit_alignment(mag.t, deblurred(mag.values, rates, fit.model), vertical, **facts)
    return fit


def _steadiest(recording: Recording, options: Options) -> Channel:
    """The requested accelerometer, or the one whose length is nearest to gravity in most samples."""
    asked = options["accel"]
    channels = [
        recording.channel(Sensor.ACCEL, i)
        for i in (recording.instances(Sensor.ACCEL) or (0,) if asked is None else (asked,))
    ]
    finite = [channel.take(finite_rows(channel.values)) for channel in channels]

    def off(channel: Channel) -> float:
        lengths = np.linalg.norm(channel.values, axis=1)
        return float(np.median(np.abs(lengths / gravity_of(options, channel) - 1.0))) if len(lengths) else np.inf

    return min(finite, key=off)


def mag_gyro(source: Source, options: Options) -> list[FitResult]:
    """Every compass against the first gyroscope; the blur of an averaging firmware is removed."""
    window = COMPASS_WINDOW.get(source.recording.identity.autopilot or "", 0.0)
    gyro = source.recording.channel(Sensor.GYRO, 0)
    return [
        fit_gyro_aided(mag, gyro, delay=options["delay"], window=window, **_mag_facts(source, mag, options))
        for mag in source.channels(Sensor.MAG)
    ]


METHODS = (
    Method(
        "mag-minmax",
        "every axis once along and once against the field; only a start for better methods",
        (INSTANCE, *_FIELD),
        mag_of(fit_minmax),
    ),
    Method(
        "rest-reference",
        "a hundred samples of accelerometer and magnetometer at rest",
        (
            INSTANCE,
            Option("samples", int, SAMPLES, "averaged to a reference vector"),
            Option("accel_sd", float, 0.0, "offset that the accelerometer's calibration leaves, in its unit"),
            Option("mag_sd", float, 0.0, "offset that the magnetometer's calibration leaves, in its unit"),
            _FIELD[0],
        ),
        rest_reference,
        finds=FindingKind.FIGURES,
    ),
    Method(
        "mag-sphere",
        "rotation about two axes or more, no soft iron",
        (INSTANCE, *_FIELD),
        mag_of(fit_sphere),
    ),
    Method(
        "mag-ellipsoid-axis",
        "rotation in all directions, no cross terms",
        (INSTANCE, *_FIELD),
        mag_of(fit_ellipsoid_axis),
    ),
    Method(
        "mag-ellipsoid",
        "rotation in all directions",
        (
            INSTANCE,
            *_FIELD,
            Option(
                "model",
                ("offset", "diagonal", "symmetric", "auto"),
                "symmetric",
                "what is free: a sphere, three radii, all of the soft iron; auto weighs them by their likelihood",
            ),
            Option("robust", ("auto", "yes", "no"), "auto", "withstand outliers"),
            Option(
                "prior_sd", float, None, "prior standard deviation of the soft iron, where the rotation covers little"
            ),
        ),
        mag_ellipsoid,
        suggestion=Suggestion(7, worthwhile.ellipsoid),
    ),
    Method(
        "mag-rings",
        f"a whole turn with every axis down and up; one label a ring ({LABELS}), or the accelerometer",
        (
            INSTANCE,
            *_FIELD,
            Option("centre", CENTRES, "circle", "how the centre of a ring is found"),
            Option("diameter", float, None, "length of a corrected diameter, in whatever unit: ties the scale to it"),
            Option("order", str, None, f"which ring is which where no label says, such as {LABELS.replace(', ', ',')}"),
            FIXTURE,
        ),
        mag_rings,
    ),
    Method(
        "mag-align",
        "rotation in all directions, slowly; a calibrated accelerometer in the recording",
        (
            INSTANCE,
            *_FIELD,
            GRAVITY,
            Option("gate", float, 0.1, "departure of |accel| from gravity, relative, up to which it is the vertical"),
            Option("accel", int, None, "instance of the accelerometer, from 0; else the one that reads gravity best"),
            Option("time_offset", float, None, "s by which the magnetometer is later; else it is estimated"),
        ),
        mag_align,
    ),
    Method(
        "mag-gyro",
        "any motion about two axes or more, a gyroscope in rad/s",
        (
            INSTANCE,
            *_FIELD,
            Option("delay", float, None, "how much later than the gyroscope the compass is, s; else estimated"),
        ),
        mag_gyro,
    ),
)
"""In the order of the command line."""
