"""Effects without a name: shapes over the covariates of a flight, delayed commands, slow forces (AIRFRAME 5.9).

Each group competes like any other effect. Its columns are linear, of unit size, and act on one axis of force or torque.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.flown import FlownFlight
from mavcal.calib.airframe.geometry import arms

Array = NDArray[np.float64]

SLOW_COSINES: Final = 6
"""Most half waves of a slow force over a flight. Chosen, not measured: in 110 s, periods of 37 s and more."""
DELAYS_S: Final = (0.02, 0.05, 0.09, 0.14, 0.2)
"""Delays, s, of the taps of a filter on the commands. Source: AIRFRAME 5.9, 0 to 0.2 s."""
_HEIGHTS_M: Final = (1.0, 3.0)
_FORCE, _TORQUE = 0, 3


@dataclass(frozen=True)
class Group:
    """One nameless effect: its text in a report, and whether the weather rather than the vehicle causes it.

    `of_air`: always; `of_gusts`: in rougher air than the simulator's, since gusts also turn a vehicle. `own` groups are
    functions of time, without meaning in another flight.
    """

    id: str
    text: str
    own: bool = False
    of_air: bool = False
    of_gusts: bool = False


GROUPS: Final[tuple[Group, ...]] = (
    Group("slow_force_world", "a force that changes slowly in world axes", own=True, of_air=True),
    Group("slow_force_body", "a force that changes slowly in body axes", own=True),
    Group("slow_torque", "a torque that changes slowly", own=True, of_gusts=True),
    Group("command_force", "thrust that follows earlier commands"),
    Group("command_torque", "torque that follows earlier commands"),
    Group("speed_force", "a force by speed and its direction"),
    Group("height_force", "a force near the ground"),
    Group("time_thrust", "thrust that changes with time", own=True),
    Group("rate_torque", "torque by the square of the rates"),
    Group("curve", "a thrust curve of the third degree"),
)


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a group: (N,) on one axis of force (0 to 2) or torque (3 to 5), or (N, 3) on all three of force."""

    group: str
    axis: int
    values: Array

    def spread(self) -> Array:
        """The column on all axes of force and torque (N, 6)."""
        out = np.zeros((len(self.values), 6))
        out[:, slice(0, 3) if self.values.ndim == 2 else slice(self.axis, self.axis + 1)] = (
            self.values if self.values.ndim == 2 else self.values[:, None]
        )
        return out


def columns_of(flight: FlownFlight, air: Array, body: Array, *, torque: bool) -> tuple[Column, ...]:
    """Every column for a flight, each of unit size over its usable rows.

    Parameters
    ----------
    flight
        The flight.
    air
        Velocity through the air in body axes (N, 3), m/s.
    body
        Rotations (N, 3, 3) that take local vectors to body axes.
    torque
        Whether torque is judged.
    """
    made = [*_slow(flight, body), *_commanded(flight), *_of_speed(air), *_of_height(flight), *_in_time(flight)]
    kept = [c for c in made if torque or c.axis < _TORQUE]
    return tuple(Column(c.group, c.axis, c.values / size) for c in kept if (size := _size(flight, c.values)) > 0.0)


def _size(flight: FlownFlight, values: Array) -> float:
    return float(np.sqrt(np.mean(values[flight.usable].reshape(flight.usable.sum(), -1) ** 2)))


def _slow(flight: FlownFlight, body: Array) -> Iterator[Column]:
    n = len(flight.t)
    waves = [np.cos(np.pi * (np.arange(n) + 0.5) * k / n) for k in range(1, SLOW_COSINES + 1)]
    for wave in waves:
        for axis in range(3):
            yield Column("slow_force_body", axis, wave)
            yield Column("slow_torque", _TORQUE + axis, wave)
        for way in range(2):
            yield Column("slow_force_world", 0, wave[:, None] * body[:, :, way])


def _commanded(flight: FlownFlight) -> Iterator[Column]:
    x, y, spin = arms(flight.geometry.motors)
    ways = {2: np.ones(len(x)), 3: -y, 4: x, 5: spin}
    for axis, of_axis in ways.items():
        told = flight.c @ of_axis / len(x)
        change = np.gradient(told) * flight.fs
        named = np.column_stack([told, change, np.gradient(change) * flight.fs])
        for delay in DELAYS_S:
            steps = round(delay * flight.fs)
            earlier = told[np.clip(np.arange(len(told)) - steps, 0, None)]
            beyond = _beyond(earlier, named, flight.usable)
            yield Column("command_force" if axis == 2 else "command_torque", axis, beyond)
    mean = flight.c.mean(axis=1)
    yield Column("curve", 2, (mean - np.median(mean)) ** 3)


def _beyond(values: Array, named: Array, rows: NDArray[np.bool_]) -> Array:
    """`values` (N,) orthogonal to gain, lag and delay, which a nameless term would otherwise absorb.

    Source: GAP 1, the discrepancy is orthogonal to the catalogue (Plumlee).
    """
    amount, *_ = np.linalg.lstsq(named[rows], values[rows], rcond=None)
    return np.asarray(values - named @ amount)


def _of_speed(air: Array) -> Iterator[Column]:
    level = np.hypot(air[:, 0], air[:, 1])
    for axis, values in (
        (0, air[:, 1]), (1, air[:, 0]), (0, level * air[:, 0]), (1, level * air[:, 1]), (1, air[:, 1]), (2, level),
        (0, air[:, 2] * air[:, 0]), (1, air[:, 2] * air[:, 1]), (2, air[:, 2] * level), (2, level**3),
    ):  # fmt: skip
        yield Column("speed_force", axis, values)


def _of_height(flight: FlownFlight) -> Iterator[Column]:
    if np.isfinite(flight.height).all():
        for scale in _HEIGHTS_M:
            yield Column("height_force", 2, np.exp(-np.maximum(flight.height, 0.0) / scale))


def _in_time(flight: FlownFlight) -> Iterator[Column]:
    lift = flight.c.mean(axis=1)
    span = np.linspace(-1.0, 1.0, len(lift))
    for shape in (span, span**2 - 1.0 / 3.0):
        yield Column("time_thrust", 2, lift * shape)
    for axis in range(3):
        rate = flight.rate[:, axis]
        yield Column("rate_torque", _TORQUE + axis, rate * np.abs(rate))


def names_of(columns: tuple[Column, ...]) -> tuple[str, ...]:
    """Names of the parameters, one a column."""
    count: dict[str, int] = {}
    names = []
    for column in columns:
        count[column.group] = count.get(column.group, 0) + 1
        names.append(f"{PREFIX}{column.group}:{count[column.group]}")
    return tuple(names)


PREFIX: Final = "free_"
"""Prefix of the parameter names in :class:`calib.airframe.physics.Layout`."""
SIZES: Final[Mapping[str, float]] = {"force": 0.15, "torque": 0.5}
"""Prior standard deviation of a column of unit size, m/s2 and rad/s2. Source: gusts of 0.1 to 1 m/s2 (AIRFRAME 2)."""
