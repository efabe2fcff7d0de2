"""One job from its start to its plan: capture, fit of the closed segments, compose."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import dataclass
from functools import partial

import structlog

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware.options import key_text
from mavcal.calib.firmware.plan import Value
from mavcal.calib.procedures.protocol import GaveUp
from mavcal.calib.recording import Identity
from mavcal.calib.report import from_json, to_json
from mavcal.service.errors import (
    CaptureDisturbed,
    CaptureEnded,
    CaptureLost,
    CaptureMoved,
    ServiceError,
    VehicleUnknown,
)
from mavcal.service.jobs.calibrate.capture import Capture
from mavcal.service.jobs.calibrate.digest import Fitted, JobFitRequest, fit_segments
from mavcal.service.jobs.calibrate.planning import (
    WITHOUT_ROW,
    accel_temperatures,
    foresee,
    keep_plan,
    make_plan,
    move_to_review,
    nothing_to_write,
)
from mavcal.service.jobs.core.admission import require_vehicle, until_idle
from mavcal.service.jobs.core.crashpoints import At, CrashPoint, no_crash
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Failure, Job, LogSpan, fit_messages
from mavcal.service.jobs.core.segments import SET_ASIDE, captured, span_of
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.vehicle.job_vehicle import JobVehicle, VehicleSource

log = structlog.get_logger(__name__)

REPEATED = frozenset({"gyro", "level", "accel-one-axis"})
"""Kinds that need one rest and no poses: they begin again by themselves."""
EARLY = frozenset({"thermal"})
"""Kinds that begin again only in their first minute: later, the temperatures already passed do not come back."""
EARLY_S = 60.0
REPEATS = 3
"""Most repetitions; a vehicle that goes on calibrating needs attention."""
KEPT = "What was recorded is kept and can be fitted later; start the job again."


@dataclass
class Runner:
    """Runs jobs up to review."""

    source: VehicleSource
    settings: JobSettings
    executor: Executor
    jobs: Callable[[], Iterable[Job]]
    """Every job, for what is known from earlier ones."""
    reach: CrashPoint = no_crash
    clock: Callable[[], float] = time.monotonic
    wall: Callable[[], float] = time.time

    async def calibrate(self, handle: JobHandle) -> None:
        """Capture, fit and plan; the job ends in review, failed or interrupted."""
        try:
            vehicle = await self.vehicle(handle)
            if handle.job.state == JobState.QUEUED:
                context = {**handle.job.context, "identity": to_json(vehicle.identity)}
                handle.move(JobState.RUNNING, context=context)
            await self._capture(handle, vehicle)
        except asyncio.CancelledError:
            if handle.job.state == JobState.CANCELLED:
                handle.change("segments", {}, segments=_spans(handle))
            raise
        except CaptureLost as lost:
            _end(handle, JobState.INTERRUPTED, Failure.of(lost, lost.remedy))
        except CaptureEnded as ended:
            _end(handle, JobState.FAILED, Failure.of(ended, ended.remedy))
        except (ServiceError, CalibError) as error:
            _end(handle, JobState.FAILED, Failure.of(error, "Remove the cause and start the job again."))
        else:
            handle.move(JobState.FITTING, segments=_spans(handle), prompt=None)
            await self.fit(handle)

    async def _capture(self, handle: JobHandle, vehicle: JobVehicle) -> None:
        """Capture; repeat after an onboard calibration if the procedure needs no poses."""
        left = REPEATS if handle.job.kind in REPEATED | EARLY else 0
        while True:
            await until_idle(handle, vehicle, self.settings)
            began = self.clock()
            capture = Capture(handle, vehicle, self.settings, self.reach, self.clock, self.wall)
            capture.foresee = partial(self._foresee, handle.job)
            try:
                await capture.run()
            except CaptureMoved as moved:
                handle.warn(str(moved))
            except CaptureDisturbed as disturbed:
                late = handle.job.kind in EARLY and self.clock() - began > EARLY_S
                if left == 0 or late:
                    raise
                left -= 1
                _set_aside(handle, disturbed)
            else:
                return

    def _foresee(self, job: Job, identity: Identity, parameters: Mapping[str, Value]) -> tuple[str, ...]:
        known = accel_temperatures(self.jobs(), require_vehicle(job), parameters)
        return foresee(job.kind, identity, parameters, job.context.get("plan_options", {}), known)

    async def fit(self, handle: JobHandle) -> None:
        """Fit the closed segments and plan. The job is fitting; it ends in review or failed."""
        job = handle.job
        identity = from_json(job.context["identity"], Identity)
        answers = tuple((float(t), str(value)) for t, value in job.context.get("answers", ()))
        request = JobFitRequest(job.kind, dict(job.options), job.segments, identity.system, job.created_at, answers)
        plan_options = job.context.get("plan_options", {})
        try:
            fitted = await self._fitted(request)
            self.reach(At.FITTED)
            if isinstance(fitted.outcome, GaveUp):
                raise CaptureEnded(fitted.outcome.cause, remedy=fitted.outcome.remedy)
            results = fitted.outcome.results
            planned = await asyncio.to_thread(
                make_plan,
                results,
                fitted.parameters,
                identity,
                plan_options,
                self.jobs(),
                require_vehicle(job),
                without_row=fitted.without_row,
            )
            await keep_plan(handle, planned)
        except CaptureEnded as ended:
            _end(handle, JobState.FAILED, Failure.of(ended, ended.remedy))
            return
        except (ServiceError, CalibError) as error:
            _end(handle, JobState.FAILED, Failure.of(error, "What was recorded is kept; start the job again."))
            return
        move_to_review(
            handle,
            planned.plan,
            nothing_to_write(planned.plan),
            results=results,
            warnings=tuple(dict.fromkeys((*job.warnings, *fit_messages(results)))),
            missed=fitted.outcome.left_out,
            context={**handle.job.context, WITHOUT_ROW: sorted(key_text(*key) for key in fitted.without_row)},
            prompt=None,
        )

    async def _fitted(self, request: JobFitRequest) -> Fitted:
        """The fit, by a worker; in a thread of this process if the worker was killed."""
        try:
            return await asyncio.get_running_loop().run_in_executor(self.executor, fit_segments, request)
        except BrokenExecutor as broken:
            log.warning("the worker of a fit has ended: it is made once more", reason=str(broken))
            return await asyncio.to_thread(fit_segments, request)

    async def vehicle(self, handle: JobHandle) -> JobVehicle:
        """The job's vehicle, waited for if it is not heard yet."""
        deadline = self.clock() + self.settings.return_limit_s
        while True:
            try:
                vehicle = self.source.vehicle(require_vehicle(handle.job))
            except VehicleUnknown:
                pass
            else:
                if not vehicle.condition().silent:
                    return vehicle
            if self.clock() > deadline:
                raise CaptureLost(
                    f"the vehicle did not come back within {self.settings.return_limit_s:.0f} s", remedy=KEPT
                )
            await asyncio.sleep(self.settings.watch_s)


def _set_aside(handle: JobHandle, disturbed: CaptureDisturbed) -> None:
    """Exclude what was recorded so far from the fit; it stays on the disk."""
    rows = captured(handle.job, handle.store)
    context = {key: value for key, value in handle.job.context.items() if key != "answers"}
    if rows:
        context[SET_ASIDE] = rows[-1].id
    handle.warn(f"{disturbed}: the capture begins again")
    handle.change("set_aside", {"segments": len(rows)}, context=context, progress=None)


def _spans(handle: JobHandle) -> tuple[LogSpan, ...]:
    rows = captured(handle.job, handle.store)
    return tuple(span_of(row) for row in rows if row.end_byte is not None)


def _end(handle: JobHandle, state: JobState, failure: Failure) -> None:
    handle.move(state, outcome=failure, segments=_spans(handle), prompt=None)
