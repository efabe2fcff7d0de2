"""One stream of everything that happens."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import aclosing

from fastapi.sse import ServerSentEvent

from service.api.models import LinkModel, VehicleModel
from service.api.views import event_model, link_model, vehicle_model
from service.core import Service
from service.store.rows import EventRow

LOOK_S = 0.5
"""How often vehicles and links are looked at."""
STEADY = {"received", "lost", "loss", "bytes_per_s", "evidence", "crc_errors"}
"""What moves all the time and is told only along with something else."""


async def everything(service: Service, after: int) -> AsyncIterator[ServerSentEvent]:
    """Events of jobs after the id `after`; vehicles and links whenever their state has changed."""
    queue: asyncio.Queue[EventRow | None] = asyncio.Queue(maxsize=1)
    reading = asyncio.create_task(_read(service, after, queue))
    told: dict[tuple[str, str], str] = {}
    try:
        while True:
            for name, state in _states(service):
                text = state.model_dump_json(exclude=STEADY)
                if told.get((name, state.id)) != text:
                    told[name, state.id] = text
                    yield ServerSentEvent(data=state, event=name)
            try:
                async with asyncio.timeout(LOOK_S):
                    event = await queue.get()
            except TimeoutError:
                continue
            if event is None:
                return
            yield ServerSentEvent(data=event_model(event), event="job", id=str(event.id))
    finally:
        reading.cancel()


async def _read(service: Service, after: int, queue: asyncio.Queue[EventRow | None]) -> None:
    async with aclosing(service.jobs.subscribe(None, after)) as events:  # type: ignore[type-var]
        async for event in events:
            await queue.put(event)
    await queue.put(None)


def _states(service: Service) -> list[tuple[str, VehicleModel | LinkModel]]:
    vehicles = [("vehicle", vehicle_model(v)) for v in service.vehicles.all()]
    links = [("link", link_model(link, service.vehicles)) for link in service.links.all()]
    return [*vehicles, *links]
