"""The service's engine in this process, on a data directory and one link, until its vehicle is known."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavcal.calib.procedures.protocol import Prompt
from mavcal.calib.report import to_json
from mavcal.service.core import require_unneeded
from mavcal.service.errors import ServiceError
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.link.link import Link
from mavcal.service.simvehicle import Operator, SimulatedVehicle
from mavcal.service.store import SqliteStore
from mavcal.service.store.sql import Store
from mavcal.service.vehicle.job_vehicle import VehicleSource
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.vehicle import Vehicle
from tests.vehicles import first_vehicle

POLL_S = 0.01
FOUND_S = 30.0

SETTINGS = JobSettings(measure_s=0.3, retry_s=0.2, watch_s=0.05, stall_s=10.0)
"""As in the service, but for waits that are the wall's: the vehicle's clock is faster."""
PROVE_S = 120.0
"""Seconds of the vehicle's clock for the movements that prove the rest, and where a bad wire leaves holes."""


@dataclass
class Session:
    """One life of the service."""

    engine: JobEngine
    vehicle: Vehicle
    operator: Operator
    more: Callable[[str], Awaitable[Link]]
    """Opens one more link, at that endpoint."""
    close: Callable[[str], Awaitable[None]]
    """Closes the link of that name as the service does. Raises LinkBusy."""
    _asked: Prompt | None = None

    async def reviewed(
        self, sim: SimulatedVehicle, kind: str, options: dict[str, Any], plan_options: dict[str, Any] | None = None
    ) -> Job:
        """Run a job up to its plan, with an operator who does what it asks for."""
        await self.ready()
        job = await self.engine.submit(self.vehicle.id, kind, options, plan_options)
        ended = (JobState.REVIEW, JobState.SUCCEEDED, JobState.FAILED, JobState.INTERRUPTED)
        while (job := self.engine.get(job.id)).state not in ended:
            await self.obeyed(job)
            await asyncio.sleep(POLL_S)
        await asyncio.to_thread(self.operator.rest)
        await asyncio.to_thread(sim.wait, 4.0)  # until it lies
        return job

    async def obeyed(self, job: Job) -> None:
        """Do what the job asks for, if that is something new."""
        if job.prompt is not None and job.prompt is not self._asked:
            self._asked = job.prompt
            await asyncio.to_thread(self.operator.follow, to_json(job.prompt))

    async def applied(self, job: Job) -> Job:
        """Accept the plan, as soon as the service takes it."""
        assert job.plan is not None
        accept = Accept(job.plan.sha256, reboot=True, prove_s=PROVE_S)
        while True:
            await self.ready()
            try:
                return await self.engine.apply(job.id, accept)
            except ServiceError:
                if self.vehicle.writable().ok:
                    raise

    async def ready(self) -> None:
        """Wait until the vehicle may be written to."""
        while not self.vehicle.writable().ok:  # noqa: ASYNC110 - the condition is about another process
            await asyncio.sleep(POLL_S)


@asynccontextmanager
async def session(
    folder: Path, sim: SimulatedVehicle, store: Store | None = None, **engine_options: Any
) -> AsyncIterator[Session]:
    """A service that is stopped in an orderly way at the end. Raises TimeoutError if no vehicle is heard.

    `store` (None: SQLite in `folder`) is closed at the end; `engine_options` are those of JobEngine.
    """
    store = store or SqliteStore(folder)
    registry = VehicleRegistry()
    engine = JobEngine(store, VehicleSource(registry), **{"settings": SETTINGS, **engine_options})
    links: dict[str, Link] = {}

    async def more(url: str) -> Link:
        name = f"campaign-{len(links)}" if links else "campaign"
        links[name] = Link(name, url, tlog_dir=folder / "tlogs")
        registry.attach(links[name])
        await links[name].open()
        return links[name]

    async def close(name: str) -> None:
        require_unneeded(links[name], registry, engine.list())
        gone = links.pop(name)
        await gone.close()
        registry.detach(gone)

    try:
        link = await more(sim.url)
        await engine.start()
        async with asyncio.timeout(FOUND_S):
            vehicle = await first_vehicle(registry, link)
        yield Session(engine, vehicle, Operator(sim), more, close)
    finally:
        await engine.stop()
        for opened in links.values():
            registry.detach(opened)
            await opened.close()
        registry.close()
        store.close()
