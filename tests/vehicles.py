"""Waits for what a registry of vehicles finds."""

from __future__ import annotations

import asyncio

from mavcal.service.link.link import Link
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.vehicle import Vehicle


async def first_vehicle(registry: VehicleRegistry, link: Link) -> Vehicle:
    """The first vehicle on that link, once it is known who it is; waits for ever."""
    while True:
        for vehicle in registry.all():
            if link in vehicle.links and vehicle.identity.known:
                return vehicle
        await asyncio.sleep(0.01)
