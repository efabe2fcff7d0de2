"""What happens to vehicles, in sentences."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class VehicleEventKind(StrEnum):
    """What happened to a vehicle."""

    FOUND = "found"
    IDENTIFIED = "identified"
    ARMED = "armed"
    DISARMED = "disarmed"
    LANDED = "landed"
    SILENT = "silent"
    HEARD_AGAIN = "heard_again"
    REBOOTED = "rebooted"
    CALIBRATING = "calibrating"
    TEXT = "text"
    CONFLICT = "conflict"
    PEER_CHANGED = "peer_changed"
    REPLACED = "replaced"
    LINKS = "links"  # it is heard over one link more or less
    MOVED = "moved"  # it is spoken to over another link


@dataclass(frozen=True)
class VehicleEvent:
    """One sentence about a vehicle, for people and for jobs."""

    kind: VehicleEventKind
    vehicle_id: str
    text: str
