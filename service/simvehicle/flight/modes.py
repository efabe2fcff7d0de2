"""Flight modes, setpoints of GUIDED, the interface of the log, and climb rates of take-off and landing.

Climb rates are in m/s upwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, IntEnum, auto
from typing import Any, Protocol

from mavcal.service.simvehicle.flight.items import Item
from mavcal.service.simvehicle.flight.parameters import FlightParameters

LOOP_HZ = 400
CLOSE_ENOUGH = 0.3
"""Distance below the requested height at which a take-off ends, m."""
_TAKEOFF_CLIMB = 2.0
_LANDING_FAST = 1.5
"""Descent above LAND_ALT_LOW, m/s."""


class Mode(IntEnum):
    """Flight modes by ArduCopter's numbers."""

    STABILIZE = 0
    AUTO = 3
    GUIDED = 4
    LAND = 9


class Guidance(Enum):
    """The setpoints of GUIDED."""

    HOLD = auto()
    TAKEOFF = auto()
    VELOCITY = auto()
    ATTITUDE = auto()


class Log(Protocol):
    """Receives the events of a vehicle for its log; times in us since boot."""

    def begin(self, vehicle: Any) -> None:
        """Log the boot."""

    def loop(self, vehicle: Any) -> None:
        """Log the messages due after a main loop."""

    def text(self, us: int, text: str) -> None:
        """Log a message in words."""

    def mode(self, us: int, number: int, reason: int) -> None:
        """Log a change of the flight mode."""

    def mission(self, us: int, items: Sequence[Item]) -> None:
        """Log an uploaded mission."""

    def parameter(self, us: int, name: str, value: float) -> None:
        """Log a parameter that was set."""

    def armed(self, us: int, *, armed: bool) -> None:
        """Log that the motors were armed or disarmed."""

    def close(self) -> None:
        """Close the log."""


def takeoff_climb(height: float, target: float) -> float:
    """Climb rate towards `target`; heights in m above the ground."""
    return min(_TAKEOFF_CLIMB, max(target - height, 0.0) + CLOSE_ENOUGH)


def landing_climb(height: float, parameters: FlightParameters) -> float:
    """Climb rate of a landing, slower below LAND_ALT_LOW."""
    low, slow = 0.01 * parameters["LAND_ALT_LOW"], 0.01 * parameters["LAND_SPEED"]
    return -(_LANDING_FAST if height > low else slow)
