"""One event stream for the whole service: jobs, vehicles and links."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from typing import Annotated, cast

import structlog
from fastapi import Depends, Request
from fastapi.sse import ServerSentEvent

from mavcal.service.api.models.links import LinkModel
from mavcal.service.api.models.vehicles import VehicleModel
from mavcal.service.api.sight import Sight
from mavcal.service.api.views import event_model, link_model, vehicle_model
from mavcal.service.core import Service

log = structlog.get_logger(__name__)

LOOK_S = 0.5
"""How often vehicles and links are looked at."""
STEADY = {"received", "lost", "loss", "bytes_per_s", "evidence", "crc_errors"}
"""What moves all the time and is told only along with something else."""

Name = tuple[str, str]
"""`vehicle` or `link`, and its id."""
State = VehicleModel | LinkModel


class ChangeWatch:
    """Polls vehicles and links once for all open streams, and wakes them when a state has changed."""

    def __init__(self, look: Callable[[], list[tuple[str, State]]]) -> None:
        self._ask = look
        self._states: dict[Name, tuple[str, State]] = {}
        self._news = asyncio.Event()
        self._streams = 0
        self._looking: asyncio.Task[None] | None = None

    async def changes(self) -> AsyncIterator[tuple[str, State]]:
        """Every state now, and then each one that has changed, for ever."""
        sent: dict[Name, str] = {}
        self._streams += 1
        self._look()
        if self._looking is None:
            self._looking = asyncio.create_task(self._run())
        try:
            while True:
                news = self._news
                for name, (text, state) in self._states.items():
                    if sent.get(name) != text:
                        sent[name] = text
                        yield name[0], state
                if news is self._news:  # else a look came in between
                    await news.wait()
        finally:
            self._streams -= 1
            if self._streams == 0:
                self._looking.cancel()
                self._looking = None

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            try:
                self._look()
            except Exception:  # a state that cannot be told once must not silence every stream; logged with its trace
                log.exception("vehicles and links could not be looked at")

    def _look(self) -> None:
        found = {(name, s.id): (s.model_dump_json(exclude=STEADY), s) for name, s in self._ask()}
        if {name: text for name, (text, _) in found.items()} == {
            name: text for name, (text, _) in self._states.items()
        }:
            return
        self._states = found
        news, self._news = self._news, asyncio.Event()
        news.set()


def watch_of(service: Service) -> ChangeWatch:
    """A watch over the vehicles and links of a service."""

    def states() -> list[tuple[str, State]]:
        vehicles = [("vehicle", vehicle_model(v)) for v in service.vehicles.all()]
        links = [("link", link_model(link, service.vehicles)) for link in service.links.all()]
        return [*vehicles, *links]

    return ChangeWatch(states)


def _watch(request: Request) -> ChangeWatch:
    state = request.app.state
    if getattr(state, "watch", None) is None:
        state.watch = watch_of(state.service)
    return cast(ChangeWatch, state.watch)


WatchDep = Annotated[ChangeWatch, Depends(_watch)]


async def everything(service: Service, watch: ChangeWatch, sight: Sight, after: int) -> AsyncIterator[ServerSentEvent]:
    """Events of jobs after the id `after`; vehicles and links whenever their state has changed."""
    queue: asyncio.Queue[ServerSentEvent | None] = asyncio.Queue(maxsize=1)
    reading = [
        asyncio.create_task(_states(watch, sight, queue)),
        asyncio.create_task(_events(service, sight, after, queue)),
    ]
    try:
        while (event := await queue.get()) is not None:
            yield event
    finally:
        for task in reading:
            task.cancel()
        await asyncio.gather(*reading, return_exceptions=True)


async def _states(watch: ChangeWatch, sight: Sight, queue: asyncio.Queue[ServerSentEvent | None]) -> None:
    async with aclosing(watch.changes()) as states:  # type: ignore[type-var]
        async for name, state in states:
            seen = sight.link(state) if isinstance(state, LinkModel) else state if sight.vehicle(state.id) else None
            if seen is not None:
                await queue.put(ServerSentEvent(data=seen, event=name))


async def _events(service: Service, sight: Sight, after: int, queue: asyncio.Queue[ServerSentEvent | None]) -> None:
    async with aclosing(service.jobs.subscribe(None, after)) as events:  # type: ignore[type-var]
        async for event in events:
            if sight.job_of(event.job_id):
                await queue.put(ServerSentEvent(data=event_model(event), event="job", id=str(event.id)))
    await queue.put(None)
