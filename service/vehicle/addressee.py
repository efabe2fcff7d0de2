"""The interface of a vehicle that an exchange of messages needs."""

from __future__ import annotations

from typing import Protocol

from mavcal.calib.wire.codec import Message, RawMessage
from mavcal.service.link.types import OwnIdentity
from mavcal.service.vehicle.state import VehicleState
from mavcal.service.vehicle.waits import Waits


class Addressee(Protocol):
    """A vehicle that messages can be sent to, with its pending answers and its state."""

    system: int
    """Its system id."""

    component: int
    """Its component id."""

    @property
    def own(self) -> OwnIdentity:
        """Our own ids in the messages to it, to which it answers."""

    waits: Waits
    """The answers that are awaited from it."""

    state: VehicleState
    """The latest state."""

    @property
    def silent(self) -> bool:
        """Whether its last heartbeat is more than 3 s older than what was read of the link."""

    def clock(self) -> float:
        """Monotonic time, s."""

    def send(self, message: Message | RawMessage) -> None:
        """Send to it. Raises LinkDown if that is not possible."""
