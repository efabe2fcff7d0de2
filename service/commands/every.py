"""Several vehicles in one run: those of the endpoints that were given, or every one that is heard on the links."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.output import EXIT_NO, EXIT_PART, write_json
from mavcal.service.commands.place import place_of
from mavcal.service.errors import ServiceError
from mavcal.service.loading import loading

if TYPE_CHECKING:
    from pathlib import Path

    from mavcal.client.models import UnfinishedModel, VehicleModel
    from mavcal.service.commands.door import Door
    from mavcal.service.commands.screen import Screen
    from mavcal.service.settings import Settings

LISTEN_S = 4.0
"""How long a link is listened to for further vehicles once the first one is known: heartbeats come every second."""

connect_option = click.option(
    "--connect", "urls", multiple=True, metavar="URL", help="Endpoint of a vehicle, as udpin:0.0.0.0:14550; several."
)
all_option = click.option(
    "--all",
    "every",
    is_flag=True,
    help="Every vehicle that is heard on each --connect; without --connect, on the links of the settings and of the "
    "data directory.",
)


@dataclass(frozen=True)
class Found:
    """A vehicle at the end of a link, or why there is none."""

    connect: str
    vehicle: VehicleModel | None = None
    error: ServiceError | None = None

    @property
    def document(self) -> dict[str, Any]:
        """Who it is, as JSON."""
        if self.error is not None:
            return {"connect": self.connect, "error": {"code": self.error.code, "detail": str(self.error)}}
        assert self.vehicle is not None
        return {"connect": self.connect, "vehicle_id": self.vehicle.id}


@dataclass(frozen=True)
class Acted:
    """What came of one vehicle: whether it is what was asked for, a line for a person, and the same as JSON."""

    good: bool
    text: str
    document: dict[str, Any] = field(default_factory=dict)
    in_part: bool = False
    """Good, but not of every sensor."""


T = TypeVar("T")
Act = Callable[["Door", "VehicleModel"], Awaitable[Acted]]


@dataclass(frozen=True)
class Whom:
    """The vehicles that a command is about."""

    urls: tuple[str, ...]
    every: bool
    wait_s: float

    def settings(self, data_dir: Path | None) -> Settings:
        """The settings; their own endpoints count only where no other one is given."""
        if not self.urls and not self.every:
            raise click.UsageError("give --connect URL, or --all for every vehicle of the data directory")
        return load_settings(data_dir=data_dir, connect=() if self.urls else None)


async def vehicles_of(door: Door, whom: Whom, screen: Screen) -> list[Found]:
    """One vehicle an endpoint, or with `every` all of them, each unit once. A link without one tells why."""
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


def run_every(settings: Settings, whom: Whom, act: Act, *, as_json: bool) -> int:
    """Do the same with every vehicle, side by side; the exit code is that of the worst: 1 no, 3 done in part."""
    from mavcal.service.commands.screen import Screen
    from mavcal.service.logs import configure_logging

    configure_logging(as_json=settings.log_json)
    came = asyncio.run(with_each(settings, whom, act, Screen(place_of(settings))))
    if isinstance(came, int):
        return came
    done = [(found, _told(one)) for found, one in came]
    if as_json:
        write_json({"vehicles": [{**found.document, **acted.document} for found, acted in done]})
    else:
        for found, acted in done:
            name = "" if found.vehicle is None else f" {found.vehicle.id}"
            click.echo(f"{found.connect}{name}: {acted.text}")
    if not all(acted.good for _, acted in done):
        return EXIT_NO
    return EXIT_PART if any(acted.in_part for _, acted in done) else 0


async def with_each(
    settings: Settings, whom: Whom, act: Callable[[Door, VehicleModel], Awaitable[T]], screen: Screen
) -> list[tuple[Found, T | ServiceError]] | int:
    """What came of every vehicle, side by side, or why nothing did; the exit code of a run that was told to stop.

    What an earlier run has left on a vehicle is finished first.
    """
    with loading():
        from mavcal.service.commands.door import door
        from mavcal.service.commands.headless import recovered, stoppable

    async def one(at: Door, found: Found, left: list[UnfinishedModel]) -> T | ServiceError:
        if found.vehicle is None:
            assert found.error is not None
            return found.error
        try:
            await recovered(at, found.vehicle, left, screen)
            return await act(at, found.vehicle)
        except ServiceError as error:
            return error

    with stoppable() as caught:
        try:
            async with door(settings, whom.urls) as at:
                left = await at.client.list_unfinished()
                found = await vehicles_of(at, whom, screen)
                async with asyncio.TaskGroup() as group:
                    tasks = [group.create_task(one(at, vehicle, left)) for vehicle in found]
                return list(zip(found, [task.result() for task in tasks], strict=True))
        except asyncio.CancelledError:
            if not caught:
                raise
            return 128 + caught[0]


def _told(came: Acted | ServiceError) -> Acted:
    if isinstance(came, Acted):
        return came
    return Acted(good=False, text=str(came), document={"error": {"code": came.code, "detail": str(came)}})


def one_of(urls: Sequence[str]) -> str:
    """The only endpoint. Raises click.UsageError if there is another number of them."""
    if len(urls) != 1:
        raise click.UsageError("give one --connect URL, or --all for several vehicles")
    return urls[0]
