"""Decides whether a vehicle on another link is one already known (decision 44)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import StrEnum

from mavcal.service.errors import LinkDown, ParameterMissing, VehicleError
from mavcal.service.vehicle.boot_time import BootClock
from mavcal.service.vehicle.channels import LinkChannel
from mavcal.service.vehicle.identity import Autopilot, VehicleIdentity
from mavcal.service.vehicle.parameter_bits import Parameter
from mavcal.service.vehicle.vehicle import Vehicle

WAIT_S = 10.0
"""Longest wait for an identity, s; a vehicle at an address known on another link then counts as another one."""
CLOCK_S = 6.0
"""Longest wait for the clocks where the unique ids are equal, s: some firmwares send no time."""
APART_S = 10.0
"""Time after which contradicting clocks mean two vehicles, s; after a restart they differ for less."""
_AGAIN_S = 10.0
WITH_ID_S = 3.0
"""How far the clocks of two links to one unique id may differ: as long as a slow link may hold a message back."""
WITHOUT_ID_S = 0.5
"""The same limit where only clock and parameters indicate one unit."""

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
"""Parameters of sensors, starts and calibration, which two units hardly share in every digit."""


class Kinship(StrEnum):
    """How two identities relate: the same unit, different units, or undecided."""

    SAME = "same"  # one unique id
    OTHER = "other"
    OPEN = "open"  # the same kind of vehicle, and neither has a unique id


def kinship(one: VehicleIdentity, other: VehicleIdentity) -> Kinship:
    """Compare two identities by AUTOPILOT_VERSION, which both must have sent."""
    if _kind(one) != _kind(other) or one.uid2 != other.uid2:
        return Kinship.OTHER
    return Kinship.OPEN if one.uid2 is None else Kinship.SAME


def _kind(identity: VehicleIdentity) -> tuple[object, ...]:
    hardware = (identity.board, identity.vendor, identity.product)
    return identity.autopilot, identity.vehicle_type, identity.version, identity.git_hash, hardware


def clocks_agree(one: BootClock, other: BootClock, within_s: float) -> bool | None:
    """Whether both clocks can belong to one vehicle; None: too few time stamps to decide."""
    ahead = one.ahead_of(other)
    return None if ahead is None else abs(ahead) <= within_s


class Kin:
    """Compares vehicles, and keeps the parameters read for that."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._read: dict[tuple[Vehicle, Vehicle], bool] = {}
        self._reading: dict[tuple[Vehicle, Vehicle], asyncio.Task[None]] = {}

    def decide(self, vehicle: Vehicle, units: Sequence[Vehicle]) -> Vehicle | None:
        """The unit of this vehicle: itself, or one of `units`, which have its address; None while undecided."""
        others = [other for other in units if _comparable(vehicle, other, units)]
        if not vehicle.identity.known:
            waiting = self._clock() - vehicle.found_at < WAIT_S
            vehicle.undecided = _undecided_text(vehicle, others[0]) if others and waiting else ""
            return None
        open_ones = []
        for other in others:
            same = self._same(vehicle, other)
            if same:
                return other
            if same is None:
                open_ones.append(other)
        if open_ones:
            vehicle.undecided = _undecided_text(vehicle, open_ones[0])
            return None
        return vehicle

    def _same(self, vehicle: Vehicle, other: Vehicle) -> bool | None:
        if not other.identity.known:
            return False if self._clock() - vehicle.found_at >= WAIT_S else None
        kind = kinship(vehicle.identity, other.identity)
        if kind is Kinship.OTHER:
            return False
        if vehicle.conflicts_of_address or other.conflicts_of_address:
            return None
        within_s = WITH_ID_S if kind is Kinship.SAME else WITHOUT_ID_S
        agree = clocks_agree(vehicle.channels.in_use.clock, other.channels.in_use.clock, within_s)
        waited = self._clock() - vehicle.found_at
        if kind is Kinship.SAME:
            return True if agree is None and waited >= CLOCK_S else agree
        if agree is None:
            return None if waited < CLOCK_S else False
        return self._parameters_same(vehicle, other) if agree else False

    def _parameters_same(self, vehicle: Vehicle, other: Vehicle) -> bool | None:
        """Whether both hold the same telling parameters, which are read of both; None while that goes on."""
        pair = (vehicle, other)
        if pair in self._read:
            return self._read.pop(pair)
        if pair not in self._reading:
            task = asyncio.get_running_loop().create_task(self._compare(pair))
            self._reading[pair] = task
            task.add_done_callback(lambda _: self._reading.pop(pair, None))
        return None

    async def _compare(self, pair: tuple[Vehicle, Vehicle]) -> None:
        names = TELLING.get(pair[0].identity.autopilot, ())
        while True:
            try:
                mine, its = [[await _value(vehicle, name) for name in names] for vehicle in pair]
            except (VehicleError, LinkDown):
                if any(vehicle.joined or vehicle.gone for vehicle in pair):
                    return
                await asyncio.sleep(_AGAIN_S)
                continue
            self._read[pair] = bool(names) and mine == its and any(value is not None for value in mine)
            return

    def apart(self, vehicle: Vehicle) -> list[LinkChannel]:
        """Links of a vehicle whose clock has long contradicted that of the link in use."""
        if len(vehicle.channels) < 2:
            return []
        used, now, found = vehicle.channels.in_use, self._clock(), []
        for channel in vehicle.channels:
            agree = channel is used or clocks_agree(channel.clock, used.clock, WITH_ID_S)
            if agree is not False or channel.silent(now) or used.silent(now):
                channel.apart_since = None
            elif channel.apart_since is None:
                channel.apart_since = now
            elif now - channel.apart_since >= APART_S:
                found.append(channel)
        return found

    def close(self) -> None:
        """Stop every comparison."""
        for task in list(self._reading.values()):
            task.cancel()


async def _value(vehicle: Vehicle, name: str) -> bytes | None:
    with suppress(ParameterMissing):
        found: Parameter = await vehicle.parameters.read(name)
        return found.bits
    return None


def _comparable(vehicle: Vehicle, other: Vehicle, units: Sequence[Vehicle]) -> bool:
    """Whether `other` is heard on other links alone, and comes before: it is settled, or was found earlier."""
    if other is vehicle or any(link in other.links for link in vehicle.links):
        return False
    return other.settled or other.found_at < vehicle.found_at or units.index(other) < units.index(vehicle)


def _undecided_text(vehicle: Vehicle, other: Vehicle) -> str:
    return (
        f"It is not decided yet whether system id {vehicle.system} on link {vehicle.way} is the vehicle {other.id}: "
        "that takes a few seconds."
    )
