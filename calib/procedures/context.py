"""Facts about the vehicle that a procedure has before the first sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.earth import EarthField
from mavcal.calib.recording import Identity, Sensor


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


@dataclass(frozen=True)
class OperatorAnswer:
    """An operator's answer: it came when the procedure's `time` (s, vehicle clock) was `t`."""

    t: float
    value: str
