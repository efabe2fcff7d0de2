"""The interface to whatever keeps a record of ended jobs and preflights."""

from __future__ import annotations

from typing import Protocol

from mavcal.service.jobs.model import Job
from mavcal.service.jobs.preflight import Preflight


class JobRecord(Protocol):
    """Keeps a record beside the jobs; it fails without harm to them."""

    def job_ended(self, job: Job) -> None:
        """A job's task is over, whatever came of it."""
        ...

    async def keep_preflight(self, found: Preflight) -> Preflight:
        """The report as it is told, with a note if it could not be kept."""
        ...


class NoRecord:
    """Keeps nothing."""

    def job_ended(self, job: Job) -> None:
        """See JobRecord."""

    async def keep_preflight(self, found: Preflight) -> Preflight:
        """See JobRecord."""
        return found
