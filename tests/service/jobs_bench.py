"""The job engine over a real link to a simulated vehicle in its own process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavcal.service.jobs.core.crashpoints import CrashPoint, no_crash
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.link.link import Link
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store import SqliteStore
from mavcal.service.vehicle.job_vehicle import VehicleSource
from mavcal.service.vehicle.registry import VehicleRegistry
from mavcal.service.vehicle.vehicle import Vehicle
from tests.patience import scaled
from tests.vehicles import first_vehicle

SPEED = 10.0
GYRO = tuple(f"INS_GYR{n}OFFS_{axis}" for n in ("O", "2", "3") for axis in "XYZ")
GYRO_OFFSETS = tuple(name.replace("GYROOFFS", "GYROFFS") for name in GYRO)

QUICK = JobSettings(measure_s=0.3, retry_s=0.2, watch_s=0.05)
"""As in the service, but for how long streams are measured: a simulated vehicle's link is fast."""


@dataclass
class Session:
    """One life of the service."""

    store: SqliteStore
    registry: VehicleRegistry
    link: Link
    engine: JobEngine
    vehicle: Vehicle

    async def until(self, job_id: str, *states: JobState, seconds: float = 60.0) -> Job:
        """Wait for one of the states."""
        async with asyncio.timeout(scaled(seconds)):
            while (job := self.engine.get(job_id)).state not in states:  # noqa: ASYNC110 - the store wakes nobody here
                await asyncio.sleep(0.02)
        return job

    async def writable(self) -> None:
        """Wait until the vehicle may be written to."""
        await eventually(lambda: self.vehicle.writable().ok)

    async def accepted(self, job: Job, **options: Any) -> Job:
        assert job.plan is not None
        return await self.engine.apply(job.id, Accept(job.plan.sha256, **{"prove_s": 0.0, **options}))


async def eventually(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    async with asyncio.timeout(scaled(seconds)):
        while not condition():  # noqa: ASYNC110 - the condition is about another process
            await asyncio.sleep(0.02)


@asynccontextmanager
async def session(
    folder: Path, url: str, *, reach: CrashPoint = no_crash, settings: JobSettings = QUICK, yield_s: float = 30.0
) -> AsyncIterator[Session]:
    """The service on a data directory, until its vehicle is known; stopped in an orderly way at the end."""
    store = SqliteStore(folder)
    registry = VehicleRegistry(yield_s=yield_s)
    link = Link("bench", url, tlog_dir=folder / "tlogs")
    registry.attach(link)
    engine = JobEngine(store, VehicleSource(registry), reach=reach, settings=settings)
    try:
        await link.open()
        await engine.start()
        async with asyncio.timeout(scaled(20)):
            vehicle = await first_vehicle(registry, link)
        yield Session(store, registry, link, engine, vehicle)
    finally:
        await engine.stop()
        registry.detach(link)
        await link.close()
        registry.close()
        store.close()


def zero_gyro_offsets(sim: SimulatedVehicle) -> None:
    """Undo what the vehicle estimated at its boot, so that there is something to calibrate."""
    for name in GYRO_OFFSETS:
        sim.call("fault", kind="foreign_write", name=name, value=0.0)


def stored(sim: SimulatedVehicle) -> dict[str, float]:
    """What the vehicle would answer to a read, but for its clock."""
    return {name: value for name, value in sim.parameters()[1].items() if not name.startswith("STAT_")}
