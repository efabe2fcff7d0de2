"""Calibrations that need no hands, run and written one after the other: what a preflight can mend by itself."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from mavcal.service.jobs.engine import JobEngine
from mavcal.service.jobs.model import Accept, Failure, Job
from mavcal.service.jobs.states import ENDED, JobState


class Fixable(StrEnum):
    """Kinds of jobs that want nothing but a vehicle at rest."""

    GYRO = "gyro"
    LEVEL = "level"


WAIT_S = 120.0
"""How long a calibration at rest, or its write, may take."""
_LOOK_S = 0.1
_LEFT = ENDED | {JobState.REVIEW, JobState.IN_DOUBT, JobState.WAITING_FOR_REBOOT}
"""States from which a job does not go on without somebody."""


@dataclass(frozen=True)
class Fix:
    """What came of one calibration."""

    kind: Fixable
    job_id: str
    state: JobState
    text: str


async def fixed(engine: JobEngine, vehicle_id: str, kinds: Sequence[Fixable], *, actor: str) -> tuple[Fix, ...]:
    """Run and write each kind once; the first one that does not succeed is the last.

    Raises
    ------
    VehicleError, PhysicalJobRunning, PreflightRunning, Forbidden
        As for :meth:`service.jobs.engine.JobEngine.submit` and ``apply``.
    """
    done: list[Fix] = []
    for kind in dict.fromkeys(kinds):
        job = await engine.submit(vehicle_id, kind.value)
        job = await _settled(engine, job.id)
        if job.state == JobState.REVIEW and job.plan is not None and not job.plan.blockers:
            accept = Accept(job.plan.sha256, prove_s=0.0, actor=actor)
            await engine.apply(job.id, accept)
            job = await _settled(engine, job.id)
        done.append(Fix(kind, job.id, job.state, _told(job)))
        if job.state != JobState.SUCCEEDED:
            break
    await engine.tidied()
    return tuple(done)


async def _settled(engine: JobEngine, job_id: str) -> Job:
    async with asyncio.timeout(WAIT_S):
        while engine.get(job_id).state not in _LEFT:  # noqa: ASYNC110 - the engine wakes nobody for a state
            await asyncio.sleep(_LOOK_S)
    return engine.get(job_id)


def _told(job: Job) -> str:
    if isinstance(job.outcome, Failure):
        return f"{job.outcome.cause} {job.outcome.remedy}".strip()
    if job.outcome is not None:
        return job.outcome.text
    blockers = job.plan.blockers if job.plan is not None else ()
    return f"not written: {'; '.join(blockers)}" if blockers else f"the job is {job.state.value}"
