"""Outcome and standing of a job after a write, both made from the same readings of its vehicle.

No other module makes either, so a sentence never claims more than was read. None of it may fail.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import structlog

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware.plan import Value, Verification, WritePlan
from mavcal.calib.firmware.values import shown
from mavcal.service.errors import ServiceError, WriteFailed
from mavcal.service.jobs.core.codec import to_json
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.journal import JournalStep, WriteRecord, as_heard
from mavcal.service.jobs.core.model import Attempt, Failure, Holds, Outcome, Result, Standing, Unwritten, WriteResult
from mavcal.service.jobs.core.proof import Proof, ProofLevel, proof_of
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.guard import RESTARTED, WriteGuard

log = structlog.get_logger(__name__)

NAMED = 3
"""Parameters named in a sentence, at most; `standing` lists them all."""
RESOLVE = "Disarm the vehicle and keep it on the ground and in reach: this is then finished or taken back by itself."
READ_BACK_ONLY = Proof(ProofLevel.NONE, "The old values were read back; no stream was checked.")
RESULTS: Mapping[JobState, WriteResult] = {
    JobState.REVIEW: WriteResult.FAILED,
    JobState.IN_DOUBT: WriteResult.IN_DOUBT,
    JobState.REVERTED: WriteResult.REVERTED,
    JobState.SUCCEEDED: WriteResult.SUCCEEDED,
}
INTERRUPTED = "the service was interrupted while it wrote"


@dataclass(frozen=True)
class WriteOutcome:
    """The state in which a write ended or stopped, with its outcome and the standing of its parameters."""

    state: JobState
    outcome: Outcome
    standing: tuple[Standing, ...] = ()
    sent: int = 0
    """Parameters for which a PARAM_SET may have left."""


def nothing_sent(code: str, cause: str, remedy: str = "Nothing was written.") -> WriteOutcome:
    """The write ended before its first PARAM_SET: the vehicle is as it was."""
    return WriteOutcome(JobState.REVIEW, Unwritten(code, cause, remedy))


def in_doubt(known: Sequence[Standing], cause: str) -> WriteOutcome:
    """The write stopped; `known` is every parameter that was sent, or may have been."""
    return WriteOutcome(JobState.IN_DOUBT, Failure("in-doubt", cause, RESOLVE), tuple(known), len(known))


def reverted(read: Sequence[Standing], cause: str | None, who: str, sent: int) -> WriteOutcome:
    """The write was rolled back and every parameter read; `cause` is None if the operator asked for it.

    Raises
    ------
    WriteFailed
        If a parameter holds our value still, or was not read: then nothing was taken back.
    """
    ours = [s.name for s in read if s.holds in (Holds.NEW, Holds.UNKNOWN)]
    if ours:
        raise WriteFailed(f"these parameters still hold the new value: {', '.join(ours)}")
    away = tuple(s for s in read if s.holds == Holds.OTHER)
    if not away:
        text = "The old values are back, read and verified."
    elif len(away) == len(read):
        text = f"No old value is back: {_changed(away, who)}."
    else:
        text = f"The old values are back, read and verified, except {_changed(away, who)}."
    if cause is None:
        proof = READ_BACK_ONLY
        return WriteOutcome(JobState.REVERTED, Result(text, proof.level, proof.reason), away, sent)
    remedy = f"{text} Start a new job."
    return WriteOutcome(JobState.REVERTED, Failure("reverted", cause, remedy), away, sent)


def succeeded(read: Sequence[Standing], plan: WritePlan, verification: Verification | None, who: str) -> WriteOutcome:
    """Every parameter of the plan was read at the end; only session settings may have been left to others.

    Raises
    ------
    WriteFailed
        If a parameter does not hold its new value: then it is no success.
    """
    session = {change.name for change in plan.changes if change.session}
    wrong = [s for s in read if s.name not in session and s.holds != Holds.NEW and s.value != s.new]
    if wrong:
        named = ", ".join(f"{s.name} holds {shown(s.value)} instead of {shown(s.new)}" for s in wrong)
        raise WriteFailed(f"the read-back differs: {named}")
    away = tuple(s for s in read if s.name in session and s.holds != Holds.OLD)
    proof = proof_of(verification)
    text = f"Every parameter was written and read back. {proof.reason}"
    if away:
        text += f" The settings of this session are back, except {_changed(away, who)}."
    return WriteOutcome(JobState.SUCCEEDED, Result(text, proof.level, proof.reason, proof.unproved), away, len(read))


def _changed(away: Sequence[Standing], who: str) -> str:
    """``X, which somebody else set to 0.1 (0.2 before)``; several with their values in brackets."""
    if len(away) == 1:
        only = away[0]
        return f"{only.name}, which {who} set to {shown(only.value)} ({shown(only.old)} before)"
    named = [f"{s.name} (now {shown(s.value)}, {shown(s.old)} before)" for s in away[:NAMED]]
    more = len(away) - len(named)
    listed = ", ".join(named) + (f" and {more} more" if more else "")
    return f"{listed}, which {who} set"


def conclude(handle: JobHandle, ending: WriteOutcome) -> None:
    """Bring the job to the state of `ending`, with the last attempt as a field and as the event ``write``."""
    of = ending.outcome
    cause, remedy = (of.cause, of.remedy) if isinstance(of, Failure) else (of.text, "")
    attempt = Attempt(RESULTS[ending.state], handle.now(), cause, remedy, ending.sent)
    changes: dict[str, Any] = {"accept": None} if ending.state == JobState.REVIEW else {}
    handle.move(
        ending.state, outcome=ending.outcome, standing=ending.standing, last_write=attempt, prompt=None, **changes
    )
    handle.announce("write", to_json(attempt))


async def put_in_doubt(handle: JobHandle, reason: str, heard: Mapping[str, Value], guard: WriteGuard | None) -> None:
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
    conclude(handle, in_doubt(_known(handle, record, heard, doubt), _cause(record, reason)))


async def withdraw_certainty(handle: JobHandle, guard: WriteGuard) -> None:
    """Mark values as uncertain that may have changed since the write stopped, for example by a restart."""
    doubt, record = guard.doubt(), record_of(handle)
    if doubt is None:
        return
    if guard.restarted and record is not None and not record.restarted:
        await handle.record_anyway(JournalStep.STOPPED, reason=RESTARTED, restarted=True)
        record = record_of(handle)
    before = handle.job
    lost: dict[str, Any] = {"certain": False, "holds": Holds.UNKNOWN}
    known = tuple(dataclasses.replace(s, note=s.note or doubt, **lost) if s.certain else s for s in before.standing)
    ending = in_doubt(known, _cause(record, getattr(before.outcome, "cause", doubt)))
    if (ending.standing, ending.outcome) != (before.standing, before.outcome):
        handle.change("standing", {"note": doubt}, standing=ending.standing, outcome=ending.outcome)


def record_of(handle: JobHandle) -> WriteRecord | None:
    """The record of the write in the journal; None: it cannot be read."""
    try:
        return handle.write_record()
    except Exception:  # of any kind: a damaged journal must not keep a job from its ending; logged with its trace
        log.exception("journal unreadable", job=handle.id)
        return None


def cause_of(error: Exception) -> str:
    """The cause in one sentence; details of an unexpected error are in the log."""
    if isinstance(error, ServiceError | CalibError):
        return str(error)
    log.error("a write broke", exc_info=error)
    return f"a defect of the program stopped the write ({type(error).__name__}); its log says more"


def _cause(record: WriteRecord | None, reason: str) -> str:
    """The first reason why the write stopped; later ones are its consequences."""
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


def nothing_was_sent(handle: JobHandle) -> bool:
    """Whether the journal says that no PARAM_SET of this write may have left."""
    record = record_of(handle)
    return handle.job.state == JobState.APPLYING and record is not None and not record.sent


async def settle_lost_write(handle: JobHandle, reason: str) -> None:
    """Put a job in doubt whose write lost its task, or back to review if nothing was sent."""
    if nothing_was_sent(handle):
        conclude(handle, nothing_sent("interrupted", reason, "Nothing was written. Apply the plan again."))
    else:
        await put_in_doubt(handle, reason, {}, None)
