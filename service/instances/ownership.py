"""Jobs by lease: those of a vehicle go with it, a job without a vehicle has a lease of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

from mavcal.service.errors import LeaseLost, StoreError
from mavcal.service.instances.leases import Leases
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import ENDED
from mavcal.service.store.sql import Store


def vehicle_subject(vehicle_id: str) -> str:
    """What is leased of a vehicle."""
    return f"vehicle:{vehicle_id}"


def link_subject(link_id: str) -> str:
    """What is leased of a link."""
    return f"link:{link_id}"


def job_subject(job: Job) -> str:
    """What must be held for a job to be ours."""
    return f"job:{job.id}" if job.vehicle_id is None else vehicle_subject(job.vehicle_id)


class LeasedJobs:
    """See :class:`service.jobs.core.ports.Ownership`.

    Parameters
    ----------
    leases
        What this instance holds.
    store
        The store of all instances.
    news
        Called from any thread when an event was kept.
    """

    shared = True

    def __init__(self, leases: Leases, store: Store, news: Callable[[], None]) -> None:
        self._leases, self._store = leases, store
        self.changed = news
        self._ending: set[asyncio.Task[None]] = set()

    async def begin(self, job: Job) -> None:
        """See Ownership."""
        subject = job_subject(job)
        if job.vehicle_id is None and not await asyncio.to_thread(self._leases.acquire, subject):
            raise LeaseLost(f"{subject} is owned by another instance")

    def store_of(self, job: Job) -> Store:
        """See Ownership."""
        return self._store.fenced(self._leases.fence(job_subject(job)))

    def ended(self, job: Job) -> None:
        """See Ownership: a job without a vehicle needs its lease no more once all of it is kept."""
        if job.vehicle_id is None and job.state in ENDED:
            task = asyncio.get_running_loop().create_task(self._give_back(job_subject(job)))
            self._ending.add(task)
            task.add_done_callback(self._ending.discard)

    def doubted(self, vehicle_id: str) -> str | None:
        """Why a vehicle may not be written to by this instance now; None: it may."""
        if self._leases.holds(vehicle_subject(vehicle_id)):
            return None
        return "another instance of the service owns this vehicle, or this one could not renew its lease"

    async def _give_back(self, subject: str) -> None:
        with suppress(StoreError, RuntimeError):  # the service is stopping, or the database is away: it then runs out
            await self._store.do(lambda: self._leases.release(subject))
