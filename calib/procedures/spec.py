"""Specification of a procedure: its options, needs, goal, what it writes, and what it cannot represent.

The specifications are the one place of these facts: the service validates options with them, a panel shows them, and
``docs/procedures.md`` is generated from them (``scripts/procedures``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.storable import Storable
from mavcal.calib.option import Option
from mavcal.calib.recording import Sensor

OptionValue = float | bool
Options = Mapping[str, OptionValue]


@dataclass(frozen=True)
class ProcedureSpec:
    """A procedure as a row of the table that operators and programs read.

    `sensors` must stream, `helpful` are used where they stream. `still_only` of them tell rest from motion and nothing
    else, so their calibration may change meanwhile. `aiding` of them are in the result and are not calibrated
    themselves. `duration_s` is the typical length with the default options, in
    seconds of the vehicle's clock.
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
