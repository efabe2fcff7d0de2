"""Every method by its name: what the command line and the REST API run on a recording.

A method takes a :class:`~calib.recording.Recording` as it was read and options by name, undoes the calibration in
force where the recording is of a vehicle, and returns one fit a sensor instance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from calib import method_runs as runs
from calib.errors import InvalidInputError
from calib.fit import FitResult
from calib.mag.ellipsoid_axis import fit_ellipsoid_axis
from calib.mag.minmax import fit_minmax
from calib.mag.sphere import fit_sphere
from calib.method_source import Source
from calib.recording import Recording
from calib.six_face import CONVENTIONS

Options = Mapping[str, Any]


@dataclass(frozen=True)
class Option:
    """An option of a method. `type` is float, int or str, or a tuple of the texts that are allowed."""

    name: str
    type: Any
    default: Any
    help: str


@dataclass(frozen=True)
class Method:
    """A way to fit a sensor, with what it needs and the options that it takes."""

    name: str
    summary: str
    needs: str
    options: tuple[Option, ...]
    fit: Callable[[Source, Options], Sequence[FitResult]]

    def run(self, recording: Recording, options: Options = MappingProxyType({})) -> tuple[FitResult, ...]:
        """The fits of every instance (or of the option ``instance``) that the recording has.

        Raises
        ------
        InvalidInputError
            If an option is unknown or of a wrong type, or the recording lacks the sensor.
        """
        chosen = _checked(self, options)
        source = Source.of(recording, chosen["instance"])
        return tuple(source.annotated(fit) for fit in self.fit(source, chosen))


def _checked(method: Method, options: Options) -> dict[str, Any]:
    """Every option with its value, in its type.

    Raises
    ------
    InvalidInputError
        If one is unknown or does not have the type.
    """
    known = {option.name: option for option in method.options}
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise InvalidInputError(
            f"{method.name} has no option {', '.join(unknown)}; it takes {', '.join(sorted(known)) or 'none'}"
        )
    return {name: _converted(option, options.get(name)) for name, option in known.items()}


def _converted(option: Option, value: Any) -> Any:
    if value is None:
        return option.default
    if isinstance(option.type, tuple):
        if value not in option.type:
            raise InvalidInputError(f"{option.name} is one of {', '.join(option.type)}, not {value!r}")
        return value
    try:
        converted = option.type(value)
        whole = option.type is not int or isinstance(value, str) or converted == value
        finite = option.type is str or (whole and np.isfinite(float(converted)))
    except (TypeError, ValueError, OverflowError):
        converted, finite = None, False
    if not finite or isinstance(value, bool):
        form = "; a whole one" if option.type is int else ""
        raise InvalidInputError(f"{option.name} must be a number ({option.help}{form}), not {value!r}")
    return converted


_INSTANCE = Option("instance", int, None, "only this instance, from 0; else every one that is there")
_GRAVITY = Option("gravity", float, None, "length of gravity in the unit of the samples; 9.80665 m/s2 where not said")
_FIXTURE = Option("fixture_sd", float, 0.0, "tilt of the fixture, standard deviation in degrees")
_FIELD = (
    Option("year", float, None, "decimal year: ties the scale to the World Magnetic Model at the recorded place"),
    Option("field", float, None, "strength of the field in uT, where it is known: ties the scale to it"),
)

_ALL = (
    Method(
        "accel-one-axis",
        "Accelerometer offset with one axis vertical",
        "a rest with one axis vertical to a degree",
        (_INSTANCE, _GRAVITY, _FIXTURE),
        runs.accel_one_axis,
    ),
    Method(
        "accel-six-face",
        "Accelerometer offset and full matrix from six faces of a fixture",
        "every axis once up and once down, square on a fixture; labelled, still, or one row a face",
        (
            _INSTANCE,
            Option("gravity", float, None, "else 1 or the convention's (9.80665; accelcal 9.81), whichever is nearer"),
            Option("convention", CONVENTIONS, "specific-force", "accelcal: the axis that points down reads +g"),
            _FIXTURE,
            Option("samples", ("means", "all"), "means", "regress on face means, or on all samples as published"),
        ),
        runs.accel_six_face,
    ),
    Method(
        "accel-multi",
        "Accelerometer offset and matrix from still poses in any direction",
        "six faces and three oblique poses or more, each held still for two seconds",
        (
            _INSTANCE,
            _GRAVITY,
            Option("cross_sd", float, 0.01, "prior standard deviation of the cross terms; 0 holds them at zero"),
            Option("form", ("symmetric", "upper"), "symmetric", "canonical form of the matrix"),
        ),
        runs.accel_multi,
    ),
    Method("gyro-rest", "Gyroscope offset at rest", "five seconds at rest", (_INSTANCE,), runs.gyro_rest),
    Method(
        "mag-minmax",
        "Magnetometer offset and scale from the extremes",
        "every axis once along and once against the field; only a start for better methods",
        (_INSTANCE, *_FIELD),
        runs.mag_of(fit_minmax),
    ),
    Method(
        "mag-sphere",
        "Magnetometer offset by a sphere",
        "rotation about two axes or more, no soft iron",
        (_INSTANCE, *_FIELD),
        runs.mag_of(fit_sphere),
    ),
    Method(
        "mag-ellipsoid-axis",
        "Magnetometer offset and axis scales by an axis-aligned ellipsoid",
        "rotation in all directions, no cross terms",
        (_INSTANCE, *_FIELD),
        runs.mag_of(fit_ellipsoid_axis),
    ),
    Method(
        "mag-ellipsoid",
        "Magnetometer offset and symmetric matrix by orthogonal distance",
        "rotation in all directions",
        (
            _INSTANCE,
            *_FIELD,
            Option("robust", ("auto", "yes", "no"), "auto", "withstand outliers"),
            Option(
                "prior_sd", float, None, "prior standard deviation of the soft iron, where the rotation covers little"
            ),
        ),
        runs.mag_ellipsoid,
    ),
    Method(
        "thermal-linear",
        "Slope of accelerometer and gyroscope against temperature",
        "a motionless sensor whose temperature moves",
        (
            _INSTANCE,
            Option("tref", float, 25.0, "temperature at which nothing is corrected, degC; 0 is the published form"),
            Option("min_span", float, 2.0, "least range of temperature, degC"),
        ),
        runs.thermal_linear,
    ),
    Method(
        "thermal-poly",
        "Polynomial drift of accelerometer and gyroscope against temperature",
        "a motionless sensor that warms up by ten degrees or more",
        (
            _INSTANCE,
            Option("degree", int, 3, "of the polynomial, 1 to 5"),
            Option("tref", float, 35.0, "temperature at which the polynomial is zero, degC"),
            Option("min_span", float, 10.0, "least range of temperature, degC"),
        ),
        runs.thermal_poly,
    ),
)

METHODS: Mapping[str, Method] = MappingProxyType({method.name: method for method in _ALL})
"""Every method by its name."""
