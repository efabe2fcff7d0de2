"""Takes a job on the command line to its end: follow it, show its plan, confirm, write, print the outcome."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mavcal.service.commands.output import EXIT_NO, EXIT_PART, write_json
from mavcal.service.commands.place import place_of

if TYPE_CHECKING:
    from mavcal.calib.firmware.plan import WritePlan
    from mavcal.calib.preflight.readiness import Readiness
    from mavcal.client.jobs import JobModel, PlanModel
    from mavcal.service.commands.keyboard import Keyboard
    from mavcal.service.commands.screen import Screen
    from mavcal.service.core import Service
    from mavcal.service.jobs.core.model import Job
    from mavcal.service.settings import Settings
    from mavcal.service.unfinished import Unfinished
    from mavcal.service.vehicle import Vehicle

    Begin = Callable[[Service, Vehicle], Awaitable[Job]]
    """Makes the job, or takes up one that waits in review. Raises ServiceError."""

PATIENCE_S = 10.0
"""How long a write waits for the vehicle to be writable."""
YES = frozenset({"yes", "y"})


@dataclass(frozen=True)
class JobWish:
    """What a run of a command is to do with its job."""

    write: bool
    require_proof: bool = False
    reboot: bool = False
    wait_s: float = 30.0
    as_json: bool = False
    revert: bool = False
    """What the job has written is taken back."""


def run_job(settings: Settings, begin: Begin, wish: JobWish) -> int:
    """One job from `begin` to its end; the exit code."""
    from mavcal.service.commands.screen import Screen
    from mavcal.service.logs import configure_logging

    configure_logging(as_json=settings.log_json)
    job = asyncio.run(_job(settings, begin, wish, Screen(place_of(settings))))
    if isinstance(job, int):
        return job
    return exit_code(job, wish)


async def _job(settings: Settings, begin: Begin, wish: JobWish, screen: Screen) -> Job | int:
    """The job as it ended, or the exit code of a run that was told to stop."""
    from mavcal.service.commands.headless import earlier, heard, recovered, stoppable
    from mavcal.service.core import running_service

    with stoppable() as caught:
        try:
            async with running_service(settings) as service:
                left = earlier(service)
                vehicle = await heard(service, settings.connect[0], wish.wait_s, screen)
                screen.line(f"{vehicle.identity.autopilot} {vehicle.identity.version_text} as {vehicle.id}")
                resolved = await recovered(service, vehicle, left, screen)
                _require_resolved(resolved)
                return await _Run(service, vehicle, wish, screen).of(begin, resolved)
        except asyncio.CancelledError:
            if not caught:
                raise
            return 128 + caught[0]


def _require_resolved(resolved: Sequence[Unfinished]) -> None:
    """Raise PhysicalJobRunning, with every parameter, if an earlier job is still in doubt."""
    from mavcal.service.errors import PhysicalJobRunning
    from mavcal.service.unfinished import ending

    for found in resolved:
        if not found.ended:
            raise PhysicalJobRunning("; ".join(ending(found)) + ". Nothing new is begun until that is resolved.")


@dataclass(frozen=True)
class _Run:
    """One job of one vehicle, in a service that runs."""

    service: Service
    vehicle: Vehicle
    wish: JobWish
    screen: Screen

    async def of(self, begin: Begin, resolved: Sequence[Unfinished]) -> Job:
        from mavcal.service.api.views import job_model
        from mavcal.service.commands.headless import put_down, tidied, told_of
        from mavcal.service.commands.keyboard import keyboard

        after = self.service.store.last_event_id()
        job = await begin(self.service, self.vehicle)
        try:
            async with keyboard(self._answer(job.id)) as typed:
                job = await self._carried(job, after, typed)
        except asyncio.CancelledError:
            await put_down(self.service, job.id, self.screen)
            raise
        await tidied(self.service)
        job = self.service.jobs.get(job.id)  # what the vehicle says after a write is known only now
        if self.wish.as_json:
            write_json({**job_model(job).model_dump(), "recovered": [told_of(found) for found in resolved]})
        show_end(job, self.screen, written=self.wish.write)
        return job

    def _answer(self, job_id: str) -> Callable[[str], Any]:
        from mavcal.service.errors import ServiceError

        async def answer(line: str) -> None:
            try:
                await self.service.jobs.answer(job_id, line)
            except ServiceError as error:
                self.screen.line(f"    {error}")

        return answer

    async def _carried(self, job: Job, after: int, typed: Keyboard) -> Job:
        """The job, once nothing goes on with it by itself."""
        from mavcal.service.commands.headless import follow
        from mavcal.service.jobs.core.model import Accept
        from mavcal.service.jobs.core.states import ENDED, JobState

        jobs = self.service.jobs
        if job.state not in ENDED | {JobState.REVIEW}:
            job = await follow(self.service, job.id, self.screen, after)
        if job.state is not JobState.REVIEW or job.plan is None:
            return job
        show_plan(job.plan, self.screen)
        if self.wish.write:
            job = await self._confirmed(job, typed)
        if not self.wish.write or job.plan is None or job.plan.blockers:
            return job
        await writable(self.vehicle, self.wish.wait_s)
        after = self.service.store.last_event_id()
        await jobs.apply(job.id, Accept(job.plan.sha256, reboot=self.wish.reboot), look=True)
        return await follow(self.service, job.id, self.screen, after)

    async def _confirmed(self, job: Job, typed: Keyboard) -> Job:
        """The job, planned again with what the person at the terminal has confirmed; as it is if there is nobody."""
        from mavcal.calib.firmware.options import confirmations

        assert job.plan is not None
        names = confirmations(job.plan.blockers)
        if not names or not typed.there:
            return job
        self.screen.prompt("type yes to confirm this and write the plan; anything else leaves the vehicle as it is")
        if (await typed.asked()).lower() not in YES:
            return job
        options = {**job.context.get("plan_options", {}), **dict.fromkeys(names, True)}
        job = await self.service.jobs.plan_again(job.id, options)
        assert job.plan is not None
        show_plan(job.plan, self.screen)
        return job


async def writable(vehicle: Vehicle, wait: float) -> None:
    """Give the vehicle time to have been disarmed for long enough; what else stands in the way is said by apply."""
    with suppress(TimeoutError):
        async with asyncio.timeout(min(wait, PATIENCE_S)):
            while not vehicle.writable().ok:  # noqa: ASYNC110 - time alone changes it
                await asyncio.sleep(0.1)


def good(job: Job, write: bool, require_proof: bool) -> bool:
    """Whether the job has reached what was asked for."""
    from mavcal.service.jobs.core.model import Result
    from mavcal.service.jobs.core.proof import ProofLevel
    from mavcal.service.jobs.core.states import JobState

    if job.plan is not None and job.plan.blockers:
        return False
    if not write:
        return job.state in {JobState.REVIEW, JobState.SUCCEEDED}  # it succeeds at once where nothing is to be changed
    proved = isinstance(job.outcome, Result) and job.outcome.proof is ProofLevel.FULL
    unneeded = job.plan is not None and job.plan.nothing_to_write
    return job.state is JobState.SUCCEEDED and (proved or unneeded or not require_proof)


def exit_code(job: Job, wish: JobWish) -> int:
    """0 done, 1 the answer is no, 3 done in part: not of every sensor, or not with the whole proof."""
    from mavcal.service.jobs.core.model import Result
    from mavcal.service.jobs.core.proof import ProofLevel

    if wish.revert:
        return 0 if taken_back(job) else EXIT_NO
    if good(job, wish.write, wish.require_proof):
        return EXIT_PART if job.left_out else 0
    partly = isinstance(job.outcome, Result) and job.outcome.proof is ProofLevel.PARTIAL
    return EXIT_PART if partly and good(job, wish.write, require_proof=False) else EXIT_NO


def taken_back(job: Job) -> bool:
    """Whether what the job had written is gone."""
    from mavcal.service.jobs.core.states import JobState

    return job.state is JobState.REVERTED


def show_plan(plan: WritePlan | PlanModel, screen: Screen) -> None:
    """What is written, what is not, and what has to be confirmed first."""
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


def show_end(job: Job, screen: Screen, *, written: bool) -> None:
    """How the job ended; for one in review, how it is written later."""
    from mavcal.service.jobs.core.model import Failure
    from mavcal.service.jobs.core.states import JobState
    from mavcal.service.jobs.write.readiness import readiness_of

    if isinstance(job.outcome, Failure):
        screen.line(f"{job.state.value}: {job.outcome.cause} {job.outcome.remedy}", bold=True)
    elif job.outcome is not None:
        screen.line(f"{job.state.value}: {job.outcome.text}", bold=True)
        if written:
            screen.line(f"proof: {job.outcome.proof.value}")
        for open_still in job.outcome.unproved:
            screen.line(f"    {open_still.name} is not proved: {open_still.why}")
        show_left_out(job, screen)
        if written and job.state is JobState.SUCCEEDED and job.accept is not None:
            screen.line(f"this was job {job.id}: `mavcal revert {job.id}` takes it back")
        found = readiness_of(job)
        if found is not None:
            show_readiness(found, screen)
    elif job.plan is not None:
        show_left_out(job, screen)
        screen.line(_waiting(job, job.plan), bold=True)


def show_left_out(job: Job | JobModel, screen: Screen) -> None:
    """Which sensors got no new calibration, or only a part of it, and why."""
    from mavcal.calib.procedures.roster import label
    from mavcal.calib.recording import Sensor

    for out in job.left_out:
        screen.line(f"left out: {label(Sensor(out.sensor), out.instance)}: {out.reason}", bold=True)
    for out in job.broken:
        found = f"{label(Sensor(out.sensor), out.instance)}: {out.reason}"
        screen.line(f"fell out, though this job needs only its help: {found}", bold=True)


def show_readiness(found: Readiness, screen: Screen) -> None:
    """Whether the vehicle would arm now, and what stands against it."""
    screen.line(found.text, bold=True)
    for text in found.against:
        screen.line(f"    {text}")


def _waiting(job: Job, plan: WritePlan) -> str:
    """What becomes of a plan that was not written."""
    from mavcal.calib.firmware.options import PLAN_OPTIONS, confirmations

    asked = confirmations(plan.blockers)
    if plan.blockers and not asked:
        return "blocked: nothing was written, and this plan cannot be written"
    flags = "".join(f" --{PLAN_OPTIONS[name].flag}" for name in asked)
    begun = "it waits to be confirmed" if asked else "the plan is kept"
    return f"nothing was written; {begun}: `mavcal accept {job.id}{flags}` writes it"
