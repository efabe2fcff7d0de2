"""A write from accept to its end, whatever happens on the way.

.. code-block:: text

    prepare ─> send_all ─> read_back ─> (restart) ─> check ─> finish ─> succeeded
       │           └───────────┴────────────┴──────────┴─────────┴─ failed ──> roll_back ─> reverted
       │           └───────────┴────────────┴──────────┴─────────┴─ armed, silent, conflict ─> in_doubt
       └─ nothing was sent ─> review             in_doubt ─ may be written to again ─> where the journal says

A running write and the recovery after a crash share everything behind ``prepare``.
"""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial

from calib.errors import CalibError
from calib.firmware.plan import Value, Verdict, Verification
from service.errors import ServiceError, WriteFailed, WriteStopped
from service.jobs.crashpoints import At
from service.jobs.finish import finish
from service.jobs.guard import STOPPING, Guard
from service.jobs.handle import JobHandle
from service.jobs.journal import Next, Step, decide, standing
from service.jobs.model import Failure, Outcome, Result
from service.jobs.restart import restart
from service.jobs.rollback import roll_back
from service.jobs.states import JobState
from service.jobs.streams import restore_streams
from service.jobs.write import Writing, prepare, read_back, read_values, send_all

BY_OPERATOR = "the operator asked for it"


@dataclass
class Transaction:
    """The write of one job. `attempt` makes the context of a new attempt with the vehicle as it is known now.

    `attempt` raises VehicleError while the vehicle is not there. Cancelling a running method is a crash: the journal
    decides at the next start.
    """

    handle: JobHandle
    attempt: Callable[[], Writing]
    retry_s: float
    _guard: Guard | None = None
    """That of the last attempt: it remembers how the vehicle was."""

    async def apply(self) -> None:
        """Write the plan. The job is applying; it ends succeeded or reverted, or in review if nothing was sent."""
        w = self.attempt()
        try:
            w.guard.check()
            await w.check.before(w.guard)
            await prepare(w)
        except (ServiceError, CalibError) as error:
            failure = Failure(getattr(error, "code", "write-failed"), str(error), "Nothing was written.")
            self.handle.move(JobState.REVIEW, accept=None, prompt=None, outcome=failure)
            return
        await self._carried(w, partial(_write, w))
        await self.resolve()

    async def revert(self) -> None:
        """Take a finished write back. The job is rolling_back."""
        w = self.attempt()
        await self._carried(w, partial(_take_back, w, BY_OPERATOR))
        await self.resolve()

    async def resolve(self) -> None:
        """Bring the job to its end if it is in doubt: as soon as its vehicle may be written to, and tries for ever."""
        while self.handle.job.state == JobState.IN_DOUBT:
            self._look_back()
            try:
                w = self.attempt()
                w.guard.check()
                await self._carried(w, partial(_resume, w))
            except ServiceError:
                pass  # the vehicle is not there, or not as it has to be: look again later
            if self.handle.job.state == JobState.IN_DOUBT:
                await asyncio.sleep(self.retry_s)

    async def _carried(self, w: Writing, stage: Callable[[], Awaitable[None]]) -> None:
        """Run a stage: what fails is taken back, what must not go on is left in doubt."""
        forget = w.vehicle.on_parameter(w.hear)
        try:
            await stage()
        except STOPPING as stop:
            await _doubt(w, str(stop))
        except Exception as error:  # noqa: BLE001 - whatever it was, the vehicle must not stay half-written
            await self._failed(w, error)
        finally:
            forget()
            self._guard = w.guard

    def _look_back(self) -> None:
        """What was certain when the write stopped need not be so any more, say after a restart of the vehicle."""
        doubt = None if self._guard is None else self._guard.doubt()
        known = self.handle.job.standing
        if doubt is not None and any(s.certain for s in known):
            changed = tuple(dataclasses.replace(s, certain=False, note=s.note or doubt) for s in known)
            self.handle.change("standing", {"note": doubt}, standing=changed)

    async def _failed(self, w: Writing, error: Exception) -> None:
        if self.handle.job.state in (JobState.ROLLING_BACK, JobState.IN_DOUBT):
            await _doubt(w, str(error))
            return
        try:
            await _take_back(w, str(error))
        except ServiceError as worse:
            await _doubt(w, str(worse))


async def _write(w: Writing) -> None:
    await send_all(w)
    values = await read_back(w)
    await _onward(w, Next.REBOOT if w.plan.needs_reboot else Next.VERIFY, values)


async def _resume(w: Writing) -> None:
    """Find out where the write stands, and go on from there."""
    record = w.handle.written()
    identity = await w.guard.run(w.vehicle.identify)
    if (identity.uid or "") != w.plan.fingerprint.uid:
        raise WriteStopped("another vehicle answers under this one's address")
    readings = await w.guard.run(partial(read_values, w.vehicle, [s.name for s in record.sent]))
    values = {name: reading.value for name, reading in readings.items()}
    following = decide(record, w.plan, values)
    if following == Next.NOTHING_SENT:
        await restore_streams(w.handle, w.vehicle)
        await w.handle.record(Step.CLOSED)
        text = "The write was interrupted before the first parameter: the vehicle is as it was."
        w.handle.move(JobState.REVIEW, accept=None, standing=(), outcome=Failure("interrupted", text, "Apply again."))
    elif following == Next.ROLL_BACK:
        await _take_back(w, record.rolling_back or "the write was interrupted in the middle")
    else:
        if following == Next.REBOOT:
            values = await read_back(w)  # what is to survive the restart must be saved
        await _onward(w, following, values)


async def _onward(w: Writing, following: Next, values: dict[str, Value]) -> None:
    """From "every parameter holds its new value" to the end."""
    if following == Next.REBOOT:
        w.handle.move(JobState.WAITING_FOR_REBOOT, standing=(), outcome=None)
        await restart(w)
        values = await read_back(w)
    w.handle.move(JobState.VERIFYING, standing=(), outcome=None)
    if following != Next.FINISH:
        verification = await w.check.after(w.guard, values)
        w.handle.change("verification", {"proved": verification.proved}, verification=verification, prompt=None)
        if verification.must_go:
            raise WriteFailed(verification.must_go)
        await w.handle.record(Step.VERIFIED)
        w.reach(At.VERIFIED)
    await finish(w)
    await restore_streams(w.handle, w.vehicle)
    await w.handle.record(Step.CLOSED)
    w.reach(At.CLOSED)
    w.handle.move(JobState.SUCCEEDED, outcome=Result(_summary(w.handle.job.verification)), standing=(), prompt=None)


async def _take_back(w: Writing, because: str) -> None:
    if w.handle.job.state != JobState.ROLLING_BACK:
        w.handle.move_anyway(JobState.ROLLING_BACK, standing=(), outcome=None, prompt=None)
    await w.handle.record_anyway(Step.ROLL_BACK, because=because)
    left = await roll_back(w)
    await restore_streams(w.handle, w.vehicle)
    await w.handle.record_anyway(Step.CLOSED)
    w.reach(At.CLOSED)
    w.handle.move_anyway(JobState.REVERTED, outcome=_taken_back(because), standing=left, prompt=None)


def _taken_back(because: str) -> Outcome:
    if because == BY_OPERATOR:
        return Result("The old values are back, read and verified.")
    return Failure("reverted", because, "The old values are back, read and verified. Plan again, or start a new job.")


async def _doubt(w: Writing, reason: str) -> None:
    """Nothing more is sent; say what is known of every parameter."""
    if w.handle.job.state == JobState.IN_DOUBT:
        return
    known = standing(w.handle.written(), w.heard, w.guard.doubt())
    await w.handle.record_anyway(Step.STOPPED, reason=reason)
    remedy = "Disarm the vehicle and keep it on the ground and in reach: this is then finished or taken back by itself."
    w.handle.move_anyway(JobState.IN_DOUBT, outcome=Failure("in-doubt", reason, remedy), standing=known, prompt=None)


def _summary(verification: Verification | None) -> str:
    """One sentence on what was proved."""
    if verification is None:
        return "Every parameter was written and read back."
    acting = [parameter.verdict for parameter in verification.parameters if parameter.acts_on_stream]
    if not acting:
        return "Every parameter was written and read back; none of them shows on a stream."
    count = {verdict: acting.count(verdict) for verdict in Verdict}
    text = (
        f"Every parameter was written and read back; of {len(acting)} that show on the stream, "
        f"{count[Verdict.PROVED]} are proved by it"
    )
    rest = [f"{count[v]} {v.value.replace('_', ' ')}" for v in (Verdict.CONSISTENT, Verdict.NOT_OBSERVABLE) if count[v]]
    return text + (f" ({', '.join(rest)})." if rest else ".")
