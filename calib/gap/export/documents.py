"""A report for MATLAB, and as the document of ``mavcal simulate recording``.

MATLAB gets sensors as parameter objects of ``imuSensor``, and the airframe as a struct for the user's model
(``idnlgrey``, the Multirotor block): AIRFRAME 4.4.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mavcal.calib.gap.export.airframe.patch import airframe_effects
from mavcal.calib.gap.export.airframe.wanted import ratio_of
from mavcal.calib.gap.export.sensor_errors import SensorEffects, named, sensors_with
from mavcal.calib.gap.schema import EffectEstimate, GapReport, ParameterEstimate
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.document import errors_to_json
from mavcal.calib.simulate.matlab import OBJECTS, to_matlab

_T_REF = 25.0
"""Reference temperature of the exported curves, degC. Source: MATLAB's `imuSensor`, whose drifts vanish there."""
_MEASURED = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)
_FIELDS: tuple[tuple[str, str, tuple[str, ...], str], ...] = (
    ("I", "inertia", ("x", "y", "z"), "kg m2, which a flight alone does not tell"),
    ("I_p", "inertia", ("xy", "xz", "yz"), "1, products of inertia over the moment of the second axis"),
    ("k", "thrust_scale", ("s",), "m/s2, thrust at full command over mass"),
    ("e", "thrust_expo", ("expo",), "thrust (1-e) c + e c^2 of the command c"),
    ("tau", "motor_lag", ("tau_up", "tau_down"), "s, up and down"),
    ("delay", "actuator_delay", ("delay",), "s"),
    ("c1", "rotor_drag", ("c1",), "1/s, at hover"),
    ("c2", "body_drag", ("c2",), "1/m"),
    ("kappa", "yaw_coefficient", ("s",), "m, yaw torque over thrust, which a flight alone does not tell"),
    ("r_cg", "cg_offset", ("x", "y"), "arms, forward and right"),
)
"""Name of the field, effect, parameters, unit."""
_RATIO_ONLY = frozenset({"inertia", "yaw_coefficient"})
"""Effects whose values in the flights are accelerations: only their ratio applies to the field."""
_HELD = frozenset(effect_id for _, effect_id, _, _ in _FIELDS)


def to_document(report: GapReport, *, instance: int = 1) -> tuple[str, tuple[str, ...]]:
    """JSON for ``mavcal simulate recording --params``, the sensors of `instance` (from 1), and what it cannot hold."""
    sensors = sensors_with(report.effects, t_ref=_T_REF)
    present = [s for s in _MEASURED if (s, instance) in sensors.errors]
    lost = [f"{named(e)}: the simulation has no such effect" for e in sensors.rest if instance in e.instances]
    if any(sensors.of(s, instance).thermal_lag for s in present):
        lost.append("a lag behind the thermometer is a lead of the die by the same time: to first order the same")
    document = {s.value: errors_to_json(sensors.of(s, instance)) for s in present}
    return json.dumps(document, indent=2, allow_nan=False) + "\n", (*lost, *_others(report, instance))


def to_matlab_text(report: GapReport, *, instance: int = 1) -> tuple[str, tuple[str, ...]]:
    """A script that makes an ``imuSensor`` (NED) of `instance` (from 1), and what it cannot hold."""
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
    return "\n".join([*head, *lines, *make, *attach]) + "\n", tuple(lost)


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
    """Whether a line is needed: the flicker filter only with flicker."""
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


def airframe_struct(effects: Sequence[EffectEstimate], *, mass: float | None = None) -> tuple[str, tuple[str, ...]]:
    """Lines for the struct ``airframe``, and notes on what it cannot represent, which also precede the lines.

    Both are empty without effects. A field holds the real vehicle's value, empty where the report has none.
    ``airframe.ratio`` and ``airframe.difference`` hold the comparison with the simulator.
    """
    flying = airframe_effects(effects)
    chosen = {e.id: e for e in flying}
    if not chosen:
        return "", ()
    lines = [
        "% The real airframe; [] where it is the simulator's or not known. Ratios are real by simulated.",
        f"airframe = struct('m', {'[]' if mass is None else f'{mass:.9g}'}); % kg",
    ]
    for name, effect_id, wanted, unit in _FIELDS:
        effect = chosen.get(effect_id)
        params = [] if effect is None else [_parameter(effect, w) for w in wanted]
        real = [None if p is None or effect_id in _RATIO_ONLY else p.value_real for p in params]
        lines.append(f"airframe.{name} = {_values(real)}; % {unit}")
        if any(p is not None and p.ratio is not None for p in params):
            ratios = _values([1.0 if p is None else ratio_of(p) for p in params])
            lines.append(f"airframe.ratio.{name} = {ratios};")
        elif any(p is not None for p in params):
            lines.append(f"airframe.difference.{name} = {_values([0.0 if p is None else p.value for p in params])};")
    lost = tuple(f"{named(e)}: the struct has no field for it" for e in flying if e.id not in _HELD)
    notes = [f"% not held: {text}".replace("\n", " ") for text in lost]
    return "".join(f"{line}\n" for line in (*notes, *lines)), lost


def _parameter(effect: EffectEstimate, name: str) -> ParameterEstimate | None:
    """The parameter of that name; a lag estimated for one direction applies to both."""
    either = [p for p in effect.params if p.name.startswith("tau")]
    return next((p for p in effect.params if p.name == name), either[0] if name.startswith("tau") and either else None)


def _values(values: Sequence[float | None]) -> str:
    known = [v for v in values if v is not None]
    return f"[{' '.join(f'{v:.9g}' for v in known)}]" if values and len(known) == len(values) else "[]"
