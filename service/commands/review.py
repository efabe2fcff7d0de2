"""Takes a job on the command line to its end: follow it, show its plan, confirm, write, print the outcome."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from mavcal.service.commands.output import EXIT_NO, EXIT_PART, write_json

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.client.enums import ProofLevel
    from mavcal.client.jobs import JobModel, PlanModel, VehicleReadinessModel
    from mavcal.client.models import UnfinishedModel, VehicleModel
    from mavcal.service.commands.door import Door
    from mavcal.service.commands.headless import Begun
    from mavcal.service.commands.keyboard import Keyboard
    from mavcal.service.commands.screen import Screen
    from mavcal.service.commands.whom import Whom

    Begin = Callable[[AsyncClient, VehicleModel], Awaitable[Begun]]
    """Makes the job, or takes one up. Raises ServiceError."""

PATIENCE_S = 10.0
"""Longest wait of a write for the vehicle to be writable, s."""
YES = frozenset({"yes", "y"})


@dataclass(frozen=True)
class JobWish:
    """Options of a command for its job: write or take back, need a proof, allow a restart, print JSON."""

    write: bool
    require_proof: bool = False
    reboot: bool = False
    as_json: bool = False
    revert: bool = False
    """Whether what the job has written is taken back."""


def run_job(whom: Whom, begin: Begin, wish: JobWish, job_id: str | None = None) -> int:
    """One job from `begin` to its end, or the one that is there already; the exit code."""
    from mavcal.service.commands.door import OPERATOR, through_door
    from mavcal.service.commands.screen import Screen

    what = partial(_job, whom=whom, begin=begin, wish=wish, screen=Screen(whom.place), job_id=job_id)
    job = through_door(whom, what, OPERATOR)
    if isinstance(job, int):
        return job
    return exit_code(job, wish)


async def _job(
    at: Door, *, whom: Whom, begin: Begin, wish: JobWish, screen: Screen, job_id: str | None = None
) -> JobModel:
    """The job as it ended."""
    from mavcal.service.commands.headless import left_over, recovered
    from mavcal.service.commands.vehicles import vehicle_of

    left = await left_over(at)
    vehicle = await vehicle_of(at, whom, screen, job_id)
    screen.line(f"{vehicle.autopilot} {vehicle.firmware} as {vehicle.id}")
    resolved = await recovered(at, vehicle, left, screen)
    _require_resolved(resolved)
    return await _Run(at, vehicle, wish, screen, whom.wait_s).of(begin, resolved)


def _require_resolved(resolved: Sequence[UnfinishedModel]) -> None:
    """Raise PhysicalJobRunning, with every parameter, if an earlier job is still in doubt."""
    from mavcal.service.errors import PhysicalJobRunning

    for found in resolved:
        if not found.ended:
            raise PhysicalJobRunning("; ".join(found.ending) + ". Nothing new is begun until that is resolved.")


async def job_of(client: AsyncClient, job_id: str, whom: Whom, vehicle: VehicleModel) -> JobModel:
    """The job of that id. Raises OtherVehicle if it is not of the vehicle at this endpoint."""
    from mavcal.service.commands.headless import is_of
    from mavcal.service.errors import OtherVehicle

    job = await client.get_job(job_id)
    if not await is_of(client, job, vehicle):
        there = whom.url or whom.urls[0]
        raise OtherVehicle(f"job {job_id} belongs to {job.vehicle_id}, but {there} leads to {vehicle.id}")
    return job


@dataclass(frozen=True)
class _Run:
    """One job of one vehicle, in a service that runs."""

    door: Door
    vehicle: VehicleModel
    wish: JobWish
    screen: Screen
    wait_s: float = 30.0

    @property
    def client(self) -> AsyncClient:
        return self.door.client

    async def of(self, begin: Begin, resolved: Sequence[UnfinishedModel]) -> JobModel:
        from mavcal.service.commands.headless import answering, begun_by, leave_job, recovery_document
        from mavcal.service.commands.keyboard import keyboard

        async with (
            begun_by(begin(self.client, self.vehicle), partial(leave_job, self.door, self.screen)) as begun,
            keyboard(answering(self.client, begun.job.id, self.screen)) as typed,
        ):
            await self._carried(begun.job, begun.since, typed)
        await self.door.wait_for_cleanup(written=begun.job.id)
        job = await self.client.get_job(begun.job.id)  # what the vehicle says after a write is known only now
        if self.wish.as_json:
            write_json({**job.model_dump(), "recovered": [recovery_document(found) for found in resolved]})
        show_end(job, self.screen, written=self.wish.write)
        return job

    async def _carried(self, job: JobModel, since: float, typed: Keyboard) -> None:
        """Follow the job until it ends or waits for a person."""
        from mavcal.client.enums import JobState
        from mavcal.service.commands.headless import follow, rests

        if not rests(job):
            job = await follow(self.client, job.id, self.screen, since)
        if job.state != JobState.REVIEW or job.plan is None:
            return
        show_plan(job.plan, self.screen)
        if self.wish.write:
            job = await self._confirmed(job, job.plan, typed)
        if not self.wish.write or job.plan is None or job.plan.blockers:
            return
        await writable(self.client, self.vehicle, self.wait_s)
        since = (await self.client.get_job(job.id)).updated_at
        await self.client.apply_plan(job.id, plan_sha256=job.plan.sha256, reboot=self.wish.reboot)
        await follow(self.client, job.id, self.screen, since)

    async def _confirmed(self, job: JobModel, plan: PlanModel, typed: Keyboard) -> JobModel:
        """The job, planned again with what the person at the terminal has confirmed; as it is if there is nobody."""
        from mavcal.calib.firmware.options import confirmations
        from mavcal.service.commands.plan_options import options_of_plan

        names = confirmations(plan.blockers)
        if not names or not typed.there:
            return job
        self.screen.prompt("type yes to confirm this and write the plan; anything else leaves the vehicle as it is")
        if (await typed.asked()).lower() not in YES:
            return job
        options = options_of_plan({**job.plan_options, **dict.fromkeys(names, True)})
        show_plan(await self.client.renew_plan(job.id, plan_options=options), self.screen)
        return await self.client.get_job(job.id)


async def writable(client: AsyncClient, vehicle: VehicleModel, wait: float) -> None:
    """Give the vehicle time to have been disarmed for long enough; other obstacles are reported by apply."""
    with suppress(TimeoutError):
        async with asyncio.timeout(min(wait, PATIENCE_S)):
            while not (await client.get_vehicle(vehicle.id)).writable:  # noqa: ASYNC110 - time alone changes it
                await asyncio.sleep(0.1)


def good(job: JobModel, write: bool, require_proof: bool) -> bool:
    """Whether the job has reached what was asked for."""
    from mavcal.client.enums import JobState, ProofLevel

    if job.plan is not None and job.plan.blockers:
        return False
    if not write:
        return job.state in {JobState.REVIEW, JobState.SUCCEEDED}  # it succeeds at once where nothing is to be changed
    unneeded = job.plan is not None and not job.plan.changes
    return job.state == JobState.SUCCEEDED and (_proof(job) == ProofLevel.FULL or unneeded or not require_proof)


def exit_code(job: JobModel, wish: JobWish) -> int:
    """0 done, 1 the answer is no, 3 done in part: not of every sensor, or not with the whole proof."""
    from mavcal.client.enums import ProofLevel

    if wish.revert:
        return 0 if taken_back(job) else EXIT_NO
    if good(job, wish.write, wish.require_proof):
        return EXIT_PART if job.left_out else 0
    partly = _proof(job) == ProofLevel.PARTIAL
    return EXIT_PART if partly and good(job, wish.write, require_proof=False) else EXIT_NO


def _proof(job: JobModel) -> ProofLevel | None:
    """Level of proof by the streams; None: the job has no result."""
    return job.outcome.proof if job.outcome is not None and job.outcome.kind == "result" else None


def taken_back(job: JobModel) -> bool:
    """Whether what the job had written is gone."""
    from mavcal.client.enums import JobState

    return job.state == JobState.REVERTED


def show_plan(plan: PlanModel, screen: Screen) -> None:
    """Print the notes on a plan, what has to be confirmed first, its changes, and what cannot be held."""
    from mavcal.calib.firmware.options import confirmations
    from mavcal.calib.firmware.values import shown

    stands = "to be confirmed" if confirmations(plan.blockers) else "will not be written"
    for text in (*plan.warnings, *(f"{stands}: {b}" for b in plan.blockers)):
        screen.line(f"    note: {text}")
    for change in plan.changes:
        old = "-" if change.old is None else shown(change.old, 6)
        sd = "" if change.sd is None else f" +- {change.sd:.2g}"
        screen.line(f"    {change.name:18} {old:>12} -> {shown(change.new, 6)}{sd} {change.unit}".rstrip())
    for loss in plan.losses:
        screen.line(f"    cannot be held: {loss.text} ({loss.cost:.3g} {loss.unit})")


def show_end(job: JobModel, screen: Screen, *, written: bool) -> None:
    """Print the end of the job; for one in review, the command that writes it later."""
    from mavcal.client.enums import JobState

    outcome = job.outcome
    if outcome is None:
        if job.plan is not None:
            show_left_out(job, screen)
            screen.line(_waiting(job, job.plan), bold=True)
        return
    if outcome.kind != "result":
        screen.line(f"{job.state.value}: {outcome.cause} {outcome.remedy}", bold=True)
    else:
        screen.line(f"{job.state.value}: {outcome.text}", bold=True)
        if written:
            screen.line(f"proof: {outcome.proof.value}")
        for open_still in outcome.unproved:
            screen.line(f"    {open_still.name} is not proved: {open_still.why}")
        show_left_out(job, screen)
        if written and job.state == JobState.SUCCEEDED and job.last_write is not None:
            screen.line(f"this was job {job.id}: `mavcal revert {job.id}` takes it back")
        if job.readiness is not None:
            show_readiness(job.readiness, screen)


def show_left_out(job: JobModel, screen: Screen) -> None:
    """Print the sensors that got no new calibration, or a part of it, with the reasons."""
    from mavcal.calib.procedures.roster import label
    from mavcal.calib.recording import Sensor

    for out in job.left_out:
        screen.line(f"left out: {label(Sensor(out.sensor), out.instance)}: {out.reason}", bold=True)
    for out in job.broken:
        found = f"{label(Sensor(out.sensor), out.instance)}: {out.reason}"
        screen.line(f"fell out, though this job needs only its help: {found}", bold=True)


def show_readiness(found: VehicleReadinessModel, screen: Screen) -> None:
    """Whether the vehicle would arm now, and what stands against it."""
    screen.line(found.text, bold=True)
    for text in found.against:
        screen.line(f"    {text}")


def _waiting(job: JobModel, plan: PlanModel) -> str:
    """Words for a plan that was not written, with the command that writes it."""
    from mavcal.calib.firmware.options import PLAN_OPTIONS, confirmations

    asked = confirmations(plan.blockers)
    if plan.blockers and not asked:
        return "blocked: nothing was written, and this plan cannot be written"
    flags = "".join(f" --{PLAN_OPTIONS[name].flag}" for name in asked)
    begun = "it waits to be confirmed" if asked else "the plan is kept"
    return f"nothing was written; {begun}: `mavcal accept {job.id}{flags}` writes it"
