"""Review of a job's plan for a person."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from markupsafe import Markup

from mavcal.calib.firmware.plan import WritePlan
from mavcal.calib.review.criteria import Criterion, criteria_of
from mavcal.calib.review.effect import SensorEffect, effects_of, headline_of
from mavcal.calib.review.mountings import MountingChoice, StatedMounting, choices_of, mountings_of
from mavcal.calib.review.picture import picture_of
from mavcal.service.errors import PlanMissing
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.store.sql import Store


@dataclass(frozen=True, eq=False)
class Review:
    """What a plan does, what speaks for and against it, and the picture of both; None: there is nothing to draw."""

    headline: str
    effects: tuple[SensorEffect, ...]
    criteria: tuple[Criterion, ...]
    picture: Markup | None
    mountings: tuple[StatedMounting, ...]
    mounting_choices: tuple[MountingChoice, ...]


async def review_of(job: Job, store: Store, *, columns: int | None = None) -> Review:
    """The review of a job's plan, on the parameters that it was composed on; `columns` charts of its picture a row.

    Raises
    ------
    PlanMissing
        If the job has no plan.
    """
    if job.plan is None:
        raise PlanMissing(f"job {job.id} is {job.state} and has no plan to review")
    return await asyncio.to_thread(reviewed, job, job.plan, store, columns)


def reviewed(job: Job, plan: WritePlan, store: Store, columns: int | None = None) -> Review:
    """The same; reads the store, so not for the event loop."""
    kept = store.snapshot(job.id, SnapshotPurpose.COMPOSED_ON)
    parameters = {} if kept is None else kept.body
    effects = effects_of(job.results, plan, parameters)
    mountings = mountings_of(job.results, plan, parameters, job.context.get("plan_options", {}))
    headline = headline_of(effects, done=job.state == JobState.SUCCEEDED)
    return Review(
        headline,
        effects,
        criteria_of(job.results, plan, job.options),
        picture_of(effects, headline, columns),
        mountings,
        choices_of(plan.fingerprint.autopilot) if mountings else (),
    )
