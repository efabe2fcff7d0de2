"""The vehicles that a command is about: those at the end of its links, or those that a running service has heard."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.output import AnsweredNo
from mavcal.service.errors import ServiceError

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.models import VehicleModel
    from mavcal.service.commands.door import Door
    from mavcal.service.commands.screen import Screen
    from mavcal.service.commands.whom import Whom

LISTEN_S = 4.0
"""How long a link is listened to for further vehicles once the first one is known: heartbeats come every second."""
_LOOK_S = 0.1

Refusal = ServiceError | AnsweredNo
"""Why a vehicle is not there, or why nothing was done with it; both have a code for programs."""


@dataclass(frozen=True)
class Found:
    """A vehicle at the end of a link, or why there is none."""

    connect: str
    vehicle: VehicleModel | None = None
    error: Refusal | None = None

    @property
    def document(self) -> dict[str, Any]:
        """Identity of the vehicle, as JSON."""
        if self.error is not None:
            return {"connect": self.connect, "error": {"code": self.error.code, "detail": str(self.error)}}
        assert self.vehicle is not None
        return {"connect": self.connect, "vehicle_id": self.vehicle.id}


async def vehicle_of(door: Door, whom: Whom, screen: Screen, job_id: str | None = None) -> VehicleModel:
    """The one vehicle that a command is about; of a running service it is that of the job, if there is one.

    Raises
    ------
    VehicleSilent
        If none is heard in time.
    JobUnknown, NoVehicle, VehicleUnknown
        If a service has not this job, or not its vehicle.
    click.UsageError
        If a service has several and none of them was chosen.
    """
    from mavcal.service.commands.headless import heard
    from mavcal.service.errors import NoVehicle

    if door.shared and job_id is not None:
        job = await door.client.get_job(job_id)
        if job.vehicle_id is None:
            raise NoVehicle
        return await door.client.get_vehicle(job.vehicle_id)
    if door.shared:
        return (await served(door.client, whom, screen))[0]
    return await heard(door, whom.urls[0], whom.wait_s, screen)


async def vehicles_of(door: Door, whom: Whom, screen: Screen) -> list[Found]:
    """One vehicle an endpoint, or with `every` all of them, each unit once. A link without one tells why.

    Of a running service: those that were chosen, the only one, or with `every` all of them.
    """
    if door.shared:
        vehicles = await served(door.client, whom, screen)
        endpoints = {link.id: link.url for link in await door.client.list_links()}
        return [Found(endpoints.get(vehicle.link, vehicle.link), vehicle) for vehicle in vehicles]
    urls = list(dict.fromkeys(whom.urls)) or [link.url for link in await door.client.list_links()]
    if not urls:
        raise click.UsageError("the settings and the data directory remember no link: give --connect URL")
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(_of_link(door, url, whom, screen)) for url in urls]
    found = [one for task in tasks for one in task.result()]
    once: dict[str, Found] = {}
    for one in found:
        once.setdefault(one.connect if one.vehicle is None else one.vehicle.id, one)
    return list(once.values())


async def _of_link(door: Door, url: str, whom: Whom, screen: Screen) -> list[Found]:
    from mavcal.service.commands.headless import heard, on_link

    try:
        vehicle = await heard(door, url, whom.wait_s, screen)
        link_id = await door.open(url)
    except ServiceError as error:
        return [Found(url, error=error)]
    if not whom.every:
        return [Found(url, vehicle)]
    await asyncio.sleep(LISTEN_S)
    return [Found(url, v) for v in await on_link(door.client, link_id)]


async def served(client: AsyncClient, whom: Whom, screen: Screen) -> list[VehicleModel]:
    """The chosen vehicles of a running service, once each has identified itself.

    Raises
    ------
    VehicleSilent
        If none is there in time.
    click.UsageError
        If it has several and none of them was chosen, or has not the chosen one, or a system id is not the only one.
    """
    from mavcal.service.commands.headless import QUIET_S
    from mavcal.service.errors import VehicleSilent

    known: list[VehicleModel] = []

    def say() -> None:
        screen.line(f"waiting up to {whom.wait_s:g} s for {_wanted(whom)}: {_listed(known)}")

    saying = asyncio.get_running_loop().call_later(QUIET_S, say)
    try:
        with suppress(TimeoutError):
            async with asyncio.timeout(whom.wait_s):
                while True:
                    known[:] = await client.list_vehicles()
                    meant = _meant(known, whom)
                    if meant and all(vehicle.firmware for vehicle in meant):
                        return meant
                    await asyncio.sleep(_LOOK_S)
    finally:
        saying.cancel()
    if known and whom.ids:
        raise click.UsageError(f"{_wanted(whom)} is not there: {_listed(known)}")
    raise VehicleSilent(
        f"the service heard no vehicle within {whom.wait_s:g} s: check its power, and its link at the service"
    )


def _meant(known: Sequence[VehicleModel], whom: Whom) -> list[VehicleModel]:
    """The vehicles of `known` that the options name; none while one is missing. Raises UsageError."""
    if not whom.ids:
        if len(known) > 1 and not whom.every:
            raise click.UsageError(f"{_listed(known)}: choose with --vehicle ID")
        return [vehicle for vehicle in known if vehicle.firmware] if whom.every else list(known)
    meant: dict[str, VehicleModel] = {}
    for name in whom.ids:
        called = [v for v in known if v.id == name] or [v for v in known if str(v.system) == name]
        if len(called) > 1:
            raise click.UsageError(f"{name} is the system id of several, choose by id: {_listed(called)}")
        if not called:
            return []
        meant[called[0].id] = called[0]
    return list(meant.values())


def _wanted(whom: Whom) -> str:
    return f"vehicle {', '.join(whom.ids)}" if whom.ids else "a vehicle"


def _listed(known: Sequence[VehicleModel]) -> str:
    named = [f"{v.id} ({v.autopilot.value}, system {v.system})" for v in known]
    return f"the service has {', '.join(named)}" if named else "the service has none"
