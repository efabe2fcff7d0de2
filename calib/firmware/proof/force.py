"""The correction in force if only some of a plan's changes took effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final

import numpy as np

from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.firmware import names
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.names import Role
from mavcal.calib.firmware.plan import Change, Value
from mavcal.calib.firmware.proof.evidence import StillMean
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

_HIDDEN_DEFAULTS: Final = MappingProxyType(
    {
        "ardupilot": ((Role.THERMAL_MAX, 70.0), *((role, 1.0) for role in names.SCALE)),
        "px4": (
            (Role.THERMAL_MAX, 100.0),
            (Role.THERMAL_REF, 25.0),
            (Role.ROTATION, -1),
            (Role.PRIORITY, -1),
            *((role, 1.0) for role in names.SCALE),
        ),
    }
)
"""Nonzero defaults of parameters that the firmware does not list yet (FLIGHT_CONTROLLERS 1.1-1.4)."""
_INVERTIBLE: Final = 1e6
"""Largest condition number of a correction that is undone: beyond, one count would become a thousand fields."""


@dataclass(frozen=True)
class Force:
    """The corrections of one vehicle as a function of the changes that took effect.

    `parameters` is the vehicle with every change of the plan in it.
    """

    autopilot: str
    parameters: Mapping[str, Value]
    changes: tuple[Change, ...]

    def model(self, about: Subject, applied: Set[str]) -> TriadModel:
        """The correction of `about` with only `applied` (names) in effect and the old values elsewhere.

        PX4 keeps its calibration in a memory that a parameter may fail to reach. There the memory is made of old and
        new numbers directly, without asking whether a boot would take them.
        """
        mixed = self._mixed(applied)
        if self.autopilot == "ardupilot":
            return ardupilot.calibration_in_force(mixed, about.sensor, about.instance)
        return px4.calibration_in_force(mixed, about.sensor, about.instance, self._memory(about, applied))

    def motor(self, about: Subject, applied: Set[str], readings: Sequence[StillMean]) -> Array:
        """Motor compensation that the firmware adds to a compass at each reading, uT (K, 3)."""
        nothing = np.zeros((len(readings), 3))
        if self.autopilot != "ardupilot" or about.sensor != Sensor.MAG or not readings:
            return nothing
        throttle = _all_known([r.throttle for r in readings])
        current = _all_known([r.current for r in readings])
        term = ardupilot.motor_term(self._mixed(applied), about.instance, throttle, current)
        return nothing if term is None else term

    def acting(self, about: Subject) -> tuple[str, ...]:
        """Names of the changes that the correction of `about` depends on.

        A change counts as acting if it matters beside all others or alone. A coefficient matters only once its set is
        enabled, and the enabling only with coefficients.
        """
        every = frozenset(change.name for change in self.changes)
        whole, none = self.possible(about, every), self.possible(about, frozenset())
        motors = self._motor_names(about)
        return tuple(
            name
            for name in (change.name for change in self.changes)
            if name in motors
            or _differ(whole, self.possible(about, every - {name}))
            or _differ(none, self.possible(about, {name}))
        )

    def possible(self, about: Subject, applied: Set[str]) -> TriadModel | None:
        """:meth:`model`, or None where no vehicle corrects by that mixture of old and new values.

        A new TMIN with the old TMAX may leave an empty range. The scale of an absent sensor is 0, and so is the
        diagonal of a never calibrated compass. With one new element the matrix then has no inverse.
        """
        try:
            model = self.model(about, applied)
        except (FirmwareError, InvalidInputError):
            return None
        return model if np.linalg.cond(model.matrix) < _INVERTIBLE else None

    def why_impossible(self, about: Subject, applied: Set[str]) -> str:
        """Reason why :meth:`possible` is None, in words; empty if it is not."""
        try:
            model = self.model(about, applied)
        except (FirmwareError, InvalidInputError) as error:
            return str(error)
        invertible = np.linalg.cond(model.matrix) < _INVERTIBLE
        return "" if invertible else f"the correction of {about} has no inverse: a scale or a diagonal is zero"

    def without_alternative(self, about: Subject) -> frozenset[str]:
        """Names of the changes without a valid old value, which no stream can test."""
        every = frozenset(change.name for change in self.changes)
        return frozenset(
            name
            for name in every
            if self.possible(about, every - {name}) is None and self.possible(about, {name}) is None
        )

    def _motor_names(self, about: Subject) -> set[str]:
        if self.autopilot != "ardupilot" or about.sensor != Sensor.MAG:
            return set()
        roles = ardupilot.calibration_names(self.parameters, about.sensor, about.instance)
        return {roles[role] for role in names.MOTOR}

    def _mixed(self, applied: Set[str]) -> dict[str, Value]:
        values = dict(self.parameters)
        for change in self.changes:
            values[change.name] = change.new if change.name in applied else self._old[change.name]
        return values

    @cached_property
    def _old(self) -> dict[str, Value]:
        """The values before; the firmware's default where one was hidden."""
        return {c.name: self._default(c) if c.old is None else c.old for c in self.changes}

    def _default(self, change: Change) -> Value:
        if change.sensor is None or change.sensor not in CALIBRATED:
            return 0
        module = ardupilot if self.autopilot == "ardupilot" else px4
        roles = module.calibration_names(self.parameters, change.sensor, change.instance)
        defaults = {roles[role]: value for role, value in _HIDDEN_DEFAULTS[self.autopilot] if role in roles}
        return defaults.get(change.name, 0)

    def _memory(self, about: Subject, applied: Set[str]) -> px4.Px4Calibration:
        old = px4.Px4Calibration.load(self._mixed(frozenset()), about.sensor, about.instance)
        roles = px4.calibration_names(self.parameters, about.sensor, about.instance)
        new = {change.name: float(change.new) for change in self.changes if change.name in applied}

        def in_memory(held: Array, triple: names.Triple) -> Array:
            return np.array([new.get(roles.get(role, ""), held[i]) for i, role in enumerate(triple)])

        return px4.Px4Calibration(
            about.sensor,
            about.instance,
            offset=in_memory(old.offset, names.OFFSET),
            scale=in_memory(old.scale, names.SCALE),
            cross=in_memory(old.cross, names.CROSS),
        )


def force_of(autopilot: str, parameters: Mapping[str, Value], changes: tuple[Change, ...]) -> Force:
    """The corrections of a vehicle with `parameters` and a plan's `changes`.

    Raises
    ------
    FirmwareError
        If the autopilot is not known.
    """
    if autopilot not in _HIDDEN_DEFAULTS:
        raise FirmwareError(f"what {autopilot} does with its parameters is not known, so nothing of it can be checked")
    return Force(autopilot, {**parameters, **{c.name: c.new for c in changes}}, changes)


def _all_known(values: Sequence[float | None]) -> Array | None:
    known = [v for v in values if v is not None]
    return np.array(known) if len(known) == len(values) else None


def _differ(a: TriadModel | None, b: TriadModel | None) -> bool:
    """Whether two corrections differ anywhere in the narrower of their temperature ranges; None: it cannot be.

    Beyond it one of them is clamped while the sensor drifts on unknown, so no stream could tell them apart there.
    """
    if a is None or b is None:
        return False
    curves = [m.polynomial for m in (a, b) if m.polynomial is not None]
    if not curves or not np.array_equal(a.matrix, b.matrix):
        return not (np.array_equal(a.offset, b.offset) and np.array_equal(a.matrix, b.matrix))
    heat = np.linspace(max(c.t_min for c in curves), min(c.t_max for c in curves), 9)
    return not np.allclose(a.bias(heat), b.bias(heat), rtol=0.0, atol=1e-12)
