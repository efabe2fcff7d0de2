"""Specification of a procedure, and what it knows of the vehicle before the first sample.

A specification has its options, needs, goal, what it writes, and what it cannot represent. It is the single source: the
service validates options with it, a panel shows it, and ``scripts/procedures`` makes ``docs/procedures.md``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from mavcal.calib import STANDARD_GRAVITY, firmware
from mavcal.calib.earth import EarthField
from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.firmware.storable import Storable
from mavcal.calib.option import Option
from mavcal.calib.recording import Array, Identity, Sensor
from mavcal.calib.triad import TriadModel

OptionValue = float | bool
Options = Mapping[str, OptionValue]


@dataclass(frozen=True)
class ProcedureSpec:
    """A procedure as a row of the table that operators and programs read.

    `sensors` must stream; `helpful` ones are used if they stream. Those in `still_only` only tell rest from motion, so
    their calibration may change meanwhile. Those in `aiding` affect the result without being calibrated. `duration_s`
    is the typical length with the default options, in seconds of the vehicle's clock.
    """

    kind: str
    title: str
    sensors: tuple[Sensor, ...]
    helpful: tuple[Sensor, ...]
    options: tuple[Option, ...]
    needs: str
    ends_on: str
    autopilots: Mapping[str, Storable]
    duration_s: float
    aliases: tuple[str, ...] = dataclasses.field(default=())
    still_only: tuple[Sensor, ...] = ()
    aiding: tuple[Sensor, ...] = ()

    @property
    def measured(self) -> frozenset[Sensor]:
        """The sensors whose readings are in the result."""
        return frozenset(self.sensors) - frozenset(self.still_only)

    @property
    def calibrated(self) -> frozenset[Sensor]:
        """The sensors that the result is about."""
        return self.measured - frozenset(self.aiding)

    def validated(self, options: Mapping[str, Any]) -> Options:
        """Every option of this procedure, defaults filled in.

        Raises
        ------
        InvalidInputError
            If a name is unknown or a value is out of its limits.
        """
        known = {option.name: option for option in self.options}
        unknown = sorted(set(options) - set(known))
        if unknown:
            names = ", ".join(known) or "none"
            raise InvalidInputError(f"{self.kind} has no option {', '.join(unknown)}; its options are: {names}")
        return MappingProxyType({n: o.check(options.get(n, o.default)) for n, o in known.items()})


@dataclass(frozen=True)
class ProcedureContext:
    """The vehicle, its parameters and its place.

    Parameters
    ----------
    identity
        Whose data they are.
    instances
        The instances of each sensor that are expected to stream. A sensor without an entry: those that are seen in
        the first seconds.
    earth_field
        Magnetic model at the vehicle's place and date. None: not known, and the field strength is not judged.
    parameters
        Parameters in force during the capture. Empty: unknown, and every fit is marked `relative`.
    gravity
        Length of the specific force at rest that the fits refer to, m/s2.
    """

    identity: Identity = field(default_factory=Identity)
    instances: Mapping[Sensor, tuple[int, ...]] = field(default_factory=lambda: MappingProxyType({}))
    earth_field: EarthField | None = None
    parameters: Mapping[str, float | int] = field(default_factory=lambda: MappingProxyType({}))
    gravity: float = STANDARD_GRAVITY

    @property
    def relative(self) -> bool:
        """Whether the calibration in force is unknown, so that absolute values cannot be stated."""
        return not self.parameters

    def in_force(self, sensor: Sensor, instance: int) -> TriadModel | None:
        """Correction in force, from raw sensor frame to corrected body frame; None: its parameters are missing.

        Without parameters, or of an unknown autopilot, raw and corrected are taken as the same.
        """
        if not self._mounting_is_stated:
            return TriadModel()
        try:
            return firmware.calibration_in_force(self.identity.autopilot, self.parameters, sensor, instance)
        except FirmwareError:
            return None

    def body_from_sensor(self, sensor: Sensor, instance: int) -> Array:
        """Rotation (3, 3) from the raw frame of a sensor to the body; the identity where parameters are missing."""
        if not self._mounting_is_stated:
            return np.eye(3)
        try:
            return firmware.body_from_sensor(self.identity.autopilot, self.parameters, sensor, instance)
        except FirmwareError:
            return np.eye(3)

    @property
    def _mounting_is_stated(self) -> bool:
        return not self.relative and self.identity.autopilot in firmware.TITLES


@dataclass(frozen=True)
class OperatorAnswer:
    """An operator's answer: it came when the procedure's `time` (s, vehicle clock) was `t`."""

    t: float
    value: str
