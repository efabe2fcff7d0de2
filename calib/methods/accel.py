"""Methods for the accelerometer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.accel.faces import CONVENTIONS, Face, down_of
from mavcal.calib.accel.poses import fit_one_axis, fit_poses
from mavcal.calib.accel.six_face import FORMS, fit_six_face
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult
from mavcal.calib.flight.rest_temperatures import no_temperature
from mavcal.calib.methods import worthwhile
from mavcal.calib.methods.method import (
    FIXTURE,
    GRAVITY,
    INSTANCE,
    MIN_STILL,
    PLACE,
    FindingKind,
    Method,
    Options,
    Suggestion,
    gravity_of,
    mean_or_none,
)
from mavcal.calib.methods.source import Source
from mavcal.calib.noise.coarse_means import means_together
from mavcal.calib.option import Option
from mavcal.calib.recording import Array, Channel, Sensor
from mavcal.calib.stats.stillness import pose_means
from mavcal.calib.stats.windows import finite_rows
from mavcal.calib.thermal.accel import fit_accel_thermal

_KNOWN = 16  # samples from which on their scatter tells the uncertainty of their mean


def accel_one_axis(source: Source, options: Options) -> list[FitResult]:
    """Fits the longest rest, else every sample."""
    fits = []
    for accel in source.channels(Sensor.ACCEL):
        part = source.longest_rest(accel)
        gravity = gravity_of(options, accel)
        fits.append(
            fit_one_axis(part, gravity=gravity, fixture_sd=options["fixture_sd"], relative=source.relative(accel))
        )
    return fits


def accel_six_face(source: Source, options: Options) -> list[FitResult]:
    """Faces by label, by stillness, or row by row."""
    fits = []
    for accel in source.channels(Sensor.ACCEL):
        faces, temperature = _faces(source, accel, options)
        fit = fit_six_face(
            faces,
            gravity=options["gravity"],
            convention=options["convention"],
            form=options["form"],
            fixture_sd=options["fixture_sd"],
            instance=accel.instance,
            unit=accel.unit,
            temperature=temperature,
            relative=source.relative(accel),
        )
        fits.append(fit if source.readings(accel) else _too_short(source, fit, options))
    return fits


def _too_short(source: Source, fit: FitResult, options: Options) -> FitResult:
    return source.held_too_short(fit, fit.instance, options["min_still"])


def _faces(source: Source, accel: Channel, options: Options) -> tuple[list[Face], float | None]:
    """Faces by label, by stillness, or row by row in a table of readings; and the mean temperature."""
    all_samples = options["samples"] == "all"
    accel = accel.take(finite_rows(accel.values))
    if source.recording.segments:
        parts = [(down_of(s.label), accel.between(s.start, s.end)) for s in source.recording.segments]
        return _face_means(parts, all_samples=all_samples), None
    if source.readings(accel):
        groups: dict[tuple[int, bool], list[int]] = {}
        middle = 0.5 * (accel.values.max(axis=0) + accel.values.min(axis=0))
        for row, value in enumerate(accel.values - middle):
            axis = int(np.argmax(np.abs(value)))
            groups.setdefault((axis, bool(value[axis] > 0)), []).append(row)
        parts = [(None, accel.take(np.array(rows))) for rows in groups.values()]
        return _face_means(parts, all_samples=all_samples), None
    stills = source.stills(accel.instance, held=True, min_still=options["min_still"])
    gyro, temperature = source.maybe(Sensor.GYRO, accel.instance), source.temperature(accel.instance)
    poses = pose_means(accel, stills, gyro=gyro, temperature=temperature)
    square = [p for p in poses if np.abs(p.mean).max() > 0.9 * np.linalg.norm(p.mean)]
    known = [p.temperature for p in square if p.temperature is not None]
    if all_samples:
        spans = [accel.between(p.start, p.end) for p in square]
        return _face_means([(None, part) for part in spans], all_samples=True), mean_or_none(known)
    return [Face(p.mean, p.covariance, n=p.n) for p in square], mean_or_none(known)


def _face_means(parts: Sequence[tuple[Array | None, Channel]], *, all_samples: bool) -> list[Face]:
    """Face that is down and mean of every part, with a common noise; or one face per sample."""
    means = iter(() if all_samples else means_together([part for _, part in parts if len(part) > 1]))
    faces = []
    for down, part in parts:
        if all_samples or len(part) < 2:
            faces += [Face(value, None, down) for value in part.values]
        else:
            mean = next(means)
            faces.append(Face(mean.mean, mean.covariance if mean.n >= _KNOWN else None, down, n=mean.n))
    return faces


def accel_multi(source: Source, options: Options) -> list[FitResult]:
    """The means of every still pose."""
    fits = []
    for accel in source.channels(Sensor.ACCEL):
        if not source.timed and not source.recording.segments:
            raise InvalidInputError("still poses are found by time: the table has none; give --rate, or a column t")
        stills = source.stills(accel.instance, held=True, min_still=options["min_still"])
        gyro, temperature = source.maybe(Sensor.GYRO, accel.instance), source.temperature(accel.instance)
        fit = fit_poses(
            pose_means(accel, stills, gyro=gyro, temperature=temperature),
            gravity=options["gravity"] or STANDARD_GRAVITY,
            cross_sd=options["cross_sd"],
            form=options["form"],
            instance=accel.instance,
            unit=accel.unit,
            relative=source.relative(accel),
        )
        fits.append(_too_short(source, fit, options))
    return fits


def accel_thermal(source: Source, options: Options) -> list[FitResult]:
    """Still poses at different temperatures, in any direction."""
    fits = []
    for accel in source.channels(Sensor.ACCEL):
        temperature = source.temperature(accel.instance)
        if temperature is None:
            raise InvalidInputError(no_temperature(source.recording))
        if not source.timed and not source.recording.segments:
            raise InvalidInputError("still poses are found by time: the table has none; give --rate, or a column t")
        fits.append(
            fit_accel_thermal(
                accel,
                source.stills(accel.instance, held=True, min_still=options["min_still"]),
                temperature,
                degree=options["degree"],
                gravity=options["gravity"] or STANDARD_GRAVITY,
                t_ref=options["tref"],
                cross_sd=options["cross_sd"],
                gyro=source.maybe(Sensor.GYRO, accel.instance),
                relative=source.relative(accel),
            )
        )
    return fits


METHODS = (
    Method(
        "accel-one-axis",
        "a rest with one axis vertical to a degree",
        (INSTANCE, GRAVITY, *PLACE, FIXTURE),
        accel_one_axis,
    ),
    Method(
        "accel-six-face",
        "every axis once up and once down, square on a fixture; labelled, still, or one row a face",
        (
            INSTANCE,
            Option("gravity", float, None, "else 1 or the convention's (9.80665; accelcal 9.81), whichever is nearer"),
            *PLACE,
            Option("convention", CONVENTIONS, "specific-force", "accelcal: the axis that points down reads +g"),
            FIXTURE,
            MIN_STILL,
            Option("samples", ("means", "all"), "means", "regress on face means, or on all samples as published"),
            Option("form", FORMS, "accelcal", "forward: readings on true vectors, which noise does not bias"),
        ),
        accel_six_face,
    ),
    Method(
        "accel-multi",
        "six faces and three oblique poses or more, each held still for two seconds",
        (
            INSTANCE,
            GRAVITY,
            *PLACE,
            MIN_STILL,
            Option("cross_sd", float, 0.01, "prior standard deviation of the cross terms; 0 holds them at zero"),
            Option("form", ("symmetric", "upper"), "symmetric", "canonical form of the matrix"),
        ),
        accel_multi,
        suggestion=Suggestion(4, worthwhile.poses),
    ),
    Method(
        "accel-thermal",
        "six faces and oblique ones held still while cold, and again in opposite order when warm",
        (
            INSTANCE,
            GRAVITY,
            *PLACE,
            MIN_STILL,
            Option("degree", int, 2, "of the drift, 1 to 3"),
            Option("tref", float, None, "temperature that the offset refers to, degC; else the mean of the poses"),
            Option("cross_sd", float, 0.01, "prior standard deviation of the cross terms; 0 holds them at zero"),
        ),
        accel_thermal,
        finds=FindingKind.DRIFT,
    ),
)
"""In the order of the command line."""
