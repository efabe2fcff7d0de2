"""The kind of a vehicle, and the word for its motion: only aircraft fly."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.recording import Identity

_GROUND: Final = frozenset({dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_ANTENNA_TRACKER})
_WATER: Final = frozenset({dialect.MAV_TYPE_SURFACE_BOAT, dialect.MAV_TYPE_SUBMARINE})
_AIR: Final = frozenset(
    {
        *(dialect.MAV_TYPE_FIXED_WING, dialect.MAV_TYPE_QUADROTOR, dialect.MAV_TYPE_COAXIAL),
        *(dialect.MAV_TYPE_HELICOPTER, dialect.MAV_TYPE_AIRSHIP, dialect.MAV_TYPE_FREE_BALLOON),
        *(dialect.MAV_TYPE_HEXAROTOR, dialect.MAV_TYPE_OCTOROTOR, dialect.MAV_TYPE_TRICOPTER),
        *(dialect.MAV_TYPE_FLAPPING_WING, dialect.MAV_TYPE_KITE, dialect.MAV_TYPE_DODECAROTOR),
        *(dialect.MAV_TYPE_PARAFOIL, dialect.MAV_TYPE_DECAROTOR),
        *range(dialect.MAV_TYPE_VTOL_DUOROTOR, dialect.MAV_TYPE_VTOL_RESERVED5 + 1),
    }
)


class Craft(StrEnum):
    """Where a vehicle moves."""

    AIR = "air"
    GROUND = "ground"
    WATER = "water"
    UNKNOWN = "unknown"

    @property
    def moving(self) -> str:
        """Phrase for "while it moves", to end a sentence."""
        return {Craft.AIR: "in flight", Craft.GROUND: "while it drove"}.get(self, "under way")

    @property
    def moved(self) -> str:
        """Verb in the past tense for its movement."""
        return {Craft.AIR: "flew", Craft.GROUND: "drove"}.get(self, "was under way")

    @property
    def trip(self) -> str:
        """Noun for one trip."""
        return {Craft.AIR: "flight", Craft.GROUND: "drive"}.get(self, "trip")

    @property
    def turn(self) -> str:
        """Manoeuvre that gives its compass the headings and tilts that a fit needs."""
        if self == Craft.AIR:
            return "fly two full turns, and banks of 30 deg if that is safe"
        if self == Craft.GROUND:
            return "drive two full turns, and over slopes if that is safe"
        return "make two full turns, and roll and pitch if that is safe"

    @property
    def load(self) -> str:
        """What changes the load of its motors."""
        return "climb and descend a few times" if self == Craft.AIR else "speed up and slow down a few times"


def craft_of(identity: Identity) -> Craft:
    """Kind of vehicle, by the MAV_TYPE of `identity`."""
    kind = identity.vehicle_type
    for craft, kinds in ((Craft.AIR, _AIR), (Craft.GROUND, _GROUND), (Craft.WATER, _WATER)):
        if kind in kinds:
            return craft
    return Craft.UNKNOWN
