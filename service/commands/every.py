"""Runs a command for several vehicles: those of the given endpoints, or every one that is heard."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import click

from mavcal.service.commands.output import EXIT_NO, EXIT_PART, AnsweredNo, write_json
from mavcal.service.commands.remote import noes
from mavcal.service.commands.vehicles import Found, Refusal, vehicles_of
from mavcal.service.errors import ServiceError

if TYPE_CHECKING:
    from mavcal.client.models import UnfinishedModel, VehicleModel
    from mavcal.service.commands.door import Door
    from mavcal.service.commands.screen import Screen
    from mavcal.service.commands.whom import Whom


@dataclass(frozen=True)
class Acted:
    """Outcome for one vehicle: whether it is good, a line of text, and the same as JSON."""

    good: bool
    text: str
    document: dict[str, Any] = field(default_factory=dict)
    in_part: bool = False
    """Good, but not of every sensor."""


T = TypeVar("T")
Act = Callable[["Door", "VehicleModel", "Screen"], Awaitable[T]]


def run_every(whom: Whom, act: Act[Acted], *, as_json: bool) -> int:
    """Do the same with every vehicle, side by side; the exit code is that of the worst: 1 no, 3 done in part."""
    from mavcal.service.commands.door import through_door
    from mavcal.service.commands.screen import Screen

    came = through_door(whom, partial(with_each, whom=whom, act=act, screen=Screen(whom.place)))
    if isinstance(came, int):
        return came
    done = [(found, _as_acted(one)) for found, one in came]
    if as_json:
        write_json({"vehicles": [{**found.document, **acted.document} for found, acted in done]})
    else:
        for found, acted in done:
            name = "" if found.vehicle is None else f" {found.vehicle.id}"
            click.echo(f"{found.connect}{name}: {acted.text}")
    if not all(acted.good for _, acted in done):
        return EXIT_NO
    return EXIT_PART if any(acted.in_part for _, acted in done) else 0


async def with_each(door: Door, *, whom: Whom, act: Act[T], screen: Screen) -> list[tuple[Found, T | Refusal]]:
    """Act on every vehicle concurrently: the outcome of each, or why nothing was done.

    What an earlier run has left on a vehicle is finished first.
    """
    from mavcal.service.commands.headless import left_over, recovered

    async def one(found: Found, left: list[UnfinishedModel]) -> T | Refusal:
        if found.vehicle is None:
            assert found.error is not None
            return found.error
        try:
            with noes():
                await recovered(door, found.vehicle, left, screen)
                return await act(door, found.vehicle, screen)
        except (ServiceError, AnsweredNo) as error:
            return error

    left = await left_over(door)
    found = await vehicles_of(door, whom, screen)
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(one(vehicle, left)) for vehicle in found]
    return list(zip(found, [task.result() for task in tasks], strict=True))


def _as_acted(came: Acted | Refusal) -> Acted:
    if isinstance(came, Acted):
        return came
    return Acted(good=False, text=str(came), document={"error": {"code": came.code, "detail": str(came)}})
