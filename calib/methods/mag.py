"""Methods for the magnetometer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.earth import EarthField, earth_field
from calib.errors import InvalidInputError
from calib.fit import FitResult
from calib.mag.blur import fit_ellipsoid_deblurred, rates_during
from calib.mag.ellipsoid import fit_ellipsoid
from calib.mag.ellipsoid_axis import fit_ellipsoid_axis
from calib.mag.heading import DEFAULT_INCLINATION
from calib.mag.minmax import fit_minmax
from calib.mag.sphere import fit_sphere
from calib.methods.method import INSTANCE, Method, Option, Options
from calib.methods.source import Source
from calib.procedures.mag import COMPASS_WINDOW
from calib.recording import Channel, Sensor
from calib.windows import finite_rows

Array = NDArray[np.float64]

_FIELD = (
    Option("year", float, None, "decimal year: ties the scale to the World Magnetic Model at the recorded place"),
    Option("field", float, None, "strength of the field in uT, where it is known: ties the scale to it"),
)


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


METHODS = (
    Method(
        "mag-minmax",
        "Magnetometer offset and scale from the extremes",
        "every axis once along and once against the field; only a start for better methods",
        (INSTANCE, *_FIELD),
        mag_of(fit_minmax),
    ),
    Method(
        "mag-sphere",
        "Magnetometer offset by a sphere",
        "rotation about two axes or more, no soft iron",
        (INSTANCE, *_FIELD),
        mag_of(fit_sphere),
    ),
    Method(
        "mag-ellipsoid-axis",
        "Magnetometer offset and axis scales by an axis-aligned ellipsoid",
        "rotation in all directions, no cross terms",
        (INSTANCE, *_FIELD),
        mag_of(fit_ellipsoid_axis),
    ),
    Method(
        "mag-ellipsoid",
        "Magnetometer offset and symmetric matrix by orthogonal distance",
        "rotation in all directions",
        (
            INSTANCE,
            *_FIELD,
            Option("robust", ("auto", "yes", "no"), "auto", "withstand outliers"),
            Option(
                "prior_sd", float, None, "prior standard deviation of the soft iron, where the rotation covers little"
            ),
        ),
        mag_ellipsoid,
    ),
)
"""In the order of the command line."""
