"""Ends or stops a write: the only place that sets a job's outcome and standing. None of it may fail."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import structlog

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware.plan import Value
from mavcal.service.errors import ServiceError
from mavcal.service.jobs.account import Account, as_heard, in_doubt, nothing_sent
from mavcal.service.jobs.codec import to_json
from mavcal.service.jobs.guard import RESTARTED, WriteGuard
from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.journal import JournalStep, WriteRecord
from mavcal.service.jobs.model import Attempt, Failure, Holds, Standing, WriteResult
from mavcal.service.jobs.states import CAPTURING, JobState

log = structlog.get_logger(__name__)

RESULTS: Mapping[JobState, WriteResult] = {
    JobState.REVIEW: WriteResult.FAILED,
    JobState.IN_DOUBT: WriteResult.IN_DOUBT,
    JobState.REVERTED: WriteResult.REVERTED,
    JobState.SUCCEEDED: WriteResult.SUCCEEDED,
}
INTERRUPTED = "the service was interrupted while it wrote"
LOST = "the write lost its task, by a defect of the program; its log says more"


def end(handle: JobHandle, told: Account) -> None:
    """Bring the job to the state of `told`, with the last attempt as a field and as the event ``write``."""
    cause, remedy = _said(told)
    attempt = Attempt(RESULTS[told.state], handle.now(), cause, remedy, told.sent)
    changes: dict[str, Any] = {"accept": None} if told.state == JobState.REVIEW else {}
    handle.move_anyway(
        told.state, outcome=told.outcome, standing=told.standing, last_write=attempt, prompt=None, **changes
    )
    handle.announce("write", to_json(attempt))


def _said(told: Account) -> tuple[str, str]:
    if isinstance(told.outcome, Failure):
        return told.outcome.cause, told.outcome.remedy
    return told.outcome.text, ""


async def stop(handle: JobHandle, reason: str, heard: Mapping[str, Value], guard: WriteGuard | None) -> None:
    """Put the job in doubt: nothing more is sent, and every parameter that may have been is listed.

    `guard` is that of the attempt that stopped; None: the service itself was interrupted.
    """
    if handle.job.state == JobState.IN_DOUBT:
        return
    restarted, silent = guard is not None and guard.restarted, guard is not None and guard.silent
    await handle.record_anyway(
        JournalStep.STOPPED, reason=reason, restarted=restarted, silent=silent, interrupted=guard is None
    )
    doubt = "before the service was interrupted" if guard is None else guard.doubt()
    record = record_of(handle)
    end(handle, in_doubt(_known(handle, record, heard, doubt), _cause(record, reason)))


async def look_back(handle: JobHandle, guard: WriteGuard) -> None:
    """What was certain when the write stopped need not be so any more, say after a restart of the vehicle."""
    doubt, record = guard.doubt(), record_of(handle)
    if doubt is None:
        return
    if guard.restarted and record is not None and not record.restarted:
        await handle.record_anyway(JournalStep.STOPPED, reason=RESTARTED, restarted=True)
        record = record_of(handle)
    before = handle.job
    lost: dict[str, Any] = {"certain": False, "holds": Holds.UNKNOWN}
    known = tuple(dataclasses.replace(s, note=s.note or doubt, **lost) if s.certain else s for s in before.standing)
    told = in_doubt(known, _cause(record, getattr(before.outcome, "cause", doubt)))
    if (told.standing, told.outcome) != (before.standing, before.outcome):
        handle.change("standing", {"note": doubt}, standing=told.standing, outcome=told.outcome)


def record_of(handle: JobHandle) -> WriteRecord | None:
    """What the journal says; None: it cannot be read."""
    try:
        return handle.written()
    except Exception:  # of any kind: a damaged journal must not keep a job from its ending; logged with its trace
        log.exception("journal unreadable", job=handle.id)
        return None


def cause_of(error: Exception) -> str:
    """One sentence on what went wrong; what was not foreseen is named, and its details are in the program's log."""
    if isinstance(error, ServiceError | CalibError):
        return str(error)
    log.error("a write broke", exc_info=error)
    return f"a defect of the program stopped the write ({type(error).__name__}); its log says more"


def _cause(record: WriteRecord | None, reason: str) -> str:
    """The first reason why it stopped stays: what was found later are its consequences."""
    return reason if record is None or record.stopped is None else record.stopped


def _known(
    handle: JobHandle, record: WriteRecord | None, heard: Mapping[str, Value], doubt: str | None
) -> tuple[Standing, ...]:
    """Every parameter that may have been sent; without a journal, all of the plan."""
    known = () if record is None else as_heard(record, heard, doubt)
    if known or handle.job.plan is None:
        return known
    note = "the journal cannot be read: whether it was sent is not known"
    changes = handle.job.plan.changes
    return tuple(Standing(c.name, c.old, c.new, None, certain=False, note=note) for c in changes)


async def doubt(handle: JobHandle, reason: str) -> None:
    """Put a job whose write lost its task in doubt; one that has sent nothing goes back to review."""
    record = record_of(handle)
    if handle.job.state == JobState.APPLYING and record is not None and not record.sent:
        end(handle, nothing_sent("interrupted", reason, "Nothing was written. Apply the plan again."))
    else:
        await stop(handle, reason, {}, None)


def broke(handle: JobHandle, error: BaseException) -> None:
    """Note a defect in a job's work; a job that has written nothing ends with it."""
    log.error("job broke", job=handle.id, state=handle.job.state, exc_info=error)
    if handle.job.state in CAPTURING | {JobState.FITTING}:
        cause = f"a defect of the program ended the job ({type(error).__name__})"
        remedy = "Its log says more. What was recorded is kept."
        handle.move_anyway(JobState.FAILED, outcome=Failure("internal-error", cause, remedy), prompt=None)
