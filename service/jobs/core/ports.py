"""Interfaces that the engine needs: ownership of jobs, and a record of jobs that ended."""

from __future__ import annotations

from typing import Protocol

from mavcal.service.jobs.core.model import Job
from mavcal.service.preflights import Preflight
from mavcal.service.store.sql import Store


class Ownership(Protocol):
    """Says which jobs are ours, and lets only us change them."""

    shared: bool
    """Whether there may be other instances."""

    async def begin(self, job: Job) -> None:
        """Make a new job ours before anything of it is kept. Raises LeaseLost if that cannot be."""

    def store_of(self, job: Job) -> Store:
        """The store in which this job is changed: it refuses once the job is not ours any more. Raises LeaseLost."""

    def ended(self, job: Job) -> None:
        """The task of a job is over."""

    def changed(self) -> None:
        """An event of a job of ours was kept; from any thread."""


class Alone:
    """One process owns every job of its store."""

    shared = False

    def __init__(self, store: Store) -> None:
        self._store = store

    async def begin(self, job: Job) -> None:
        """Do nothing: every job is ours."""

    def store_of(self, _job: Job) -> Store:
        """The store itself."""
        return self._store

    def ended(self, job: Job) -> None:
        """Do nothing."""

    def changed(self) -> None:
        """Do nothing: subscribers in this process have been notified."""


class JobRecord(Protocol):
    """Keeps a record beside the jobs; it fails without harm to them."""

    def job_ended(self, job: Job) -> None:
        """Called when a job's task is over, whatever its outcome."""

    async def keep_preflight(self, found: Preflight) -> Preflight:
        """The report as it is sent, with a note if it could not be kept."""
