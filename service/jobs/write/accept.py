"""Acceptance of a plan: whether it may be written, who accepted it, and under which idempotency key."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

from mavcal.service.errors import IdempotencyConflict, IllegalTransition, PlanBlocked, PlanChanged, PlanMissing
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store.sql import Store


class Acceptance:
    """Stores accepts before they are carried out."""

    def __init__(self, store: Store, wall: Callable[[], float]) -> None:
        self._store = store
        self._wall = wall
        self._claims: set[str] = set()

    @contextmanager
    def claimed(self, job_id: str) -> Iterator[None]:
        """Block other writes of the same job while its accept is being stored."""
        if job_id in self._claims:
            raise IllegalTransition(f"job {job_id} is being accepted or taken back already")
        self._claims.add(job_id)
        try:
            yield
        finally:
            self._claims.discard(job_id)

    async def known(self, key: str | None, digest: str, job: Callable[[], Job]) -> bool:
        """Whether this request was accepted before, and its write was done or is under way.

        A key is bound to what was done, not to what was requested. A write that ended without a single PARAM_SET is
        back in review, and its key is free again. Otherwise a client that names its accept by the plan could never
        retry.

        Parameters
        ----------
        key, digest
            Of the request; without a key every request is new.
        job
            The job as it is now.

        Raises
        ------
        IdempotencyConflict
            If the key was used for another request.
        """
        if key is None:
            return False
        used = await self._store.do(partial(self._store.idempotency_key, key))
        if used is None:
            return False
        asked = job()
        if used[1] == asked.id and asked.state == JobState.REVIEW and asked.id not in self._claims:
            await self._store.do(partial(self._store.release_idempotency_key, key))
            return False
        if used != (digest, asked.id):
            raise IdempotencyConflict
        return True

    async def use(self, key: str | None, digest: str, job_id: str) -> None:
        """Store that the key was used for this request."""
        if key is not None:
            await self._store.do(partial(self._store.claim_idempotency_key, key, digest, job_id, self._wall()))

    async def note(self, actor: str, action: str, job_id: str, detail: Mapping[str, Any]) -> None:
        """Store who asked for a write, before it is done. Raises DiskFull."""
        await self._store.do(partial(self._store.add_audit, self._wall(), actor, action, job_id, detail))


def require_acceptable(job: Job, accept: Accept) -> None:
    """Raise the JobError that prevents the write of the job's plan."""
    if job.state != JobState.REVIEW:
        raise IllegalTransition(f"job {job.id} is {job.state}: only a job in review can be applied")
    if job.plan is None:
        raise PlanMissing
    if accept.plan_sha256 != job.plan.sha256:
        raise PlanChanged("this is not the digest of the job's plan: look at the plan again, then accept that one")
    if job.plan.blockers:
        raise PlanBlocked("the plan may not be written: " + "; ".join(job.plan.blockers))
    if not job.plan.changes:
        raise PlanBlocked("there is nothing to write: the vehicle holds these values already")


def request_digest(job_id: str, accept: Accept) -> str:
    """Digest of an apply request, for its idempotency key."""
    asked = [job_id, accept.plan_sha256, accept.reboot, accept.prove_s]
    return hashlib.sha256(json.dumps(asked).encode()).hexdigest()
