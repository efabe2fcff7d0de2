"""One instance of the service in a process of its own that kills itself, or stands still, at a named instant.

``python -m tests.service.instance_process DATA_DIR DATABASE_URL LINK ACTION POINT OCCURRENCE HOW``. ACTION is ``apply``
(calibrate the gyroscopes and accept the plan) or ``own`` (only take part). POINT is one of
:class:`service.jobs.core.crashpoints.At`; at its OCCURRENCE the process gets the signal HOW, as from outside.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from pathlib import Path

from mavcal.service.core import Service, running_service
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.model import Accept
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.settings import Settings
from tests.patience import scaled
from tests.service.jobs_bench import eventually

LEASE_S = min(scaled(3.0), 12.0)
"""A machine that is late for so long ends a lease, and with it what its owner does."""


def settings(folder: Path, database_url: str, *links: str, name: str) -> Settings:
    """Those of an instance that shares its uploads with others beside it."""
    return Settings(
        data_dir=folder / name,
        uploads_dir=folder / "uploads",
        database_url=database_url,
        connect=links,
        fleet={"name": name, "lease_s": LEASE_S},
    )


async def owned(service: Service) -> str:
    """Wait until this instance owns a vehicle that may be written to; its id."""
    adapter = service.jobs._vehicles

    def ready() -> bool:
        return any(
            v.writable().ok and adapter.vehicle(v.id).condition().conflict is None for v in service.vehicles.all()
        )

    await eventually(ready, 40.0)
    return service.vehicles.all()[0].id


async def until(service: Service, job_id: str, *states: JobState) -> None:
    async with asyncio.timeout(scaled(90)):
        while service.jobs.get(job_id).state not in states:  # noqa: ASYNC110 - the store wakes nobody here
            await asyncio.sleep(0.02)


async def main(folder: str, database_url: str, link: str, action: str, point: str, occurrence: str, how: str) -> None:
    left = int(occurrence)

    def reach(at: At) -> None:
        nonlocal left
        left -= at == At(point)
        if at == At(point) and left == 0:
            os.kill(os.getpid(), signal.Signals[how])

    async with running_service(settings(Path(folder), database_url, link, name="a"), reach=reach) as service:
        vehicle_id = await owned(service)
        if action == "apply":
            job = await service.jobs.submit(vehicle_id, "gyro", {"uncertainty": 0.02})
            await until(service, job.id, JobState.REVIEW, *ENDED)
            plan = service.jobs.get(job.id).plan
            assert plan is not None
            await service.jobs.apply(job.id, Accept(plan.sha256, prove_s=0.0))
            await until(service, job.id, *ENDED, JobState.IN_DOUBT)
            sys.stderr.write(f"{service.jobs.get(job.id).state}\n")
        await asyncio.sleep(3600.0)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
