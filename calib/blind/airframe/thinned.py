"""Logs that cannot show an effect: too slow, full of gaps, or without a message that it takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from mavcal.calib.blind.airframe.logs import Columns
from mavcal.calib.blind.airframe.sides import Rng

Thin = Callable[[Columns, Rng], Columns]


@dataclass(frozen=True)
class Thinning:
    """How a log is thinned, and the effects that it cannot show any more."""

    thin: Thin
    hides: tuple[str, ...]


TORQUES = ("motor_lag", "actuator_delay", "inertia", "yaw_coefficient", "angular_damping")
"""Effects that take commands and rates of 100 Hz. Source: AIRFRAME 5.8."""


def _every(columns: Columns, prefixes: tuple[str, ...], hz: float) -> Columns:
    """Only samples at that rate, of the columns that begin so."""
    t = columns["t"]
    keep = np.diff(np.floor((t - t[0]) * hz + 1e-6), prepend=-1.0) > 0.0
    return {
        name: np.where(keep, values, np.nan) if name.startswith(prefixes) else values
        for name, values in columns.items()
    }


def commands_10_hz(columns: Columns, rng: Rng) -> Columns:
    """As RCOU of ArduPilot is logged."""
    return _every(columns, ("motor_",), 10.0)


def imu_25_hz(columns: Columns, rng: Rng) -> Columns:
    """As ArduPilot logs the inertial unit by default."""
    return _every(columns, ("accel", "gyro"), 25.0)


def gaps(columns: Columns, rng: Rng) -> Columns:
    """A card that cannot keep up: never more than a third of a second in one piece."""
    t = columns["t"]
    keep = np.zeros(len(t), dtype=bool)
    now = float(t[0])
    while now < t[-1]:
        until = now + rng.uniform(0.1, 0.3)
        keep |= (t >= now) & (t < until)
        now = until + rng.uniform(0.3, 1.0)
    return {name: values[keep] for name, values in columns.items()}


def no_battery(columns: Columns, rng: Rng) -> Columns:
    """No power module."""
    return {name: values for name, values in columns.items() if name not in {"voltage", "current"}}


def no_velocity(columns: Columns, rng: Rng) -> Columns:
    """Flown indoors, without an estimate of the velocity."""
    return {name: values for name, values in columns.items() if not name.startswith("vel_")}


THINNINGS: Mapping[str, Thinning] = {
    "commands_10_hz": Thinning(commands_10_hz, TORQUES),
    "imu_25_hz": Thinning(imu_25_hz, TORQUES),
    "gaps": Thinning(gaps, TORQUES),
    "no_battery": Thinning(no_battery, ("battery_sag",)),
    "no_velocity": Thinning(no_velocity, ("rotor_drag", "body_drag", "inflow", "translational_lift")),
}
