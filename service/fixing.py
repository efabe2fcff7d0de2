"""Fixes of a preflight: runs and writes calibrations that need no hands, one after the other."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from mavcal.calib.firmware.options import key_text
from mavcal.calib.recording import Sensor
from mavcal.service.jobs.core.model import Accept, Failure, Job
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.jobs.engine import JobEngine


class Fixable(StrEnum):
    """Kinds of jobs that want nothing but a vehicle at rest."""

    GYRO = "gyro"
    LEVEL = "level"


WAIT_S = 120.0
"""How long a calibration at rest, or its write, may take."""
_LOOK_S = 0.1
LEFT = ENDED | {JobState.REVIEW, JobState.IN_DOUBT, JobState.WAITING_FOR_REBOOT}
"""States in which a job has ended or waits for a person."""


@dataclass(frozen=True)
class Fix:
    """Outcome of one calibration."""

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
        job, left = await _without_restart(engine, await wait_for_job(engine, job.id))
        if job.state == JobState.REVIEW and job.plan is not None and not job.plan.blockers and not left.all:
            accept = Accept(job.plan.sha256, prove_s=0.0, actor=actor)
            await engine.apply(job.id, accept)
            job = await wait_for_job(engine, job.id)
        done.append(Fix(kind, job.id, job.state, " ".join(filter(None, (_result_text(job, left), left.text)))))
        if job.state != JobState.SUCCEEDED:
            break
    await engine.wait_for_cleanup()
    return tuple(done)


class PlannedChange(Protocol):
    """A change of a plan, here or as a client of the service gets it."""

    @property
    def sensor(self) -> str | None:
        """See :class:`calib.firmware.plan.Change`."""

    @property
    def instance(self) -> int:
        """See :class:`calib.firmware.plan.Change`."""

    @property
    def needs_reboot(self) -> bool:
        """See :class:`calib.firmware.plan.Change`."""


@dataclass(frozen=True)
class Late:
    """Sensors left as they are, because their change would act only after a restart of the vehicle."""

    keys: tuple[str, ...] = ()
    at_once: tuple[str, ...] = ()
    """The others, if some have to wait."""
    all: bool = False
    """Whether none is left whose change acts at once."""

    @property
    def text(self) -> str:
        """A sentence on the sensors that were not calibrated; empty if all were."""
        if not self.keys:
            return ""
        stays = "stays as it is: its" if len(self.keys) == 1 else "stay as they are: their"
        return f"{', '.join(self.keys)} {stays} change would act only after a restart."


def late(changes: Sequence[PlannedChange]) -> Late:
    """Which sensors of a plan have to wait for a restart: nobody is there to restart a vehicle."""
    if not any(change.needs_reboot for change in changes):
        return Late()
    named = [(c.sensor, c.instance) for c in changes if c.sensor is not None]
    sensors = {(sensor, instance): key_text(Sensor(sensor), instance) for sensor, instance in named}
    waiting = {(c.sensor, c.instance) for c in changes if c.needs_reboot}
    at_once = tuple(text for key, text in sensors.items() if key not in waiting)
    return Late(tuple(text for key, text in sensors.items() if key in waiting), at_once, all=not at_once)


async def _without_restart(engine: JobEngine, job: Job) -> tuple[Job, Late]:
    """The job, planned for those sensors alone whose change acts at once."""
    if job.state != JobState.REVIEW or job.plan is None:
        return job, Late()
    left = late(job.plan.changes)
    if left.at_once:
        job = await engine.plan_again(job.id, {**job.context.get("plan_options", {}), "only": list(left.at_once)})
    return job, left


async def wait_for_job(engine: JobEngine, job_id: str) -> Job:
    """The job, once it has ended or waits for a person. Raises TimeoutError after :data:`WAIT_S`."""
    async with asyncio.timeout(WAIT_S):
        while engine.get(job_id).state not in LEFT:  # noqa: ASYNC110 - the engine wakes nobody for a state
            await asyncio.sleep(_LOOK_S)
    return engine.get(job_id)


def _result_text(job: Job, left: Late) -> str:
    if left.all:
        return "Nothing was written."
    if isinstance(job.outcome, Failure):
        return f"{job.outcome.cause} {job.outcome.remedy}".strip()
    if job.outcome is not None:
        return job.outcome.text
    blockers = job.plan.blockers if job.plan is not None else ()
    return f"not written: {'; '.join(blockers)}" if blockers else f"the job is {job.state.value}"
