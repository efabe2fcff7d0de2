"""One running job: its present value, and the ways to change and record it."""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from queue import SimpleQueue
from typing import Any

import structlog

from mavcal.calib.procedures.protocol import Progress, Prompt
from mavcal.service.errors import DiskFull
from mavcal.service.jobs.core.codec import row_from_job, to_json
from mavcal.service.jobs.core.journal import JournalStep, WriteRecord, fold
from mavcal.service.jobs.core.model import Job, advance
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.store.rows import EventRow, JournalRow, Json
from mavcal.service.store.sql import Store

log = structlog.get_logger(__name__)

RETRY_S = 1.0
"""Time between two attempts to store what the disk has refused, s."""
LAST_RETRY_S = 0.1
"""Time between two such attempts while the service ends, s."""
Publish = Callable[[EventRow], None]


class JobHandle:
    """Holds a running job. A change is queued for the store when the call returns, and announced once it is stored.

    The store keeps the order: changes made before a step of the journal are on the disk before it. A step is on the
    disk before :meth:`record` returns. Nothing waits for the disk on the event loop.
    """

    def __init__(
        self,
        job: Job,
        store: Store,
        publish: Publish,
        *,
        progress_s: float = 0.5,
        wall: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.job = job
        self.store = store
        self.answers: SimpleQueue[str] = SimpleQueue()
        self._publish = publish
        self._wall = wall
        self._clock = clock
        self.progress_s = progress_s
        """Least time between two announcements of progress, s."""
        self._progress_due = 0.0
        self._owed: list[tuple[Job, str, Json]] = []
        """Changes that are not on the disk yet; belongs to the store's thread."""
        self._owed_steps: list[tuple[float, JournalStep, Json]] = []
        """Steps of the journal that are not on the disk yet; belongs to the store's thread."""
        self._retrying = False

    @property
    def id(self) -> str:
        """The job's id."""
        return self.job.id

    def now(self) -> float:
        """Wall-clock time, for stamps only."""
        return self._wall()

    def move(self, to: JobState, **changes: Any) -> None:
        """Go to another state, also while the store does not work: recovery reads the vehicle.

        Raises IllegalTransition; the job is then as it was.
        """
        changed = advance(self.job, to, self._wall(), **changes)
        data = {"state": to.value, "outcome": to_json(changed.outcome)}
        self._keep(changed, "state", data)

    async def kept(self) -> None:
        """Wait until every change of the job is on the disk. Raises DiskFull."""
        await self.store.do(self._save_owed)

    @property
    def owes(self) -> bool:
        """Whether a change or a step is not stored yet."""
        return bool(self._owed or self._owed_steps)

    async def kept_at_last(self, limit_s: float) -> bool:
        """Retry unsaved changes for at most `limit_s`; returns whether all are stored."""
        deadline = self._clock() + limit_s
        while True:
            try:
                await self.kept()
            except Exception as error:  # noqa: BLE001 - the service ends: the next start reads the vehicle
                if self._clock() >= deadline:
                    log.error("the last changes of a job are not on the disk", job=self.id, reason=str(error))
                    return False
                await asyncio.sleep(LAST_RETRY_S)
            else:
                return True

    def change(self, kind: str, data: Json, **changes: Any) -> None:
        """Change something other than the state, with an event that says so."""
        self._keep(dataclasses.replace(self.job, updated_at=self._wall(), **changes), kind, data)

    def warn(self, text: str) -> None:
        """Add a warning, once."""
        if text not in self.job.warnings:
            self.change("warning", {"text": text}, warnings=(*self.job.warnings, text))

    def prompt(self, prompt: Prompt | None) -> None:
        """Change or remove the operator's prompt. It is not stored: a restarted job asks again.

        A job that has ended asks nothing, even while the watch of its vehicle is being ended.
        """
        if prompt != self.job.prompt and self.job.state not in ENDED:
            self.job = dataclasses.replace(self.job, prompt=prompt)
            self._emit("prompt", {} if prompt is None else to_json(prompt))

    def progress(self, progress: Progress) -> None:
        """Announce progress; not durable, and not more often than the settings say."""
        self.job = dataclasses.replace(self.job, progress=progress)
        now = self._clock()
        if now >= self._progress_due:
            self._progress_due = now + self.progress_s
            self._emit("progress", to_json(progress))

    async def record(self, step: JournalStep, **data: Any) -> None:
        """Append to the journal; it and every change before it are on the disk when this returns. Raises DiskFull."""
        at = self._wall()

        def append() -> None:
            self._save_owed()
            self.store.add_journal(self.id, at, step.value, data)

        await self.store.do(append)

    async def record_anyway(self, step: JournalStep, **data: Any) -> None:
        """Append to the journal, later if the store does not work: for steps that recovery finds out by reading the
        vehicle.
        """
        try:
            await self.record(step, **data)
        except Exception as error:  # noqa: BLE001 - the vehicle comes first
            at = self._wall()
            await self.store.do(lambda: self._owed_steps.append((at, step, data)))
            self._retry_later(asyncio.get_running_loop())
            why = "the disk is full" if isinstance(error, DiskFull) else "the store does not work"
            self.warn(f"{why}: the last steps of this job are recorded late, or not at all if the service ends now")

    def announce(self, kind: str, data: Json) -> None:
        """Announce an event that repeats the job's state; it is lost if the store fails."""
        with suppress(Exception):
            self._emit(kind, data)

    def write_record(self) -> WriteRecord:
        """Record of the write by the journal, unsaved steps included."""
        owed = tuple(self._owed_steps)  # first: what is saved meanwhile is then in both, and never in neither
        rows = self.store.journal(self.id)
        kept = {(row.at, row.step, row.data.get("name")) for row in rows}
        late = [JournalRow(0, self.id, at, step.value, data) for at, step, data in owed]
        return fold((*rows, *(row for row in late if (row.at, row.step, row.data.get("name")) not in kept)))

    def _emit(self, kind: str, data: Json) -> None:
        at = self._wall()

        def add() -> None:
            try:
                self._publish(self.store.add_event(self.id, at, kind, data))
            except Exception as error:  # noqa: BLE001 - not durable: who watches sees the next one
                log.warning("an event of a job is lost", job=self.id, kind=kind, reason=str(error))

        self.store.soon(add)

    def _keep(self, job: Job, kind: str, data: Json) -> None:
        self.job = job
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:  # nobody waits for a later attempt
            loop = None

        def save() -> None:
            self._owed.append((job, kind, data))
            self._try_owed(loop)

        self.store.soon(save)

    def _try_owed(self, loop: asyncio.AbstractEventLoop | None) -> None:
        """Save what is owed, in the store's thread; refused changes are tried again later."""
        try:
            self._save_owed()
        except Exception as error:  # noqa: BLE001 - tried again with the next change, and after a while
            log.error("a change of a job is not on the disk yet", job=self.id, reason=str(error))
            if loop is not None:
                with suppress(RuntimeError):  # the loop has ended: the next start reads the vehicle
                    loop.call_soon_threadsafe(self._retry_later, loop)

    def _retry_later(self, loop: asyncio.AbstractEventLoop) -> None:
        if not self._retrying:
            self._retrying = True
            loop.call_later(RETRY_S, self._retry, loop)

    def _retry(self, loop: asyncio.AbstractEventLoop) -> None:
        self._retrying = False
        with suppress(RuntimeError):  # the store is closed
            self.store.soon(partial(self._try_owed, loop))

    def _save_owed(self) -> None:
        """Save what could not be saved before, in the store's thread, with every later change and step."""
        while self._owed_steps:
            at, step, data = self._owed_steps[0]
            self.store.add_journal(self.id, at, step.value, data)
            del self._owed_steps[0]
        while self._owed:
            job, kind, data = self._owed[0]
            event = self.store.save_job(row_from_job(job), event=(kind, data))
            del self._owed[0]
            if event is not None:
                self._publish(event)


@asynccontextmanager
async def waiting(
    handle: JobHandle, what: str, expected_s: float | None = None, *, limit_s: float = 0.0
) -> AsyncIterator[None]:
    """Report progress while the block runs: what is awaited, for how long, and how much longer or at most."""
    began = time.monotonic()

    async def report() -> None:
        while True:
            spent = time.monotonic() - began
            left = None if expected_s is None or spent > expected_s else expected_s - spent
            handle.progress(Progress(spent, max(spent, expected_s or limit_s), "s", what, left))
            await asyncio.sleep(handle.progress_s)

    reporting = asyncio.create_task(report(), name=f"progress of {handle.id}")
    try:
        yield
    finally:
        reporting.cancel()
        await asyncio.gather(reporting, return_exceptions=True)


def counting(handle: JobHandle, what: str) -> Callable[[int, int], None]:
    """A callback for items done and in total, which reports progress with the remaining time."""
    began = time.monotonic()

    def report(done: int, total: int) -> None:
        spent = time.monotonic() - began
        eta = spent * (total - done) / done if done else None
        handle.progress(Progress(float(done), float(total), "", f"{what}: {done} of {total}", eta))

    return report
