"""Writes an accepted plan, to its end.

.. code-block:: text

    prepare ─> send_all ─> read_back ─> (restart) ─> check ─> finish ─> succeeded
       │           └───────────┴────────────┴──────────┴─────────┴─ failed ──> roll_back ─> reverted
       │           └───────────┴────────────┴──────────┴─────────┴─ armed, silent, conflict ─> in_doubt
       └─ nothing was sent ─> review             in_doubt ─ may be written to again ─> where the journal says

A running write and the recovery after a crash share everything after ``prepare``.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import structlog

from mavcal.calib.firmware.plan import Value
from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.calib.recording import Identity
from mavcal.calib.report import from_json
from mavcal.service.errors import DiskFull, ServiceError, VehicleUnknown, WriteFailed, WriteStopped
from mavcal.service.jobs.core.admission import require_vehicle, until_idle
from mavcal.service.jobs.core.crashpoints import At, CrashPoint
from mavcal.service.jobs.core.handle import JobHandle, counting, waiting
from mavcal.service.jobs.core.journal import BY_OPERATOR, JournalStep, Next, WriteRecord, as_read, decide, who_else
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.parameters import require_absent
from mavcal.service.jobs.core.proof import proof_of
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.rates import ASKING_S, return_streams
from mavcal.service.jobs.write.context import Settling, WriteContext
from mavcal.service.jobs.write.guard import STOPPING, WriteGuard
from mavcal.service.jobs.write.outcome import (
    INTERRUPTED,
    WriteOutcome,
    cause_of,
    conclude,
    nothing_sent,
    nothing_was_sent,
    put_in_doubt,
    reverted,
    succeeded,
    withdraw_certainty,
)
from mavcal.service.jobs.write.steps import finish, prepare, read_back, restart, roll_back, send_all
from mavcal.service.jobs.write.stream_check import StreamCheck
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource, read_values

log = structlog.get_logger(__name__)


@dataclass
class Transaction:
    """The write of one job. `attempt` makes the context of a new attempt with the vehicle as it is known now.

    `attempt` raises VehicleError while the vehicle is not there. No exception leaves a method, whatever its type; the
    job is then in doubt and tried again, or at an end. Cancelling a running method is a crash: the journal decides at
    the next start.
    """

    handle: JobHandle
    attempt: Callable[[], WriteContext]
    retry_s: float
    _guard: WriteGuard | None = None
    """Guard of the last attempt, with the vehicle's state at that time."""

    async def apply(self) -> None:
        """Write the plan. The job is applying; it ends succeeded or reverted, or in review if nothing was sent."""
        try:
            w = self.attempt()
            await until_idle(self.handle, w.vehicle, w.settings)
            w = self.attempt()
            w.guard.check()
            await w.check.before(w.guard)
            progress = counting(self.handle, "asking again for what was not there")
            await w.guard.run(partial(require_absent, w.vehicle, self.handle.job, w.composed_on(), progress))
            await prepare(w)
        except Exception as error:  # noqa: BLE001 - nothing was sent yet, whatever it was
            conclude(self.handle, _nothing_sent(error))
            return
        await self._run_stage(w, partial(_write, w))
        await self.resolve()

    async def revert(self) -> None:
        """Roll a finished write back. The job is rolling_back, and its journal says so."""
        try:
            w = self.attempt()
        except Exception as error:  # noqa: BLE001 - the vehicle has gone: look again later
            await put_in_doubt(self.handle, cause_of(error), {}, None)
        else:
            await self._run_stage(w, partial(_roll_back, w, BY_OPERATOR))
        await self.resolve()

    async def resolve(self) -> None:
        """Recover a job in doubt as soon as its vehicle may be written to; tries until it succeeds."""
        while self.handle.job.state == JobState.IN_DOUBT:
            try:
                if self._guard is not None:
                    await withdraw_certainty(self.handle, self._guard)
                w = self.attempt()
                reason = w.guard.reason()
                if reason is None:
                    await self._run_stage(w, partial(_recover, w))
                else:
                    self._show_obstacle(reason)
            except ServiceError as error:  # the vehicle is not there: look again later
                self._show_obstacle(str(error))
            except Exception:  # of any kind: a job in doubt must not be stranded; logged with its trace
                log.exception("a write in doubt cannot be taken up", job=self.handle.id)
            if self.handle.job.state == JobState.IN_DOUBT:
                await asyncio.sleep(self.retry_s)

    async def _run_stage(self, w: WriteContext, stage: Callable[[], Awaitable[None]]) -> None:
        """Run a stage: a failure is rolled back, a stop leaves the job in doubt."""
        forget = w.vehicle.on_parameter(w.hear)
        try:
            await stage()
        except STOPPING as stopped:
            await self._stopped(w, stopped)
        except Exception as error:  # noqa: BLE001 - whatever it was, the vehicle must not stay half-written
            await self._failed(w, error)
        finally:
            forget()
            self._guard = w.guard

    def _show_obstacle(self, reason: str) -> None:
        """Show the operator what delays the recovery."""
        text = f"Waiting to finish this write or to take it back: {reason}"
        with suppress(DiskFull):  # the vehicle comes first
            self.handle.prompt(Prompt(PromptStep.WAIT, text if text.endswith(".") else f"{text}."))

    async def _stopped(self, w: WriteContext, error: Exception) -> None:
        if nothing_was_sent(self.handle):
            conclude(self.handle, _nothing_sent(error))
        else:
            await put_in_doubt(self.handle, cause_of(error), w.heard, w.guard)

    async def _failed(self, w: WriteContext, error: Exception) -> None:
        returning = self.handle.job.state in (JobState.ROLLING_BACK, JobState.IN_DOUBT)
        if returning or nothing_was_sent(self.handle):
            await self._stopped(w, error)
            return
        try:
            await w.require_same_boot()
            await _roll_back(w, cause_of(error))
        except Exception as worse:  # noqa: BLE001 - also what was not foreseen must not strand the job
            await self._stopped(w, worse)


class Transactions:
    """Makes the transactions of an engine, each attempt with the vehicle as it is known then."""

    def __init__(
        self, vehicles: VehicleSource, settings: JobSettings, *, clock: Callable[[], float], reach: CrashPoint
    ) -> None:
        self._vehicles = vehicles
        self._settings = settings
        self._clock, self._reach = clock, reach

    def of(self, handle: JobHandle) -> Transaction:
        """The write of a job."""
        return Transaction(handle, lambda: self.attempt(handle.job, handle), self._settings.retry_s)

    def attempt(self, job: Job, handle: JobHandle) -> WriteContext:
        """A context for an attempt, with the vehicle as it is known now."""
        assert job.plan is not None
        accept = job.accept or Accept(job.plan.sha256)
        vehicle = self._heard(job)
        check = StreamCheck(handle, vehicle, job.plan, accept.prove_s, self._settings, self._clock)
        return WriteContext(handle, vehicle, job.plan, accept, check, self._settings, self._reach)

    def _heard(self, job: Job) -> JobVehicle:
        """The job's vehicle. One without a unique id is named by a link, and may be heard on another one by now.

        Raises VehicleUnknown. Whether its sensors are those of the plan is asked before anything is sent.
        """
        try:
            vehicle = self._vehicles.vehicle(require_vehicle(job))
        except VehicleUnknown:
            elsewhere = self._elsewhere(job)
            if elsewhere is None:
                raise
            return elsewhere
        gone = vehicle.identity.uid is None and vehicle.condition().silent
        return (self._elsewhere(job) if gone else None) or vehicle

    def _elsewhere(self, job: Job) -> JobVehicle | None:
        """The one vehicle that may be that of a write in doubt, heard on another link than the one that names it."""
        known = job.context.get("identity")
        if job.state != JobState.IN_DOUBT or known is None:
            return None
        found = self._vehicles.nameless(from_json(known, Identity))
        heard = [one for one in found if one.id != job.vehicle_id and not one.condition().silent]
        return heard[0] if len(heard) == 1 else None


def _nothing_sent(error: Exception) -> WriteOutcome:
    return nothing_sent(getattr(error, "code", "write-failed"), cause_of(error))


async def _write(w: WriteContext) -> None:
    await send_all(w)
    following = Next.REBOOT if w.plan.needs_reboot else Next.VERIFY
    values = await read_back(w, Settling.SAVED if following == Next.REBOOT else Settling.KEPT)
    await _go_on(w, following, values)


async def _recover(w: WriteContext) -> None:
    """Continue an interrupted write from what the journal and the vehicle say."""
    record = w.handle.write_record()
    identity = await w.guard.run(w.vehicle.identify)
    if (identity.uid or "") != w.plan.fingerprint.uid:
        raise WriteStopped("another vehicle answers under this one's address")
    if not w.plan.fingerprint.uid:
        await w.guard.run(partial(_same_sensors, w))
    if w.vehicle.id != w.handle.job.vehicle_id:
        w.handle.change("vehicle", {"id": w.vehicle.id}, vehicle_id=w.vehicle.id)
    readings = await w.guard.run(partial(read_values, w.vehicle, [s.name for s in record.sent]))
    values = {name: reading.value for name, reading in readings.items()}
    following = decide(record, w.plan, values)
    cause = record.rolling_back or record.stopped or INTERRUPTED
    if following == Next.REBOOT and await _has_restarted(w, record):
        await w.handle.record(JournalStep.REBOOTED)
        following, values = Next.VERIFY, await read_back(w, Settling.RESTARTED)
    if following == Next.NOTHING_SENT:
        await _close(w, nothing_sent("interrupted", cause, "Nothing was written. Apply the plan again."))
    elif following == Next.ROLL_BACK:
        await _roll_back(w, cause)
    else:
        if following == Next.REBOOT:
            values = await read_back(w, Settling.SAVED)  # what is to survive the restart must be saved
        await _go_on(w, following, values)


async def _has_restarted(w: WriteContext, record: WriteRecord) -> bool:
    """Whether the vehicle has restarted while the service was away, as the write requires."""
    if record.saved is None:
        return False
    await w.require_same_boot()  # its clock is heard
    boot_time = w.vehicle.condition().boot_time
    return boot_time is not None and record.saved.restarted_since(w.handle.now(), boot_time)


async def _same_sensors(w: WriteContext) -> None:
    """Raise WriteStopped if a vehicle that no unique id names has other sensors than that of the plan."""
    planned = {c.name for c in w.plan.changes}
    before = {n: v for n, v in w.composed_on().items() if "_ID" in n and n not in planned and v}
    now = await read_values(w.vehicle, before, absent=True)
    other = [name for name, value in before.items() if name in now and now[name].value not in (0, value)]
    if other or (before and not now):
        raise WriteStopped(f"a vehicle with other sensors answers ({', '.join(other or before)} differs)")


async def _go_on(w: WriteContext, following: Next, values: dict[str, Value]) -> None:
    """Continue a write whose every parameter holds its new value."""
    if following == Next.REBOOT:
        w.handle.move(JobState.WAITING_FOR_REBOOT, standing=(), outcome=None)
        await restart(w)
        values = await read_back(w, Settling.RESTARTED)
    w.handle.move(JobState.VERIFYING, standing=(), outcome=None)
    if following != Next.FINISH:
        verification = await w.check.after(w.guard, values)
        seen = {"proved": verification.proved, "proof": proof_of(verification).level.value}
        w.handle.change("verification", seen, verification=verification, prompt=None)
        if verification.must_go:
            raise WriteFailed(verification.must_go)
        await w.handle.record(JournalStep.VERIFIED)
        w.reach(At.VERIFIED)
    values = await finish(w)
    who = who_else(w.handle.write_record(), w.plan)
    read = as_read(w.plan, w.old_values(), values, who)
    await _close(w, succeeded(read, w.plan, w.handle.job.verification, who))


async def _close(w: WriteContext, ending: WriteOutcome) -> None:
    """Return the message rates and end the job; only a success has to be on the disk before."""
    async with waiting(w.handle, "putting the message rates back", ASKING_S):
        await return_streams(w.handle, w.vehicle)
    record = w.handle.record if ending.state == JobState.SUCCEEDED else w.handle.record_anyway
    await record(JournalStep.CLOSED)
    w.reach(At.CLOSED)
    conclude(w.handle, ending)


async def _roll_back(w: WriteContext, because: str) -> None:
    if w.handle.job.state != JobState.ROLLING_BACK:
        w.handle.move(JobState.ROLLING_BACK, standing=(), outcome=None, prompt=None)
    await w.handle.record_anyway(JournalStep.ROLL_BACK, because=because)
    values = await roll_back(w)
    record = w.handle.write_record()
    who = who_else(record, w.plan)
    read = as_read(w.plan, w.old_values(), values, who)
    await _close(w, reverted(read, None if because == BY_OPERATOR else because, who, len(record.sent)))
