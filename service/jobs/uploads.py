"""Jobs that compute something from uploaded recordings: a fit by a method, a diagnosis of the sim-to-real gap.

They need a processor and no vehicle. A job is queued until a child process has taken it up. Diagnoses run one after the
other, so that fits find a free process. Fits wait here too, so that uploads find one. A cancelled job's child is
killed; a job whose service was stopped begins again at the next start.
"""

from __future__ import annotations

import asyncio
import itertools
import uuid
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Never, Protocol

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware.in_force.origin import Origin
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.protocol import Progress
from mavcal.service.errors import ChildrenBusy, GapsBusy, JobCancelled, RecordingUnknown, ServiceError
from mavcal.service.jobs.core.admission import require_finite
from mavcal.service.jobs.core.book import JobBook
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Failure, Job, Result, fit_messages
from mavcal.service.jobs.core.states import CANCELLABLE, ENDED, JobState
from mavcal.service.jobs.core.tasks import JobTasks
from mavcal.service.progress_line import parse_line
from mavcal.service.store.rows import JobDocument

ProgressCallback = Callable[[str], None]
"""Hears how far a computation is, in words."""


@dataclass(frozen=True)
class Diagnosis:
    """What a gap diagnosis found: one sentence, and its report."""

    summary: str
    documents: tuple[JobDocument, ...]


class Computations(Protocol):
    """Computations on uploads, outside this process. When a call is cancelled, its computation is ended.

    Every method raises RecordingUnknown if an upload does not exist, and CalibError for what the computation itself
    refused. It raises ChildEnded if the computation used more than it may, and ChildrenBusy if too many are waiting.
    """

    @property
    def at_once(self) -> int:
        """Number of computations at a time; further ones wait."""

    def check(self, recording: str, method: str | None = None) -> None:
        """Raise RecordingUnknown or InvalidInputError if there is no such upload or method."""

    async def fit(
        self, recording: str, method: str, options: Mapping[str, Any], *, progress: ProgressCallback | None = None
    ) -> tuple[FitResult, ...]:
        """Fits by sensor."""

    async def fit_of_vehicle(
        self, recording: str, method: str, options: Mapping[str, Any]
    ) -> tuple[tuple[FitResult, ...], Origin]:
        """The same fits, and whose sensors they are of. Raises FirmwareError if the recording does not say."""

    async def diagnose(
        self,
        real: str,
        sim: str | None,
        nominal: Sequence[str],
        *,
        limit_s: float | None = None,
        progress: ProgressCallback | None = None,
    ) -> Diagnosis:
        """The sim-to-real gap of an upload; `limit_s` is its processor time, None: the default."""


class NoUploads:
    """The computations of an engine that has no uploads."""

    at_once = 1

    def check(self, recording: str, method: str | None = None) -> None:
        """Raise RecordingUnknown."""
        raise RecordingUnknown(f"there is no recording {recording}: uploads are not kept here")

    async def fit(self, *_order: Any, **_options: Any) -> Never:
        """Raise RecordingUnknown."""
        raise RecordingUnknown

    fit_of_vehicle = diagnose = fit


FIT = "fit"
"""Kind of a job that runs a method on an upload: options `recording`, `method`, `options`."""
GAP = "gap"
"""Kind of a job that diagnoses a gap between uploads: options `real`, `sim`, `nominal`, `limit_s`."""
COMPUTED = frozenset({FIT, GAP})
MOST_DIAGNOSES = 8
"""Diagnoses that may be queued or running at a time."""
MOST_FITS = 500
"""Fits that may be queued or running at a time."""
MOST_FITS_KEPT = 1000
"""Fits that have ended and are remembered; the oldest are forgotten first."""
MOST_STARTS = 3
"""Starts, at most, of a job during which the service stops: the job may be what stops it."""
STEPS = 2
"""Steps that a child reports: reading, then computing."""
NOTHING_WRITTEN = "Nothing was written to a vehicle, so there is nothing to prove."
REMEDY = "Remove the cause and ask again; the recording is kept."


class Computing:
    """Begins these jobs and runs them to their end.

    Parameters
    ----------
    computations
        What is done with uploads, each in a child process.
    book
        Every job.
    tasks
        Run a job's work.
    cancel
        Cancels a job.
    wall
        Wall-clock time, for stamps.
    lanes
        How many jobs of each kind are computed at a time.
    """

    def __init__(
        self,
        computations: Computations,
        book: JobBook,
        tasks: JobTasks,
        cancel: Callable[[str], Awaitable[Job]],
        wall: Callable[[], float],
        *,
        lanes: Mapping[str, int],
    ) -> None:
        self._computations = computations
        self._book, self._tasks, self._cancel = book, tasks, cancel
        self._wall = wall
        self._lanes = {kind: asyncio.Semaphore(most) for kind, most in lanes.items()}
        self._waited_for: dict[str, asyncio.Future[Job]] = {}

    async def fit(self, recording: str, method: str, options: Mapping[str, Any]) -> Job:
        """A job that runs a method on an upload.

        Raises
        ------
        RecordingUnknown
            If there is no such upload.
        InvalidInputError
            If there is no such method, or an option is not finite.
        ChildrenBusy
            If too many fits are waiting.
        """
        require_finite(options)
        self._computations.check(recording, method)
        waiting = self._waiting(FIT)
        if waiting >= MOST_FITS:
            raise ChildrenBusy(f"{waiting} fits are waiting or running: try again when some have ended")
        return (await self._start(FIT, {"recording": recording, "method": method, "options": dict(options)})).job

    async def diagnose(self, real: str, sim: str | None, nominal: Sequence[str], limit_s: float | None = None) -> Job:
        """A job that diagnoses the gap of an upload, of at most `limit_s` seconds of processor time.

        Raises
        ------
        RecordingUnknown
            If an upload does not exist.
        GapsBusy
            If too many diagnoses are waiting.
        """
        for upload in (real, *(() if sim is None else (sim,)), *nominal):
            self._computations.check(upload)
        waiting = self._waiting(GAP)
        if waiting >= MOST_DIAGNOSES:
            raise GapsBusy(f"{waiting} diagnoses are waiting or running: try again when one has ended")
        limited = {} if limit_s is None else {"limit_s": limit_s}
        return (await self._start(GAP, {"real": real, "sim": sim, "nominal": list(nominal), **limited})).job

    async def fitted(self, recording: str, method: str, options: Mapping[str, Any]) -> Job:
        """The ended job of :meth:`fit`; it is cancelled where its caller is.

        Raises
        ------
        RecordingUnknown, InvalidInputError
            As for :meth:`fit`.
        ServiceError, CalibError
            What the job failed of.
        """
        job = await self.fit(recording, method, options)
        future = self._waited_for.setdefault(job.id, asyncio.get_running_loop().create_future())
        try:
            return await future
        except asyncio.CancelledError:
            if self._book.handle(job.id).job.state in CANCELLABLE:
                await self._cancel(job.id)
            raise
        finally:
            self._waited_for.pop(job.id, None)

    def resume_at_start(self, handle: JobHandle) -> None:
        """Begin a job again that was waiting or running when the service stopped; at most :data:`MOST_STARTS` times."""
        if handle.job.state in ENDED:
            return
        if handle.job.state == JobState.FITTING:
            if handle.job.context.get("starts", 0) >= MOST_STARTS:
                cause = f"The service was stopped {MOST_STARTS} times while this job ran."
                remedy = "Look into the service's log before you ask again; the recording is kept."
                handle.move(JobState.FAILED, outcome=Failure("computation-interrupted", cause, remedy))
                return
            handle.move(JobState.QUEUED, progress=None)
        self._tasks.spawn(handle, partial(self._run, handle))

    async def _start(self, kind: str, options: Mapping[str, Any]) -> JobHandle:
        now = self._wall()
        handle = await self._book.new(Job(uuid.uuid4().hex[:12], None, kind, options, JobState.QUEUED, now, now))
        self._tasks.spawn(handle, partial(self._run, handle))
        return handle

    async def _run(self, handle: JobHandle) -> None:
        """Compute; the job ends succeeded or failed."""
        ended: Job | Exception = JobCancelled(f"job {handle.id} was cancelled")
        try:
            async with self._lanes[handle.job.kind]:
                await (self._diagnosed(handle) if handle.job.kind == GAP else self._fitted(handle))
            ended = handle.job
        except (ServiceError, CalibError) as error:
            handle.move(JobState.FAILED, outcome=Failure.of(error, REMEDY), progress=None)
            ended = error
        except Exception as defect:
            ended = defect
            raise
        finally:
            self._notify(handle.id, ended)
        self._forget_old_fits()

    async def _fitted(self, handle: JobHandle) -> None:
        order = handle.job.options
        fits = await self._computations.fit(
            order["recording"], order["method"], order["options"], progress=self._progress_of(handle)
        )
        self._note_started(handle)
        outcome = Result(_counted(fits, order["method"]), proof_reason=NOTHING_WRITTEN)
        warnings = fit_messages(fits)
        handle.move(JobState.SUCCEEDED, results=tuple(fits), outcome=outcome, warnings=warnings, progress=None)

    async def _diagnosed(self, handle: JobHandle) -> None:
        order = handle.job.options
        diagnosis = await self._computations.diagnose(
            order["real"],
            order["sim"],
            order["nominal"],
            limit_s=order.get("limit_s"),
            progress=self._progress_of(handle),
        )
        self._note_started(handle)
        for document in diagnosis.documents:
            await handle.store.do(partial(handle.store.save_document, handle.id, document))
        outcome = Result(diagnosis.summary, proof_reason=NOTHING_WRITTEN)
        names = [document.name for document in diagnosis.documents]
        context = {**handle.job.context, "documents": names}
        handle.move(JobState.SUCCEEDED, outcome=outcome, context=context, progress=None)

    def _waiting(self, kind: str) -> int:
        return sum(job.kind == kind and job.state not in ENDED for job in self._book.list())

    def _progress_of(self, handle: JobHandle) -> ProgressCallback:
        """A callback for the child's progress; its first message says that it has started."""
        steps = itertools.count()

        def report(text: str) -> None:
            self._note_started(handle)
            line, step = parse_line(text), next(steps)
            if line.share is None:
                handle.progress(Progress(float(min(step, STEPS)), float(STEPS), "steps", line.text))
            else:
                handle.progress(Progress(100.0 * line.share, 100.0, "%", line.text, line.left_s))

        return report

    def _note_started(self, handle: JobHandle) -> None:
        """Note that a child has started the job."""
        if handle.job.state == JobState.QUEUED:
            starts = handle.job.context.get("starts", 0) + 1
            handle.move(JobState.FITTING, context={**handle.job.context, "starts": starts})

    def _notify(self, job_id: str, ended: Job | Exception) -> None:
        future = self._waited_for.get(job_id)
        if future is None or future.done():
            return
        if isinstance(ended, Exception):
            future.set_exception(ended)
        else:
            future.set_result(ended)

    def _forget_old_fits(self) -> None:
        over = [job.id for job in self._book.list() if job.kind == FIT and job.state in ENDED]
        for job_id in over[:-MOST_FITS_KEPT]:
            self._book.forget(job_id)


def uploads_of(job: Job) -> set[str]:
    """The uploads that this job still needs; a fit that has ended needs none."""
    if job.kind == GAP:
        return {job.options["real"], *filter(None, [job.options["sim"]]), *job.options["nominal"]}
    if "recording" not in job.options or (job.kind == FIT and job.state in ENDED):
        return set()
    return {str(job.options["recording"])}


def _counted(fits: Sequence[FitResult], method: str) -> str:
    usable = sum(fit.status != FitStatus.REFUSED for fit in fits)
    plural = "" if len(fits) == 1 else "s"
    return f"{method} fitted {usable} of {len(fits)} sensor{plural}."
