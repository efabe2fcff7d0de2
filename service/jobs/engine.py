"""The job engine: one task a job of any kind, one physical job a vehicle, any number of vehicles."""

from __future__ import annotations

import asyncio
import dataclasses
import time
import uuid
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from typing import Any

from mavcal.calib.firmware.stream.rates import requested_streams
from mavcal.calib.preflight.check import VerifiedCalibration
from mavcal.calib.procedures.registry import specification, validate_options
from mavcal.service.errors import AnswerRefused, Forbidden, IllegalTransition, NotCancellable, NotRevertible
from mavcal.service.jobs.calibrate import without_capture
from mavcal.service.jobs.calibrate.history import history_of, verified_jobs
from mavcal.service.jobs.calibrate.planning import checked_plan_options, confirmed, require_sensors_of
from mavcal.service.jobs.calibrate.runner import Runner
from mavcal.service.jobs.core import admission
from mavcal.service.jobs.core.book import JobBook
from mavcal.service.jobs.core.crashpoints import At, CrashPoint, no_crash
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.journal import BY_OPERATOR, JournalStep
from mavcal.service.jobs.core.model import FROM_RECORDING, RESTORE, Accept, Attempt, Job, WriteResult, cancelled
from mavcal.service.jobs.core.ports import Alone, JobRecord, Ownership
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import CANCELLABLE, CAPTURING, ENDED, JobState
from mavcal.service.jobs.core.tasks import JobTasks, Work
from mavcal.service.jobs.rates import STARTING, JobRates, with_present_vehicles
from mavcal.service.jobs.uploads import COMPUTED, FIT, GAP, Computations, Computing, NoUploads
from mavcal.service.jobs.write.accept import Acceptance, request_digest, require_acceptable
from mavcal.service.jobs.write.outcome import INTERRUPTED, settle_lost_write
from mavcal.service.jobs.write.readiness import keep_readiness
from mavcal.service.jobs.write.steps import check_plan
from mavcal.service.jobs.write.transaction import Transactions
from mavcal.service.preflights import History, Preflight, Preflights
from mavcal.service.rates.ledger import RateLedgers
from mavcal.service.store.rows import EventRow, JobDocument, JobRow
from mavcal.service.store.sql import Store
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource


class JobEngine:
    """Runs every job; its methods are called from the event loop.

    Jobs that need a vehicle begin at once, one a vehicle; those that need a processor wait in ``computing``.

    Parameters
    ----------
    store
        Holds every job.
    vehicles
        Where jobs find theirs.
    computations, ownership
        What is done with uploaded recordings (None: there are none), and which jobs are ours (None: all of them).
    settings, read_only
        How patient the engine is; whether nothing is ever written to a vehicle.
    executor
        Where closed segments are fitted; any ``concurrent.futures.Executor``. None: two threads of its own.
    clock, wall
        Monotonic time for time-outs; wall time for stamps.
    reach, record
        Called where a crash would leave another state behind (tests); told of what jobs and preflights came to.
    ledgers
        The message rates of all vehicles; None: nobody watches any.
    """

    def __init__(
        self,
        store: Store,
        vehicles: VehicleSource,
        computations: Computations | None = None,
        *,
        settings: JobSettings | None = None,
        ownership: Ownership | None = None,
        executor: Executor | None = None,
        read_only: bool = False,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
        reach: CrashPoint = no_crash,
        record: JobRecord | None = None,
        ledgers: RateLedgers | None = None,
    ) -> None:
        self.settings = settings or JobSettings()
        self._store, self._vehicles, self._read_only = store, vehicles, read_only
        self._wall, self._clock, self._reach, self._record = wall, clock, reach, record
        self._pool, self._owns_pool = executor or ThreadPoolExecutor(2, thread_name_prefix="fit"), executor is None
        self._ownership = ownership or Alone(store)
        self.book = JobBook(store, self._ownership, self.settings.progress_s, clock, wall)
        """The book of every job; one of several instances also enters the changes of the others."""
        self._runner = Runner(vehicles, self.settings, self._pool, self.list, reach, clock, wall)
        self.tasks = JobTasks(self.settings.retry_s, self._recovered, self._ended)
        self._ledgers = ledgers or RateLedgers(vehicles)
        self._rates = JobRates(self._ledgers, self._runner.vehicle, self.settings.review_s, self.tasks.ending_tasks)
        self._computations = computations or NoUploads()
        lanes = {FIT: self.settings.fits_at_once, GAP: self.settings.diagnoses_at_once}
        self.computing = Computing(self._computations, self.book, self.tasks, self.cancel, wall, lanes=lanes)
        """Fits and diagnoses of uploads."""
        self.resumed_by: dict[str, Callable[[JobHandle], None]] = dict.fromkeys(
            COMPUTED, self.computing.resume_at_start
        )
        """How jobs of kinds that others run are resumed; entered before :meth:`start`."""
        self._preflights = Preflights(self.settings.preflight_s, self._ledgers, wall, clock)
        self._transactions = Transactions(vehicles, self.settings, clock=clock, reach=reach)
        self._acceptance = Acceptance(store, wall)

    async def start(self) -> None:
        """Take up every job of the store where it was left, however the service ended.

        Interrupted writes come first and alone; the other jobs follow when these have ended, or after a while. One of
        several instances takes up nothing yet: :meth:`take_over` follows for what it comes to own.
        """
        if self._ownership.shared:
            self.book.watch()
        else:
            self._resume_all(self.book.load())

    def take_over(self, rows: Iterable[JobRow]) -> None:
        """Take up jobs that this instance owns from now on."""
        self._resume_all(self.book.take(rows))

    def give_up(self, of: Callable[[Job], bool]) -> None:
        """Stop what is done for these jobs, which are not ours any more; nothing more is sent or kept for them."""
        for handle in self.book.drop(of):
            self.tasks.cancel(handle.id)

    def _resume_all(self, handles: Sequence[JobHandle]) -> None:
        self.tasks.resume(handles, self._recover, self._resume, alone_s=self.settings.recovery_alone_s)

    def _recover(self, handle: JobHandle) -> None:
        """Finish or take back an interrupted write: the journal and the vehicle decide."""
        if handle.job.plan is not None:
            self.tasks.spawn(handle, partial(self._recovered, handle, INTERRUPTED))

    async def _recovered(self, handle: JobHandle, reason: str) -> None:
        await settle_lost_write(handle, reason)
        async with self._rates.turn(handle):
            await self._transactions.of(handle).resolve()

    def _resume(self, handle: JobHandle) -> None:
        state, kind = handle.job.state, handle.job.kind
        if kind in self.resumed_by:
            self.resumed_by[kind](handle)
        elif state in CAPTURING:  # replay what was recorded and go on, if the vehicle is the same boot still
            self.tasks.spawn(handle, partial(self._capture, handle))
        elif state == JobState.FITTING and kind in (FROM_RECORDING, RESTORE):
            self.tasks.spawn(handle, self._planning(handle))
        elif state == JobState.FITTING:
            self.tasks.spawn(handle, partial(self._runner.fit, handle))
        else:
            self._return_rates(handle)

    async def stop(self) -> None:
        """Stop every task; jobs stay in their states and are taken up at the next start."""
        self.tasks.stopping = True
        self.book.close()
        tasks = [*self.tasks.running.values(), *self._rates.tasks, *self.tasks.resuming]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self.book.kept(self.settings.last_save_s)
        await self._preflights.stop()
        if self._owns_pool:
            self._pool.shutdown(wait=False, cancel_futures=True)

    async def wait_for_cleanup(self) -> None:
        """Wait until jobs that are over have put the vehicle's message rates back."""
        await self._rates.all_returned()

    def list(self) -> tuple[Job, ...]:
        """Every job, oldest first."""
        return self.book.list()

    def get(self, job_id: str) -> Job:
        """The job of that id. Raises JobUnknown."""
        return self.book.job(job_id)

    def claim(self, vehicle_id: str) -> str | None:
        """A sentence on the job or preflight that sets the message rates of a vehicle; None: none does."""
        if self.tasks.resuming:
            return STARTING
        jobs = with_present_vehicles(self.list(), self._vehicles)
        return self._rates.user(vehicle_id, jobs, self.tasks.running, looked_at=self._preflights.holds(vehicle_id))

    async def document(self, job_id: str, name: str) -> JobDocument:
        """A document that the job has made. Raises JobUnknown, DocumentUnknown."""
        return await self.book.document(job_id, name)

    def subscribe(self, job_id: str | None = None, after: int = 0) -> AsyncIterator[EventRow]:
        """Events after `after` (a sequence of that job, or an id over all jobs), for ever."""
        return self.book.subscribe(job_id, after)

    async def preflight(self, vehicle_id: str, *, heading: float | None = None) -> Preflight:
        """Check a vehicle within ten seconds (30 on a slow link); nothing is written.

        `heading`: the true one of its nose, deg.

        Raises
        ------
        VehicleUnknown, VehicleSilent, VehicleArmed, VehicleConflict, PhysicalJobRunning, PreflightRunning
        FirmwareError
            If the autopilot is neither ArduPilot nor PX4.
        """
        vehicle = self._vehicles.vehicle(vehicle_id)
        self._require_free(vehicle.id)
        admission.require_ready(vehicle, busy=True)  # which is one of the checks
        with self._preflights.claimed(vehicle.id):
            await self._rates.before_preflight(vehicle.id)
            found = await self._preflights.run(vehicle, self._history, heading=heading)
            return found if self._record is None else await self._record.keep_preflight(found)

    async def restore(
        self,
        vehicle_id: str,
        plan_options: Mapping[str, Any] | None = None,
        *,
        begun_by: Mapping[str, Any] | None = None,
    ) -> Job:
        """Start a job that plans to restore the last verified calibration, by device id; it ends in review or failed.

        `begun_by` goes to its context: the campaign that began it.

        Raises
        ------
        NothingVerified
            If no calibration was verified, or it is not surely of this very unit.
        InvalidInputError, VehicleUnknown, VehicleSilent, VehicleArmed, VehicleBusy, PhysicalJobRunning
            As for :meth:`adopt`.
        """
        context = {"plan_options": checked_plan_options(plan_options or {}), **(begun_by or {})}
        vehicle = self._vehicles.vehicle(vehicle_id)
        admission.require_ready(vehicle)
        await without_capture.require_restorable(vehicle, self._history)
        self._require_free(vehicle.id)
        return await self._begin(self._new_job(vehicle, RESTORE, {}, context), self._planning)

    async def submit(
        self,
        vehicle_id: str,
        kind: str,
        options: Mapping[str, Any] | None = None,
        plan_options: Mapping[str, Any] | None = None,
        *,
        begun_by: Mapping[str, Any] | None = None,
    ) -> Job:
        """Start a calibration; `options` are the procedure's, `plan_options` those of composing its plan.

        `begun_by` goes to its context: the campaign that began it.

        Raises
        ------
        VehicleUnknown, VehicleSilent, VehicleArmed, VehicleConflict
        PhysicalJobRunning
            If that vehicle has a job that claims it, or one whose write is in doubt.
        InvalidInputError
            If the kind or an option is unknown.
        FirmwareError
            If the autopilot is neither ArduPilot nor PX4.
        """
        spec = specification(kind)
        chosen = validate_options(kind, options or {})
        context = {**(begun_by or {}), "plan_options": checked_plan_options(plan_options or {})}
        require_sensors_of(spec, plan_options or {})
        admission.require_whole(self._store)  # a calibration that could never be written is not begun
        vehicle = self._vehicles.vehicle(vehicle_id)
        self._require_free(vehicle.id)
        admission.require_ready(vehicle, busy=True)  # which is waited for
        requested_streams(vehicle.identity.autopilot or "", spec.sensors)
        if vehicle.identity.firmware is None:
            await vehicle.identify()
            self._require_free(vehicle.id)
        job = dataclasses.replace(self._new_job(vehicle, spec.kind, chosen, context), state=JobState.QUEUED)
        return await self._begin(job, lambda handle: partial(self._capture, handle))

    async def adopt(
        self,
        vehicle_id: str,
        recording: str,
        method: str,
        options: Mapping[str, Any],
        plan_options: Mapping[str, Any] | None = None,
    ) -> Job:
        """A job that is fitting an uploaded recording by a method, and then in review or failed.

        Raises
        ------
        RecordingUnknown, InvalidInputError
            If there is no such recording, method or option of a plan.
        VehicleUnknown, VehicleSilent, VehicleArmed, VehicleBusy, VehicleConflict, PhysicalJobRunning
            As for :meth:`submit`.
        """
        admission.require_finite(options)
        self._computations.check(recording, method)
        context = {"plan_options": checked_plan_options(plan_options or {})}
        vehicle = self._vehicles.vehicle(vehicle_id)
        self._require_free(vehicle.id)
        admission.require_ready(vehicle)
        chosen = {"recording": recording, "method": method, "options": dict(options)}
        return await self._begin(self._new_job(vehicle, FROM_RECORDING, chosen, context), self._planning)

    async def cancel(self, job_id: str) -> Job:
        """Cancel a job that has written nothing; what it recorded is kept. Raises NotCancellable."""
        handle = self.book.handle(job_id)
        state = handle.job.state
        if state not in CANCELLABLE:
            raise NotCancellable(f"job {job_id} is {state}: it cannot be cancelled now")
        handle.move(JobState.CANCELLED, prompt=None, outcome=cancelled(handle.job))
        self.tasks.cancel(job_id)
        return handle.job

    async def answer(self, job_id: str, value: str) -> Job:
        """Answer the job's prompt. Raises AnswerRefused if it does not accept that."""
        handle = self.book.handle(job_id)
        prompt = handle.job.prompt
        if prompt is None or not prompt.accepts(value):
            choice = f"it accepts {prompt.choice}" if prompt and prompt.choice else "it asks for no answer now"
            raise AnswerRefused(f"job {job_id} does not take {value!r}: {choice}")
        handle.answers.put_nowait(value)
        return handle.job

    async def refit(self, job_id: str) -> Job:
        """Fit what an interrupted job has recorded. Raises IllegalTransition."""
        handle = self.book.handle(job_id)
        if handle.job.state != JobState.INTERRUPTED:
            raise IllegalTransition(f"job {job_id} is {handle.job.state}: only an interrupted job is fitted again")
        handle.move(JobState.FITTING, outcome=None)
        self.tasks.spawn(handle, partial(self._runner.fit, handle))
        return handle.job

    async def plan_again(self, job_id: str, options: Mapping[str, Any] | None = None) -> Job:
        """Compose the plan of a job in review again, on the vehicle's present parameters.

        `options` are those of :data:`calib.firmware.options.PLAN_OPTIONS`; None: as before.
        Raises IllegalTransition, InvalidInputError, FirmwareError, VehicleError.
        """
        handle = self.book.handle(job_id)
        job = handle.job
        without_capture.require_review(job)
        results = None if job.kind == RESTORE else job.results
        chosen = checked_plan_options(job.context.get("plan_options", {}) if options is None else options, results)
        vehicle = self._vehicles.vehicle(admission.require_vehicle(job))
        admission.require_ready(vehicle)
        await without_capture.plan_again(handle, vehicle, chosen, self._history, self.list())
        return handle.job

    async def apply(
        self, job_id: str, accept: Accept, idempotency_key: str | None = None, *, look: bool = False
    ) -> Job:
        """Write the job's plan; returns as soon as the plan is found to fit the vehicle still.

        `look`: look at the vehicle afterwards, and keep in the job whether it would arm now.

        Raises
        ------
        PlanChanged
            If the digest is not that of the plan, or the vehicle is not what the plan was made for: plan again.
        PlanBlocked, PlanMissing, IllegalTransition, PhysicalJobRunning, IdempotencyConflict
        VehicleError
            As for :meth:`submit`.
        Forbidden
            If this service never writes.
        """
        handle = self.book.handle(job_id)
        digest = request_digest(job_id, accept)
        if await self._acceptance.known(idempotency_key, digest, lambda: handle.job):
            return handle.job
        self._require_writing()
        self._require_acceptable(handle.job, accept)
        vehicle = self._vehicles.vehicle(admission.require_vehicle(handle.job))
        admission.require_ready(vehicle, busy=True)
        await check_plan(self._transactions.attempt(dataclasses.replace(handle.job, accept=accept), handle))
        self._require_acceptable(handle.job, accept)  # it may have been accepted, or planned again, meanwhile
        detail = {"plan_sha256": accept.plan_sha256, "confirmed": confirmed(handle.job.context.get("plan_options", {}))}
        with self._acceptance.claimed(job_id):
            await self._acceptance.note(accept.actor, "apply", job_id, detail)
            # First the journal: from the new state on the job has a task, whatever the store does.
            await handle.record(
                JournalStep.ACCEPTED, plan_sha256=accept.plan_sha256, actor=accept.actor, reboot=accept.reboot
            )
            await self._acceptance.use(idempotency_key, digest, job_id)
            self._require_acceptable(handle.job, accept)
        attempt = Attempt(WriteResult.RUNNING, self._wall())
        context = {**handle.job.context, admission.WAY: vehicle.condition().way}
        fresh: dict[str, Any] = {"outcome": None, "verification": None, "standing": ()}
        handle.move(JobState.APPLYING, accept=accept, context=context, last_write=attempt, **fresh)
        self.tasks.spawn(handle, partial(self._write, handle, self._history if look else None))
        self._reach(At.ACCEPTED)
        return handle.job

    async def revert(self, job_id: str, actor: str = "operator") -> Job:
        """Take back what a job has written, where it still stands.

        Raises NotRevertible if the job is not ``succeeded``; PhysicalJobRunning, VehicleError, Forbidden.
        """
        handle = self.book.handle(job_id)
        if handle.job.state != JobState.SUCCEEDED:
            raise NotRevertible(f"job {job_id} is {handle.job.state}: only a write that succeeded can be taken back")
        self._require_writing()
        if handle.job.accept is None:
            raise NotRevertible(f"job {job_id} found nothing to write: there is nothing to take back")
        self._require_free(admission.require_vehicle(handle.job), besides=job_id)
        admission.require_ready(self._vehicles.vehicle(admission.require_vehicle(handle.job)))
        with self._acceptance.claimed(job_id):
            await self._acceptance.note(actor, "revert", job_id, {})
            await handle.record(JournalStep.ROLL_BACK, because=BY_OPERATOR)
            self._require_free(admission.require_vehicle(handle.job), besides=job_id)
        handle.move(JobState.ROLLING_BACK, prompt=None)
        self.tasks.spawn(handle, self._transactions.of(handle).revert)
        return handle.job

    def _new_job(self, vehicle: JobVehicle, kind: str, options: Mapping[str, Any], context: Mapping[str, Any]) -> Job:
        """A new job of a vehicle, whose fits are to come."""
        now, new_id = self._wall(), uuid.uuid4().hex[:12]
        return Job(new_id, vehicle.id, kind, dict(options), JobState.FITTING, now, now, context=dict(context))

    async def _begin(self, job: Job, work: Callable[[JobHandle], Work]) -> Job:
        handle = await self.book.new(job)
        self.tasks.spawn(handle, work(handle))
        return handle.job

    def _require_free(self, vehicle_id: str, *, besides: str = "") -> None:
        """Raise PhysicalJobRunning or PreflightRunning if something else claims this vehicle."""
        admission.require_free(vehicle_id, with_present_vehicles(self.list(), self._vehicles), besides=besides)
        self._preflights.require_idle(vehicle_id)

    def _require_acceptable(self, job: Job, accept: Accept) -> None:
        require_acceptable(job, accept)
        self._require_free(admission.require_vehicle(job), besides=job.id)

    def _require_writing(self) -> None:
        if self._read_only:
            raise Forbidden("this service runs with --read-only and never writes: export the plan instead")
        admission.require_whole(self._store)

    async def _history(self, vehicle: JobVehicle) -> tuple[VerifiedCalibration, ...]:
        jobs = verified_jobs(self.list(), vehicle.id, vehicle.identity)
        return await self._store.do(partial(history_of, jobs, self._store))

    def _planning(self, handle: JobHandle) -> Work:
        if handle.job.kind == RESTORE:
            return partial(without_capture.plan_restore, handle, self._runner.vehicle, self._history)
        return partial(without_capture.plan_from_recording, handle, self._runner.vehicle, self._computations, self.list)

    async def _capture(self, handle: JobHandle) -> None:
        """A capture, after message rates of an earlier job of this vehicle are back, and with its own put back."""
        await self._rates.before_capture(admission.require_vehicle(handle.job))
        async with self._rates.turn(handle):
            await self._runner.calibrate(handle)

    async def _write(self, handle: JobHandle, look: History | None) -> None:
        """A write, once no other message rates are being returned: it needs those of its capture.

        `look`: what is known of the vehicle, with which it is looked at afterwards; None: it is not.
        """
        await self._rates.before_write(handle)
        async with self._rates.turn(handle):
            await self._transactions.of(handle).apply()
        if look is not None:
            await keep_readiness(handle, self._vehicles, self._preflights, look)

    def _ended(self, handle: JobHandle) -> None:
        """A job's task is over; the rates of one that was given up are another instance's to return."""
        if not self.book.holds(handle):
            return
        self._ownership.ended(handle.job)
        if self._record is not None:
            self._record.job_ended(handle.job)
        if handle.job.state in ENDED | {JobState.REVIEW}:
            self._return_rates(handle)
            self._store.soon(partial(self._store.drop_events, handle.id, "progress", keep=1))

    def _return_rates(self, handle: JobHandle) -> None:
        """Return the message rates that a job owes; a stopping service leaves that to its next start."""
        if not self.tasks.stopping:
            self._rates.begin_return(handle)
