"""A report as MATLAB's parameter objects, and as the document of ``mavcal simulate recording``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavcal.calib.gap.export.state import SensorEffects, named, sensors_with
from mavcal.calib.gap.schema import GapReport
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.document import errors_to_json
from mavcal.calib.simulate.matlab import OBJECTS, to_matlab

_T_REF = 25.0
"""Reference temperature of the exported curves, degC. Source: MATLAB's `imuSensor`, whose drifts vanish there."""
_MEASURED = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)


@dataclass(frozen=True)
class Document:
    """The text of a file, and what it cannot hold."""

    text: str
    not_held: tuple[str, ...]


def to_document(report: GapReport, *, instance: int = 1) -> Document:
    """JSON for ``mavcal simulate recording --params``: the sensors of `instance` (from 1) by name."""
    sensors = sensors_with(report.effects, t_ref=_T_REF)
    present = [s for s in _MEASURED if (s, instance) in sensors.errors]
    lost = [f"{named(e)}: the simulation has no such effect" for e in sensors.rest if instance in e.instances]
    if any(sensors.of(s, instance).thermal_lag for s in present):
        lost.append("a lag behind the thermometer is a lead of the die by the same time: to first order the same")
    document = {s.value: errors_to_json(sensors.of(s, instance)) for s in present}
    return Document(json.dumps(document, indent=2, allow_nan=False) + "\n", (*lost, *_others(report, instance)))


def to_matlab_text(report: GapReport, *, instance: int = 1) -> Document:
    """A script that makes an ``imuSensor`` (NED) of `instance` (from 1) with its parameter objects."""
    sensors = sensors_with(report.effects, t_ref=_T_REF)
    lines, lost = _objects(sensors, instance)
    lost += [f"{named(e)}: imuSensor has no such effect" for e in sensors.rest if instance in e.instances]
    lost += _others(report, instance)
    head = ["% mavcal: sim-to-real gap as parameters of imuSensor, reference frame NED"]
    head += [f"% not held: {text}".replace("\n", " ") for text in lost]
    found = [s for s in _MEASURED if (s, instance) in sensors.errors]
    kind = "accel-gyro-mag" if Sensor.MAG in found else "accel-gyro"
    make = [f"imu = imuSensor('{kind}', 'ReferenceFrame', 'NED');"] if found else []
    attach = [f"imu.{_PROPERTY[s]} = {s.value};" for s in found]
    return Document("\n".join([*head, *lines, *make, *attach]) + "\n", tuple(lost))


_CLASS = {sensor: name for name, sensor in OBJECTS.items()}
_PROPERTY = {Sensor.ACCEL: "Accelerometer", Sensor.GYRO: "Gyroscope", Sensor.MAG: "Magnetometer"}


def _objects(sensors: SensorEffects, instance: int) -> tuple[list[str], list[str]]:
    lines: list[str] = []
    lost: list[str] = []
    for sensor in _MEASURED:
        if (sensor, instance) not in sensors.errors:
            continue
        made = to_matlab(sensors.errors[sensor, instance], sensor)
        name = sensor.value
        lines.append(f"{name} = {_CLASS[sensor]};")
        lines += [f"{name}.{key} = {_literal(v)};" for key, v in made.values.items() if _wanted(key, made.values)]
        lost += [f"{sensor}: {text}" for text in made.not_held]
    return lines, lost


def _wanted(key: str, values: Mapping[str, Any]) -> bool:
    """Flicker's filter only with flicker."""
    return key != "BiasInstabilityCoefficients" or bool(np.any(values["BiasInstability"]))


def _literal(given: Any) -> str:
    if isinstance(given, str):
        return f"'{given}'"
    if isinstance(given, Mapping):
        return f"struct({', '.join(f'{_literal(k)}, {_literal(v)}' for k, v in given.items())})"
    if isinstance(given, Sequence):
        if given and isinstance(given[0], Sequence):
            return f"[{'; '.join(' '.join(_number(v) for v in row) for row in given)}]"
        return f"[{' '.join(_number(v) for v in given)}]"
    return _number(given)


def _number(given: float) -> str:
    return "Inf" if np.isposinf(given) else f"{given:.9g}"


def _others(report: GapReport, instance: int) -> list[str]:
    return [f"{named(e)}: this file is of instance {instance}" for e in report.effects if instance not in e.instances]
