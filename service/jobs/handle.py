"""One running job: its present value, and the ways to change and record it."""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from calib.procedures.protocol import Progress, Prompt
from calib.report import step_to_json
from service.errors import DiskFull
from service.jobs.codec import outcome_to_json, row_from_job
from service.jobs.journal import Step, WriteRecord, fold
from service.jobs.model import Job, advance
from service.jobs.states import JobState
from service.store.protocol import JobStore
from service.store.rows import EventRow, Json

Publish = Callable[[EventRow], None]


class JobHandle:
    """Holds a job while it runs. Every change of it is durable and announced before the call returns."""

    def __init__(
        self,
        job: Job,
        store: JobStore,
        publish: Publish,
        *,
        progress_s: float = 0.5,
        wall: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.job = job
        self.store = store
        self.answers: asyncio.Queue[str] = asyncio.Queue()
        self._publish = publish
        self._wall = wall
        self._clock = clock
        self._progress_s = progress_s
        self._progress_due = 0.0

    @property
    def id(self) -> str:
        """The job's id."""
        return self.job.id

    def now(self) -> float:
        """Wall-clock time, for stamps only."""
        return self._wall()

    def move(self, to: JobState, **changes: Any) -> None:
        """Go to another state. Raises IllegalTransition, DiskFull; the job is then as it was."""
        changed = advance(self.job, to, self._wall(), **changes)
        data = {"state": to.value, "outcome": outcome_to_json(changed.outcome)}
        self._keep(changed, "state", data)

    def move_anyway(self, to: JobState, **changes: Any) -> None:
        """Go to another state even if the store fails: the vehicle comes first, and recovery reads the vehicle."""
        changed = advance(self.job, to, self._wall(), **changes)
        try:
            self._keep(changed, "state", {"state": to.value, "outcome": outcome_to_json(changed.outcome)})
        except Exception as error:  # noqa: BLE001 - a job without a true state is worse than one that is not recorded
            self.job = changed
            why = "the disk is full" if isinstance(error, DiskFull) else "the store does not work"
            self.warn(f"{why}: the last steps of this job are not recorded")

    def change(self, kind: str, data: Json, **changes: Any) -> None:
        """Change something other than the state, with an event that says so."""
        self._keep(dataclasses.replace(self.job, updated_at=self._wall(), **changes), kind, data)

    def warn(self, text: str) -> None:
        """Add a warning, once; where the store fails it is only in memory."""
        if text in self.job.warnings:
            return
        warnings = (*self.job.warnings, text)
        try:
            self.change("warning", {"text": text}, warnings=warnings)
        except Exception:  # noqa: BLE001 - a warning never ends what it warns of
            self.job = dataclasses.replace(self.job, warnings=warnings)

    def prompt(self, prompt: Prompt | None) -> None:
        """Ask the operator something else, or nothing more; not durable, a restarted job asks anew."""
        if prompt != self.job.prompt:
            self.job = dataclasses.replace(self.job, prompt=prompt)
            self._tell("prompt", {} if prompt is None else step_to_json(prompt))

    def progress(self, progress: Progress) -> None:
        """Announce progress; not durable, and not more often than the settings say."""
        self.job = dataclasses.replace(self.job, progress=progress)
        now = self._clock()
        if now >= self._progress_due:
            self._progress_due = now + self._progress_s
            self._tell("progress", step_to_json(progress))

    async def record(self, step: Step, **data: Any) -> None:
        """Append to the journal; it is on the disk when this returns. Raises DiskFull."""
        await asyncio.to_thread(self.store.add_journal, self.id, self._wall(), step.value, data)

    async def record_anyway(self, step: Step, **data: Any) -> None:
        """Append to the journal if the store works: for steps that recovery would find out by reading the vehicle."""
        with suppress(Exception):
            await self.record(step, **data)

    def announce(self, kind: str, data: Json) -> None:
        """An event that says again what the job's state says already; lost if the store fails."""
        with suppress(Exception):
            self._tell(kind, data)

    def written(self) -> WriteRecord:
        """What the journal says."""
        return fold(self.store.journal(self.id))

    def _tell(self, kind: str, data: Json) -> None:
        self._publish(self.store.add_event(self.id, self._wall(), kind, data))

    def _keep(self, job: Job, kind: str, data: Json) -> None:
        event = self.store.save_job(row_from_job(job), event=(kind, data))
        self.job = job
        if event is not None:
            self._publish(event)
