"""Message rates for their users: requests, rates owed until returned, and the ledger of any vehicle.

Both firmwares keep one set of rates for a link, so only one user has them at a time. A job goes before a preflight, and
either before those who watch. Each stores the previous intervals (:class:`Owed`) until they are returned.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from mavcal.service.errors import VehicleUnknown
from mavcal.service.rates.owed import OwedRates
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource
from mavcal.service.vehicle.rate_ledger import RateLedger


class Owed(Protocol):
    """Keeps message intervals (us by message: -1 off, 0 the vehicle's default) as they were before a change."""

    def intervals(self) -> Mapping[int, int]:
        """The intervals that are owed to the vehicle."""

    async def owe(self, before: Mapping[int, int]) -> None:
        """Add `before` to what is owed; written to disk before any change, where it must survive a crash."""

    async def returned(self) -> None:
        """Clear what is owed."""


async def request_rates(
    vehicle: JobVehicle, rates: Mapping[int, float], owed: Owed, *, measure_s: float
) -> tuple[str, ...]:
    """Request messages at `rates` (Hz); returns sentences on slower ones. Raises VehicleError, LinkError."""
    known = owed.intervals()
    before = await vehicle.intervals([message_id for message_id in rates if message_id not in known])
    if before:
        await owed.owe(before)
    return await vehicle.request_streams(rates, measure_s=measure_s, before={**known, **before})


async def return_rates(vehicle: JobVehicle, owed: Owed) -> None:
    """Restore the intervals that are owed. Raises VehicleError, LinkError; all of them are still owed then."""
    intervals = owed.intervals()
    if intervals:
        await vehicle.set_intervals(intervals)
        await owed.returned()


class RateLedgers:
    """The ledgers of all vehicles.

    Parameters
    ----------
    vehicles
        Where vehicles are found.
    kept
        Rates owed to vehicles that were watched; None: nobody watches.
    """

    def __init__(self, vehicles: VehicleSource, kept: OwedRates | None = None) -> None:
        self.vehicles, self.kept = vehicles, kept
        self._all: dict[str, RateLedger] = {}

    def of(self, vehicle_id: str) -> RateLedger:
        """The ledger of a vehicle, by any id that it has had; not to be held over an await.

        A vehicle gets its lasting id once it has identified itself. It may turn out to be a vehicle on another link,
        and gets a new ledger when it is found again. An absent vehicle keeps its previous ledger.
        """
        vehicle = self._vehicle(vehicle_id)
        present = vehicle_id if vehicle is None else vehicle.id
        found = self._all.get(present, RateLedger()) if vehicle is None else vehicle.rates
        if self._all.get(present) is not found:
            self._all = {key: ledger for key, ledger in self._all.items() if ledger.in_use}
            earlier, self._all[present] = self._all.get(present), found
            if earlier is not None:
                found.join(earlier)
        for key in [key for key in self._all if key != present and self._present_id(key) == present]:
            earlier = self._all.pop(key)
            if earlier is not found:
                found.join(earlier)
        return found

    def all(self) -> tuple[RateLedger, ...]:
        """Every ledger in use."""
        return tuple(ledger for ledger in self._all.values() if ledger.in_use)

    def _present_id(self, vehicle_id: str) -> str:
        vehicle = self._vehicle(vehicle_id)
        return vehicle_id if vehicle is None else vehicle.id

    def _vehicle(self, vehicle_id: str) -> JobVehicle | None:
        try:
            return self.vehicles.vehicle(vehicle_id)
        except VehicleUnknown:
            return None
