"""Campaigns through vehicles: a preflight of each, or a calibration or a restore of each as a job of its own."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from mavcal.calib.preflight.check import Verdict
from mavcal.service.campaigns.campaigns import ItemTurn
from mavcal.service.campaigns.items import BEGUN_BY, Item, ItemEnd, ItemOutcome, begun_by
from mavcal.service.errors import ServiceError, VehicleUnknown
from mavcal.service.jobs.core.codec import to_json
from mavcal.service.jobs.core.model import Accept, Failure, Job, Unwritten
from mavcal.service.jobs.core.states import CANCELLABLE, ENDED, WRITING, JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.preflights import Preflight
from mavcal.service.vehicle.job_vehicle import VehicleSource

VEHICLES_AT_ONCE = 32
"""Vehicles that all campaigns together work with at a time."""
DOUBT_S = 120.0
"""How long an item waits for a write in doubt; the job itself goes on until it is resolved."""
_LOOK_S = 0.1
_FOR_A_PERSON = frozenset({JobState.WAITING_FOR_OPERATOR, JobState.WAITING_FOR_REBOOT})
_LOST = frozenset({JobState.CANCELLED, JobState.INTERRUPTED})
"""States in which a job of a stopped service is lost, so that the item begins again."""

_OUTCOMES = {Verdict.PASS: ItemOutcome.DONE, Verdict.FAIL: ItemOutcome.REFUSED}
"""Outcome by the verdict of a preflight; any other verdict warns."""


@dataclass(frozen=True)
class Patience:
    """Gives vehicles time to be heard again after a restart of the service."""

    source: VehicleSource
    return_s: float
    clock: Callable[[], float] = time.monotonic

    async def back(self, vehicle_id: str, *, writable: bool = False) -> None:
        """Wait until the vehicle is heard and may be written to, or until the time is over."""
        deadline = self.clock() + self.return_s
        while self.clock() < deadline:
            with suppress(VehicleUnknown):
                condition = self.source.vehicle(vehicle_id).condition()
                if not condition.silent and not (writable and condition.obstacles):
                    return
            await asyncio.sleep(_LOOK_S)


@dataclass
class PreflightWork:
    """A preflight of each vehicle; nothing is written."""

    engine: JobEngine
    patience: Patience
    lane: asyncio.Semaphore
    most_starts: int | None = None

    async def run(self, turn: ItemTurn) -> ItemEnd:
        """See ItemWork."""
        vehicle_id = turn.item.subject
        if turn.again:
            await self.patience.back(vehicle_id)
        return of_preflight(await self.engine.preflight(vehicle_id))

    async def cancelled(self, turn: ItemTurn) -> str:
        """See ItemWork."""
        return "The campaign was cancelled. Nothing was written."


def of_preflight(found: Preflight) -> ItemEnd:
    """The outcome of an item with this report."""
    verdict = found.report.verdict
    outcome = _OUTCOMES.get(verdict, ItemOutcome.WARNED)
    return ItemEnd(outcome, found.report.summary, verdict.value, result={"preflight": to_json(found)})


@dataclass
class CalibrationWork:
    """A calibration of each vehicle; its plan is accepted if the campaign was begun with `apply`.

    Options: `kind`, `options`, `plan_options`, `apply`, `reboot`, `actor`.
    """

    engine: JobEngine
    patience: Patience
    lane: asyncio.Semaphore
    most_starts: int | None = None
    doubt_s: float = DOUBT_S

    async def run(self, turn: ItemTurn) -> ItemEnd:
        """See ItemWork."""
        job = self._begun(turn) if turn.again else None
        if job is None or job.state in _LOST:
            job = await self._begin(turn)
        job = await self._settled(job.id, turn)
        return await self._written(job, turn) if turn.options.get("apply") else of_job(job)

    async def cancelled(self, turn: ItemTurn) -> str:
        """See ItemWork."""
        job = self._begun(turn)
        if job is None:
            return "The campaign was cancelled. Nothing was begun."
        if job.state in CANCELLABLE - {JobState.REVIEW}:
            await self.engine.cancel(job.id)
            return f"The campaign was cancelled, and job {job.id} with it. Nothing was written."
        goes_on = ": it goes on by itself" if job.state in WRITING else ""
        return f"The campaign was cancelled. Job {job.id} is {_worded(job.state)}{goes_on}."

    async def _begin(self, turn: ItemTurn) -> Job:
        order = turn.options
        if turn.again:
            await self.patience.back(turn.item.subject)
        options, plan_options = order.get("options", {}), order.get("plan_options", {})
        kind, begun_by = order["kind"], _begun_by(turn)
        return await self.engine.submit(turn.item.subject, kind, options, plan_options, begun_by=begun_by)

    def _begun(self, turn: ItemTurn) -> Job | None:
        return newest_of_item(self.engine.list(), turn.campaign.id, turn.item)

    async def _settled(self, job_id: str, turn: ItemTurn) -> Job:
        """The job, once it has ended, or waits in review, or has been in doubt for long."""
        doubtful: float | None = None
        while (job := self.engine.get(job_id)).state not in ENDED | {JobState.REVIEW}:
            if job.state in _FOR_A_PERSON:
                await turn.place.wait_for_person()
            if job.state != JobState.IN_DOUBT:
                doubtful = None
            elif doubtful is None:
                doubtful = self.patience.clock()
            elif self.patience.clock() - doubtful > self.doubt_s:
                return job
            await asyncio.sleep(_LOOK_S)
        return job

    async def _written(self, job: Job, turn: ItemTurn) -> ItemEnd:
        """Accept the plan of a job in review, once, and once more after a kill before anything was sent; its end."""
        reason = _unwritten(job, reboot=bool(turn.options.get("reboot")))
        tried = job.last_write is not None and not (turn.again and _was_cut_short(job))
        if job.state != JobState.REVIEW or tried or reason:
            return of_job(job, reason)
        assert job.plan is not None
        reboot, actor = bool(turn.options.get("reboot")), str(turn.options.get("actor", "operator"))
        accept = Accept(job.plan.sha256, reboot=reboot, prove_s=0.0, actor=actor)
        if turn.again:
            await self.patience.back(turn.item.subject, writable=True)
        try:
            await self.engine.apply(job.id, accept)
        except ServiceError as error:
            return of_job(self.engine.get(job.id), f"Not written: {error}")
        return of_job(await self._settled(job.id, turn))


@dataclass
class RestoreWork(CalibrationWork):
    """Restores the last verified calibration of each vehicle. Options: `plan_options`, `apply`, `reboot`, `actor`."""

    async def _begin(self, turn: ItemTurn) -> Job:
        if turn.again:
            await self.patience.back(turn.item.subject)
        plan_options = turn.options.get("plan_options", {})
        return await self.engine.restore(turn.item.subject, plan_options, begun_by=_begun_by(turn))


def newest_of_item(jobs: Sequence[Job], campaign_id: str, item: Item) -> Job | None:
    """The newest of `jobs` (oldest first) that was begun for an item; None: there is none."""
    ours = begun_by(campaign_id, item)
    return next((job for job in reversed(jobs) if job.context.get(BEGUN_BY) == ours), None)


def _begun_by(turn: ItemTurn) -> dict[str, Any]:
    return {BEGUN_BY: begun_by(turn.campaign.id, turn.item)}


def of_job(job: Job, reason: str = "") -> ItemEnd:
    """The outcome of an item with this job; `reason` says why its plan was not written."""
    outcome = _of_state(job.state)
    code = job.outcome.code if isinstance(job.outcome, Failure) else job.state.value
    return ItemEnd(outcome, _outcome_text(job, reason), code, job.id)


def _of_state(state: JobState) -> ItemOutcome:
    if state == JobState.SUCCEEDED:
        return ItemOutcome.DONE
    if state == JobState.REVIEW:
        return ItemOutcome.REVIEW
    if state == JobState.CANCELLED:
        return ItemOutcome.CANCELLED
    return ItemOutcome.IN_DOUBT if state in WRITING else ItemOutcome.REFUSED


def _outcome_text(job: Job, reason: str) -> str:
    if isinstance(job.outcome, Failure):
        cause = job.outcome.cause[:1].upper() + job.outcome.cause[1:]
        return " ".join(filter(None, (reason, cause, job.outcome.remedy)))
    if job.outcome is not None:
        return job.outcome.text
    if job.state == JobState.REVIEW:
        count = 0 if job.plan is None else len(job.plan.changes)
        waits = f"A plan of {count} parameter{'' if count == 1 else 's'} waits in review. Nothing was written."
        return f"{reason} {waits}".strip()
    return f"Job {job.id} is {_worded(job.state)}."


def _was_cut_short(job: Job) -> bool:
    """Whether the write ended with the service, before its first PARAM_SET."""
    return isinstance(job.outcome, Unwritten) and job.outcome.code == "interrupted"


def _worded(state: JobState) -> str:
    return state.value.replace("_", " ")


def _unwritten(job: Job, *, reboot: bool) -> str:
    """Why the plan of a job in review is left for a person; empty: it is not."""
    if job.state != JobState.REVIEW or job.plan is None:
        return ""
    if job.plan.blockers:
        return f"It is not to be written as it is: {'; '.join(job.plan.blockers)}."
    if job.plan.needs_reboot and not reboot:
        return "It acts only after a restart of the vehicle, which this campaign may not command."
    return ""
