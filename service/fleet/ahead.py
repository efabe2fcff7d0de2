"""Computes the trends of a fleet in advance: each takes 10 ms of processor time, and a fleet has thousands."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

from mavcal.service.errors import ServiceError
from mavcal.service.fleet.view import FleetUnit, fleet_units
from mavcal.service.store.sql import Store

START_S = 20.0
PERIOD_S = 30.0


@dataclass
class TrendsAhead:
    """Computes missing trends, for at most half of the time; `measured` grows with new measurements."""

    store: Store
    measured: Callable[[], int]
    wall: Callable[[], float] = time.time
    _done: int = 0

    async def run(self) -> None:
        """Compute what is missing at intervals, until cancelled."""
        await asyncio.sleep(START_S)
        while True:
            if (measured := self.measured()) != self._done and await self.compute():
                self._done = measured
            await asyncio.sleep(PERIOD_S)

    async def compute(self) -> bool:
        """Go through every unit once; False: the store could not be read."""
        try:
            rows = await self.store.do(self.store.fleet)
        except ServiceError:
            return False  # whoever asks for the fleet is told why
        for unit in await asyncio.to_thread(fleet_units, rows, {}, self.wall()):
            began = time.monotonic()
            await asyncio.to_thread(_look_at, unit)
            await asyncio.sleep(time.monotonic() - began)
        return True


def _look_at(unit: FleetUnit) -> None:
    for sensor in unit.standing.sensors:
        _ = sensor.trend
