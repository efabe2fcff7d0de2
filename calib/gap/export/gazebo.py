"""A report as SDF of Gazebo: noise of sensors (FLIGHT_CONTROLLERS 7.2), motor model and inertia (AIRFRAME 4.3).

Gazebo's axes are forward-left-up. A constant error goes into ``mean``: the sign of ``bias_mean`` is drawn again at
every start. A random walk of coefficient K becomes the slow part of a Gauss-Markov process: ``sigma^2 = K^2 tau / 2``.

A flight does not say what the model's own motors are. Their values are the plugin's defaults with the effects; a
comment beside each says what to do with another model's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.effects.traits import SensorTerm
from mavcal.calib.gap.export.airframe.patch import airframe_effects
from mavcal.calib.gap.export.airframe.wanted import Wanted, missing, wanted_of
from mavcal.calib.gap.export.sensor_errors import named, sensors_with, term_of
from mavcal.calib.gap.schema import EffectEstimate, GapReport
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.recording import FLU_FROM_FRD
from mavcal.calib.simulate.sensor import SensorErrors

Array = NDArray[np.float64]

RATES: Mapping[Sensor, float] = {Sensor.ACCEL: 250.0, Sensor.GYRO: 250.0, Sensor.MAG: 100.0}
"""Sampling rates, Hz, of PX4's models, which convert a density to the standard deviation of a sample. Source: their
SDF; FLIGHT_CONTROLLERS 7.2 has that of the inertial unit."""
TESLA = 1e-6
"""Tesla in a microtesla. Source: definition."""
WALK_TIME = 1000.0
"""Correlation time, s, that approximates an unbounded walk. Chosen, not measured: longer than most flights."""
_HELD = frozenset({SensorTerm.BIAS, SensorTerm.HARD_IRON, SensorTerm.WHITE_NOISE, SensorTerm.RANDOM_WALK})
_TAGS = {
    Sensor.ACCEL: ("imu", "linear_acceleration"),
    Sensor.GYRO: ("imu", "angular_velocity"),
    Sensor.MAG: ("magnetometer", None),
}
DEFAULTS: Mapping[str, float] = {
    "motorConstant": 8.54858e-06,
    "momentConstant": 0.016,
    "rotorDragCoefficient": 1e-4,
    "timeConstantUp": 0.0125,
    "timeConstantDown": 0.025,
}
"""Motor model. Source: gz-sim's MulticopterMotorModel.cc."""
REASONS: Mapping[str, str] = {
    "thrust_expo": "Gazebo's thrust goes with the square of the speed, and the bridge makes the speed of the command",
    "actuator_delay": "Gazebo has no delay between a command and its thrust",
    "body_drag": "Gazebo's motor model has no drag of the body",
    "inflow": "Gazebo's motor model has no inflow",
    "translational_lift": "Gazebo's motor model has no translational lift",
    "angular_damping": "Gazebo's damping is that of the rotors moving with their arms: it follows their drag",
    "torque_bias": "Gazebo has no constant torque",
    "battery_sag": "Gazebo's battery does not touch the thrust",
    "payload_step": "Gazebo's links keep their mass",
}
"""Why the simulator cannot represent an effect. Source: AIRFRAME 4.3."""
_PLUGIN = '<plugin filename="gz-sim-multicopter-motor-model-system" name="gz::sim::systems::MulticopterMotorModel">'


def to_sdf(report: GapReport, *, instance: int = 1) -> tuple[str, tuple[str, ...]]:
    """Noise elements for the sensors of `instance` (from 1), and what they cannot hold."""
    chosen = tuple(e for e in report.effects if instance in e.instances)
    held = tuple(e for e in chosen if term_of(e) in _HELD)
    sensors = sensors_with(held)
    lost = [f"{named(e)}: Gazebo's sensors have additive noise and offsets only" for e in chosen if e not in held]
    lost += [f"{named(e)}: this file is of instance {instance}" for e in report.effects if instance not in e.instances]
    present = {s: sensors.errors[s, instance] for s in _TAGS if (s, instance) in sensors.errors}
    blocks = []
    imu = [_group(tag, present[s], s) for s, (parent, tag) in _TAGS.items() if parent == "imu" and s in present and tag]
    if imu:
        blocks.append(_wrapped("imu", imu))
    if Sensor.MAG in present:
        blocks.append(_wrapped("magnetometer", _axes(present[Sensor.MAG], Sensor.MAG)))
    notes = [f"  <!-- not held: {_commented(text)} -->" for text in lost]
    rates = ", ".join(f"{s.value} {RATES[s]:g} Hz" for s in present)
    head = "<!-- mavcal: sim-to-real gap as sensor noise; axes forward-left-up, SI units and tesla"
    return "\n".join([f"{head}; at {rates or 'any rate'} -->", *notes, *blocks]) + "\n", tuple(lost)


def noise_of(errors: SensorErrors, sensor: Sensor, axis: int) -> dict[str, float]:
    """The values of one ``<noise>`` element: `axis` 0..2 of `errors`, in SDF's units and axes."""
    unit = TESLA if sensor == Sensor.MAG else 1.0
    turned = FLU_FROM_FRD @ errors.bias
    found = {
        "mean": float(turned[axis]) * unit,
        "stddev": float(errors.noise_density[axis] * np.sqrt(RATES[sensor])) * unit,
    }
    if errors.random_walk[axis] > 0.0:
        found["dynamic_bias_stddev"] = float(errors.random_walk[axis] * np.sqrt(0.5 * WALK_TIME)) * unit
        found["dynamic_bias_correlation_time"] = WALK_TIME
    return found


def _axes(errors: SensorErrors, sensor: Sensor) -> list[str]:
    lines = []
    for axis, name in enumerate("xyz"):
        values = noise_of(errors, sensor, axis)
        if not all(np.isfinite(v) for v in values.values()):
            raise InvalidInputError(f"noise of the {sensor} is not finite on its {name} axis")
        inner = "".join(f"<{key}>{v:.9g}</{key}>" for key, v in values.items())
        lines.append(f'<{name}><noise type="gaussian">{inner}</noise></{name}>')
    return lines


def _group(tag: str, errors: SensorErrors, sensor: Sensor) -> str:
    inner = "\n".join(f"      {line}" for line in _axes(errors, sensor))
    return f"<{tag}>\n{inner}\n    </{tag}>"


def _wrapped(parent: str, lines: list[str]) -> str:
    inner = "\n".join(f"    {line}" for line in lines)
    name = "imu_sensor" if parent == "imu" else "magnetometer_sensor"
    return f'<sensor name="{name}" type="{parent}">\n  <{parent}>\n{inner}\n  </{parent}>\n</sensor>'


def _commented(text: str) -> str:
    return text.replace("--", "- -")


def airframe_sdf(effects: Sequence[EffectEstimate], *, mass: float | None = None) -> tuple[str, tuple[str, ...]]:
    """Motor model and inertial elements with the airframe's effects, and what they cannot hold; `mass` in kg."""
    chosen = airframe_effects(effects)
    wanted = wanted_of(chosen)
    lost = [*missing(chosen, REASONS), *wanted.refused]
    if wanted.slew is not None:
        lost.append("motor_lag: Gazebo's motors have time constants and no limit of the rate")
    lines = _motor_model(wanted, lost)
    blocks = [_block(lines, None)] if lines else []
    blocks += [_block([_times("motorConstant", wanted.thrust * r)], n) for n, r in sorted(wanted.weak.items())]
    inertial = _inertial(wanted, mass)
    if inertial:
        blocks.append("\n".join(["<inertial>", *(f"  {line}" for line in inertial), "</inertial>"]))
    head = "<!-- mavcal: airframe; values are the plugin's defaults with the effects, axes forward-left-up -->"
    notes = [f"<!-- not held: {_commented(text)} -->" for text in lost]
    return "\n".join([head, *notes, *blocks]) + "\n", tuple(lost)


def _motor_model(wanted: Wanted, lost: list[str]) -> list[str]:
    """Motor model elements; hover speed falls with the root of the thrust constant, and rotor drag with that speed."""
    lines = []
    if wanted.thrust != 1.0:
        lines.append(_times("motorConstant", wanted.thrust))
    if wanted.yaw != 1.0:
        lines.append(_times("momentConstant", wanted.yaw))
    drag = wanted.rotor_drag * math.sqrt(wanted.thrust)
    if drag != 1.0:
        lines.append(_times("rotorDragCoefficient", drag))
    for name, added in zip(("timeConstantUp", "timeConstantDown"), wanted.lag or (), strict=False):
        value = DEFAULTS[name] + added
        if value < 0.0:
            lost.append(f"motor_lag: {name} would be {value:.3g} s; it stays at 0 or more")
        lines.append(f"{_element(name, max(0.0, value))} <!-- {added:+.4g} s to the model's own -->")
    return lines


def _inertial(wanted: Wanted, mass: float | None) -> list[str]:
    lines = []
    if mass is not None:
        lines.append(_element("mass", mass))
        lines.append(
            f"<!-- motorConstant, rotorDragCoefficient and inertia times {mass:.6g} over the model's own mass -->"
        )
    if wanted.inertia != (1.0, 1.0, 1.0):
        said = ", ".join(f"{n} times {r:.5g}" for n, r in zip(("ixx", "iyy", "izz"), wanted.inertia, strict=True))
        lines.append(f"<!-- inertia: {said} -->")
    signed = (-wanted.products[0], -wanted.products[1], wanted.products[2])  # forward-left-up
    for name, moment, added in zip(("ixy", "ixz", "iyz"), ("iyy", "izz", "izz"), signed, strict=True):
        if added:
            lines.append(f"<!-- inertia: {name} {added:+.5g} times {moment} to the model's own -->")
    if any(wanted.cg):
        ahead, right = wanted.cg
        lines.append(f"<!-- pose: x {ahead:+.5g}, y {-right:+.5g} times the longest arm to the model's own -->")
    return lines


def _times(name: str, ratio: float) -> str:
    return f"{_element(name, DEFAULTS[name] * ratio)} <!-- the model's own times {ratio:.5g} -->"


def _element(name: str, value: float) -> str:
    return f"<{name}>{value:.6g}</{name}>"


def _block(lines: Sequence[str], motor: int | None) -> str:
    about = [] if motor is None else [f"{_element('motorNumber', motor - 1)} <!-- motor {motor} -->"]
    return "\n".join([_PLUGIN, *(f"  {line}" for line in (*about, *lines)), "</plugin>"])
