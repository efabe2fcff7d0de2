"""Calibrates a resting vehicle over the client: runs, plans without changes that need a restart, and writes."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial

from mavcal.client import AsyncClient
from mavcal.client.jobs import JobModel
from mavcal.service.commands.door import Door
from mavcal.service.commands.headless import Begun, begun_by, leave_job, state_of
from mavcal.service.commands.plan_options import options_of_plan
from mavcal.service.commands.screen import Screen
from mavcal.service.fixing import LEFT, WAIT_S, Late, late
from mavcal.service.jobs.core.states import JobState

_LOOK_S = 0.1


@dataclass(frozen=True)
class Mended:
    """Outcome of one calibration."""

    job: JobModel
    text: str
    in_part: bool
    """Whether a sensor was left out, or has to wait for a restart."""


async def mended(door: Door, vehicle_id: str, kind: str, screen: Screen, *, look: bool) -> Mended:
    """Run and write one kind of calibration; `look`: look at the vehicle after the write.

    Raises
    ------
    VehicleError, PhysicalJobRunning, PreflightRunning, Forbidden
        As for :meth:`service.jobs.engine.JobEngine.submit` and ``apply``.
    """
    client, left = door.client, Late()

    async def begin() -> Begun:
        return Begun(await client.start_job(vehicle_id, kind=kind))

    async with begun_by(begin(), partial(leave_job, door, screen)) as begun:
        job = await wait_for_job(client, begun.job.id)
        if state_of(job) is JobState.REVIEW and job.plan is not None:
            left = late(job.plan.changes)
            if left.at_once:
                options = options_of_plan({**job.plan_options, "only": list(left.at_once)})
                await client.renew_plan(job.id, plan_options=options)
                job = await client.get_job(job.id)
        if state_of(job) is JobState.REVIEW and job.plan is not None and not job.plan.blockers and not left.all:
            await client.apply_plan(job.id, plan_sha256=job.plan.sha256, prove_s=0.0, preflight=look)
            await wait_for_job(client, job.id)
    await door.wait_for_cleanup(written=job.id if look else None)
    job = await client.get_job(job.id)  # what the vehicle says after a write is known only now
    text = " ".join(filter(None, ("Nothing was written." if left.all else outcome_text(job), left.text)))
    return Mended(job, text, bool(job.left_out or left.keys))


async def wait_for_job(client: AsyncClient, job_id: str) -> JobModel:
    """The job, once it has ended or waits for a person. Raises TimeoutError after two minutes."""
    async with asyncio.timeout(WAIT_S):
        while state_of(job := await client.get_job(job_id)) not in LEFT:  # noqa: ASYNC110 - another process may run it
            await asyncio.sleep(_LOOK_S)
    return job


def outcome_text(job: JobModel) -> str:
    """Words for the outcome of a job, or for the objection to its plan."""
    if job.outcome is not None and job.outcome.kind == "result":
        return job.outcome.text
    if job.outcome is not None:
        return f"{job.outcome.cause} {job.outcome.remedy}".strip()
    blockers = job.plan.blockers if job.plan is not None else []
    return f"not written: {'; '.join(blockers)}" if blockers else f"the job is {job.state.value}"
