"""Which vehicle is which: whether two addresses on two links lead to the same unit (decision 44)."""

from __future__ import annotations

from enum import StrEnum

from mavcal.service.vehicle.boot_time import BootClock
from mavcal.service.vehicle.identity import Autopilot, VehicleIdentity

WITH_ID_S = 3.0
"""How far the clocks of two links to one unique id may differ: as long as a slow link may hold a message back."""
WITHOUT_ID_S = 0.5
"""The same where only the clock and the parameters speak for one unit."""

TELLING = {
    Autopilot.ARDUPILOT: (
        "INS_ACC_ID",
        "INS_GYR_ID",
        "COMPASS_DEV_ID",
        "STAT_BOOTCNT",
        "INS_ACCOFFS_X",
        "INS_GYROFFS_X",
        "COMPASS_OFS_X",
    ),
    Autopilot.PX4: (
        "CAL_ACC0_ID",
        "CAL_GYRO0_ID",
        "CAL_MAG0_ID",
        "COM_FLIGHT_UUID",
        "CAL_ACC0_XOFF",
        "CAL_GYRO0_XOFF",
        "CAL_MAG0_XOFF",
    ),
}
"""Sensors, starts and calibration: what two units without a unique id hardly share in every digit."""


class Kinship(StrEnum):
    """What two identities say of each other."""

    SAME = "same"  # one unique id
    OTHER = "other"
    OPEN = "open"  # the same kind of vehicle, and neither has a unique id


def kinship(one: VehicleIdentity, other: VehicleIdentity) -> Kinship:
    """By what AUTOPILOT_VERSION says; both must be known."""
    if _kind(one) != _kind(other) or one.uid2 != other.uid2:
        return Kinship.OTHER
    return Kinship.OPEN if one.uid2 is None else Kinship.SAME


def _kind(identity: VehicleIdentity) -> tuple[object, ...]:
    hardware = (identity.board, identity.vendor, identity.product)
    return identity.autopilot, identity.vehicle_type, identity.version, identity.git_hash, hardware


def clocks_agree(one: BootClock, other: BootClock, within_s: float) -> bool | None:
    """Whether both may be the clock of one vehicle; None: too little was heard of them to say."""
    ahead = one.ahead_of(other)
    return None if ahead is None else abs(ahead) <= within_s
