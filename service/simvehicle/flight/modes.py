"""Flight modes, what GUIDED follows, and what a vehicle tells its log."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, IntEnum, auto
from typing import Any, Protocol

from mavcal.service.simvehicle.flight.items import Item

LOOP_HZ = 400


class Mode(IntEnum):
    """Flight modes by ArduCopter's numbers."""

    STABILIZE = 0
    AUTO = 3
    GUIDED = 4
    LAND = 9


class Guidance(Enum):
    """What GUIDED follows."""

    HOLD = auto()
    TAKEOFF = auto()
    VELOCITY = auto()
    ATTITUDE = auto()


class Log(Protocol):
    """Takes what a vehicle has to say; times in us since boot."""

    def begin(self, vehicle: Any) -> None:
        """The vehicle has booted."""
        ...

    def loop(self, vehicle: Any) -> None:
        """A main loop is done."""
        ...

    def text(self, us: int, text: str) -> None:
        """A message in words."""
        ...

    def mode(self, us: int, number: int, reason: int) -> None:
        """The flight mode changed."""
        ...

    def mission(self, us: int, items: Sequence[Item]) -> None:
        """A mission was uploaded."""
        ...

    def parameter(self, us: int, name: str, value: float) -> None:
        """A parameter was set."""
        ...

    def armed(self, us: int, *, armed: bool) -> None:
        """The motors were armed or disarmed."""
        ...

    def close(self) -> None:
        """The log ends."""
        ...
