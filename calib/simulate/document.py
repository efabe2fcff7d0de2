"""Sensor errors read from parameter files, and the truth of a simulation as JSON."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.calib.converter import make_converter
from mavcal.calib.errors import InvalidInputError, UnreadableError
from mavcal.calib.recording import Rounding, Sensor
from mavcal.calib.simulate.matlab import OBJECTS, suite_from_matlab
from mavcal.calib.simulate.motion import SegmentFacts, Warming
from mavcal.calib.simulate.recording import Frame, SensorSuite, Simulated, suite_in_frame
from mavcal.calib.simulate.sensor import SensorErrors
from mavcal.calib.simulate.sitl import from_sitl

_SENSORS = tuple(s.value for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
_CONVERTER = make_converter()
_TEXT_FORMS = (".param", ".parm", ".params")


@dataclass(frozen=True, eq=False)
class Stated:
    """What a file of parameters says: errors in the contract's axes, the temperature's course, and what it ignores."""

    suite: SensorSuite
    warming: Warming | None = None
    ignored: tuple[str, ...] = ()


def stated_in(text: str, suffix: str, *, frame: Frame = "ned", instance: int = 0, rate: float = 100.0) -> Stated:
    """Sensor errors from the text of a file.

    Parameters
    ----------
    text
        JSON with ``accel gyro mag`` and the fields of :class:`SensorErrors`, or with ``accelparams gyroparams
        magparams`` and MATLAB's properties; or lines ``SIM_ACC1_BIAS_X,0.1``.
    suffix
        Suffix of the file, which gives its format: ``.json``, else ``.param .parm .params``.
    frame
        Body axes of a JSON: forward-right-down for ned, forward-left-up for enu. ``SIM_*`` is forward-right-down.
    instance, rate
        Which of ``SIM_ACC1``, ``SIM_ACC2`` ... (from 0), and the rate of SITL's uniform noise.

    Raises
    ------
    UnreadableError
        If the text is not of that form.
    InvalidInputError
        If a number in it is impossible.
    """
    if suffix.lower() in _TEXT_FORMS:
        found = from_sitl(_parameters(text), instance=instance, rate=rate)
        return Stated(found.suite, found.warming, found.ignored)
    try:
        document = json.loads(text)
    except ValueError as error:
        raise UnreadableError(f"the parameters are neither JSON ({error}) nor a .param file") from error
    if not isinstance(document, Mapping) or not all(isinstance(v, Mapping) for v in document.values()):
        raise UnreadableError("the parameters are an object of objects: accel, gyro, mag, or accelparams and so on")
    if set(document) <= set(OBJECTS):
        return Stated(SensorSuite(**suite_from_matlab(document, frame=frame)))
    unknown = sorted(set(document) - set(_SENSORS))
    if unknown:
        raise InvalidInputError(
            f"{', '.join(unknown)} is no sensor: {', '.join(_SENSORS)}, or all of {', '.join(OBJECTS)}"
        )
    suite = SensorSuite(**{name: errors_from_json(fields) for name, fields in document.items()})
    return Stated(suite_in_frame(suite, frame))


def errors_from_json(fields: Mapping[str, Any]) -> SensorErrors:
    """Sensor errors from the fields of :class:`SensorErrors` by name; those left out are ideal.

    Raises
    ------
    InvalidInputError
        If a field is unknown or has an invalid value.
    """
    known = {f.name for f in dataclasses.fields(SensorErrors)}
    unknown = sorted(set(fields) - known)
    if unknown:
        raise InvalidInputError(f"a sensor has no {', '.join(unknown)}; it has {', '.join(sorted(known))}")
    given = {name: value for name, value in fields.items() if value is not None}
    try:
        if "rounding" in given:
            given["rounding"] = Rounding(given["rounding"])
        for name in ("t_ref", "thermal_lag", "full_scale", "resolution"):
            if name in given:
                given[name] = float(given[name])
        return SensorErrors(**given)
    except InvalidInputError:
        raise
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"a sensor's errors are numbers: {error}") from error


def errors_to_json(errors: SensorErrors) -> dict[str, Any]:
    """The fields by name; null where there is no range, and where flicker has no poles of its own."""
    document: dict[str, Any] = _CONVERTER.unstructure(errors)
    return document


def truth_to_json(made: Simulated, *, frame: Frame, **about: Any) -> dict[str, Any]:
    """What produced a recording, as JSON; `about` comes first.

    ``sensors`` holds the errors in the axes of `frame`, fit to be stated again; ``models`` their corrections as a fit
    should find them, forward-right-down whatever the frame; ``segments`` the true rate (rad/s, likewise) and the
    number of whole turns where a label has them.
    """
    suite = suite_in_frame(made.suite, frame)
    return {
        "schema": "simulation/1",
        **about,
        "frame": frame,
        "sensors": {s.value: errors_to_json(e) for s, e in suite.by_sensor.items()},
        "models": {s.value: _model(e) for s, e in made.suite.by_sensor.items()},
        "segments": [_segment(facts) for facts in made.trajectory.facts],
    }


def _model(errors: SensorErrors) -> dict[str, Any]:
    model = errors.correction
    polynomial = None
    if model.polynomial is not None:
        polynomial = {"t_ref": errors.t_ref, "coefficients": errors.temperature.tolist()}
    return {**_CONVERTER.unstructure(model), "polynomial": polynomial}


def _segment(facts: SegmentFacts) -> dict[str, Any]:
    data = _CONVERTER.unstructure(facts)
    return {**data.pop("segment"), **data}


def _parameters(text: str) -> dict[str, float]:
    """``NAME,VALUE`` or ``NAME VALUE`` a line, # before a comment; QGroundControl's five columns too."""
    values: dict[str, float] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        cells = line.partition("#")[0].replace(",", " ").split()
        if not cells:
            continue
        name, value = (cells[2], cells[3]) if len(cells) >= 5 and cells[0].isdecimal() else (cells[0], cells[-1])
        try:
            values[name] = float(value)
        except ValueError:
            raise UnreadableError(f"line {number} of the parameters is not NAME,VALUE: {line.strip()!r}") from None
        if len(cells) < 2 or not np.isfinite(values[name]):
            raise UnreadableError(f"line {number} of the parameters is not NAME,VALUE: {line.strip()!r}")
    return values
