"""A report as sensor noise of Gazebo's SDF, as PX4's models have it (FLIGHT_CONTROLLERS 7.2).

Gazebo's axes are forward-left-up. A constant error goes into ``mean``: the sign of ``bias_mean`` is drawn again at
every start. A random walk of coefficient K becomes the slow part of a Gauss-Markov process: ``sigma^2 = K^2 tau / 2``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.gap.effects.traits import SensorTerm
from mavcal.calib.gap.export.state import named, sensors_with, term_of
from mavcal.calib.gap.schema import GapReport
from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.recording import FLU_FROM_FRD
from mavcal.calib.simulate.sensor import SensorErrors

Array = NDArray[np.float64]

RATES: Mapping[Sensor, float] = {Sensor.ACCEL: 250.0, Sensor.GYRO: 250.0, Sensor.MAG: 100.0}
"""Hz, of PX4's models, at which a density becomes the standard deviation of a sample. Source: their SDF;
FLIGHT_CONTROLLERS 7.2 has that of the inertial unit."""
TESLA = 1e-6
"""Tesla in a microtesla. Source: definition."""
WALK_TIME = 1000.0
"""Correlation time, s, that stands for a walk without end. Chosen, not measured: longer than most flights."""
_HELD = frozenset({SensorTerm.BIAS, SensorTerm.HARD_IRON, SensorTerm.WHITE_NOISE, SensorTerm.RANDOM_WALK})
_TAGS = {
    Sensor.ACCEL: ("imu", "linear_acceleration"),
    Sensor.GYRO: ("imu", "angular_velocity"),
    Sensor.MAG: ("magnetometer", None),
}


@dataclass(frozen=True)
class SdfSnippet:
    """The ``<sensor>`` elements, and what they cannot hold."""

    text: str
    not_held: tuple[str, ...]


def to_sdf(report: GapReport, *, instance: int = 1) -> SdfSnippet:
    """Noise elements for the sensors of `instance` (from 1)."""
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
    return SdfSnippet("\n".join([f"{head}; at {rates or 'any rate'} -->", *notes, *blocks]) + "\n", tuple(lost))


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
