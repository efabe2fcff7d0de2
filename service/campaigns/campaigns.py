"""Campaigns: the same preflight, calibration, fit or diagnosis for many vehicles or logs, as one job.

Items wait in queues: vehicles in one, processor work in another, items that need a person in a third, where they hold
no place. No item ends a campaign. A campaign whose service was stopped continues with the items that have not ended.
"""

from __future__ import annotations

import asyncio
import dataclasses
import uuid
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, Protocol

import structlog

from mavcal.calib.errors import CalibError, InvalidInputError
from mavcal.calib.procedures.protocol import Progress
from mavcal.service.campaigns.items import OPEN, Item, ItemEnd, ItemOutcome, ended_by, item_from_row, row_from_item
from mavcal.service.errors import CampaignsBusy, IllegalTransition, ServiceError, StoreError
from mavcal.service.jobs.core.book import JobBook
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Failure, Job, Result
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.jobs.core.tasks import JobTasks
from mavcal.service.jobs.uploads import NOTHING_WRITTEN
from mavcal.service.store.sql import Store

log = structlog.get_logger(__name__)

CAMPAIGN = "campaign"
"""Kind of a job that goes through items: options `task` and those of the task."""
MOST_RUNNING = 8
"""Campaigns that may be running at a time."""
MOST_ITEMS = 100_000
"""Items of a campaign."""
WAITING_AT_ONCE = 256
"""Items of all campaigns that may wait for a person at a time; further ones keep their vehicle's place."""
ATTENDED = "attended"
"""Key of a campaign's context: a command runs it, and only that command's `resume` goes on with it."""
EACH_PROVES = "Each calibration is a job of its own and states its own proof."


class CampaignTask(StrEnum):
    """What a campaign does with every item."""

    PREFLIGHT = "preflight"
    CALIBRATE = "calibrate"
    RESTORE = "restore"
    FIT = "fit"
    GAP = "gap"


NOUNS: Mapping[CampaignTask, str] = dict.fromkeys(
    (CampaignTask.PREFLIGHT, CampaignTask.CALIBRATE, CampaignTask.RESTORE), "vehicle"
)
"""What an item is called; that of other tasks is a log."""


class QueuePlace:
    """An item's place in its queues, which it gives up while it waits for a person."""

    def __init__(self, held: Sequence[asyncio.Semaphore], waiting: asyncio.Semaphore) -> None:
        self._held, self._waiting = list(held), waiting
        self._waits = False

    async def wait_for_person(self) -> None:
        """Give the place to the next item while a person is awaited, unless too many wait already."""
        if not self._waits and not self._waiting.locked():
            await self._waiting.acquire()
            self.leave()
            self._held, self._waits = [self._waiting], True

    def leave(self) -> None:
        """Release the places in every queue."""
        while self._held:
            self._held.pop().release()


@dataclass(frozen=True)
class ItemTurn:
    """One item with what its work needs to process it."""

    campaign: Job
    item: Item
    place: QueuePlace
    again: bool
    """Whether it was begun before, by a service that was stopped."""

    @property
    def options(self) -> Mapping[str, Any]:
        """Options of the campaign."""
        return self.campaign.options


class ItemWork(Protocol):
    """Does a task with one item."""

    @property
    def lane(self) -> asyncio.Semaphore:
        """The queue in which items wait, those of all campaigns together."""

    @property
    def most_starts(self) -> int | None:
        """Most starts of an item during which the service stops: the item may be the cause. None: no limit."""

    async def run(self, turn: ItemTurn) -> ItemEnd:
        """Process the item. A ServiceError or CalibError ends this item alone."""

    async def cancelled(self, turn: ItemTurn) -> str:
        """End the work that :meth:`run` began, after a cancellation; returns how it ended."""


class Campaigns:
    """Begins campaigns and runs them to their end.

    Parameters
    ----------
    book
        Every job.
    tasks
        Run a job's work.
    clock, wall
        Monotonic time for estimates; wall-clock time for stamps.
    """

    def __init__(self, book: JobBook, tasks: JobTasks, clock: Callable[[], float], wall: Callable[[], float]) -> None:
        self._book, self._tasks = book, tasks
        self._clock, self._wall = clock, wall
        self._waiting = asyncio.Semaphore(WAITING_AT_ONCE)
        self.works: dict[CampaignTask, ItemWork] = {}
        """What is done for each task; filled before the first job is taken up."""

    async def begin(
        self,
        task: CampaignTask,
        options: Mapping[str, Any],
        subjects: Sequence[tuple[str, str]],
        *,
        attended: bool = False,
    ) -> Job:
        """A campaign through `subjects`, each with what a person calls it (or nothing).

        `options` may have ``at_once``, the most items of this campaign at a time. One that is `attended` is left
        interrupted by the next start of a service, until :meth:`resume`.

        Raises
        ------
        InvalidInputError
            If there is no subject, or one is named twice, or there are too many.
        CampaignsBusy
            If too many campaigns are running.
        """
        if not subjects:
            raise InvalidInputError(f"no {_noun(task)} is selected: a campaign needs one at least")
        if len(subjects) > MOST_ITEMS:
            raise InvalidInputError(f"{len(subjects)} items are more than the {MOST_ITEMS} of one campaign: split it")
        twice = [subject for subject, count in Counter(s for s, _ in subjects).items() if count > 1]
        if twice:
            raise InvalidInputError(f"{_noun(task)} {twice[0]} is named twice: name each once")
        running = sum(job.kind == CAMPAIGN and job.state not in ENDED for job in self._book.list())
        if running >= MOST_RUNNING:
            raise CampaignsBusy(f"{running} campaigns are running: try again when one has ended")
        now = self._wall()
        chosen = {**options, "task": task.value}
        context = {ATTENDED: attended}
        job = Job(uuid.uuid4().hex[:12], None, CAMPAIGN, chosen, JobState.QUEUED, now, now, context=context)
        handle = await self._book.new(job)
        rows = [row_from_item(job.id, Item(n, subject, name)) for n, (subject, name) in enumerate(subjects, 1)]
        await handle.store.do(partial(handle.store.add_items, rows))
        handle.move(JobState.RUNNING)
        self._spawn(handle)
        return handle.job

    def resume_at_start(self, handle: JobHandle) -> None:
        """Go on with a campaign whose service was stopped."""
        if handle.job.state == JobState.QUEUED:
            cause = "The service was stopped before the list of this campaign was kept. Nothing was begun."
            handle.move(JobState.FAILED, outcome=Failure("campaign-not-begun", cause, "Begin it again."))
        elif handle.job.state == JobState.RUNNING and handle.job.context.get(ATTENDED):
            self._interrupt(handle, "campaign-interrupted", "The command that ran this campaign was stopped.")
        elif handle.job.state == JobState.RUNNING:
            self._spawn(handle)

    async def resume(self, job_id: str) -> Job:
        """Go on with a campaign that was interrupted. Raises JobUnknown, IllegalTransition."""
        handle = self._book.handle(job_id)
        if handle.job.kind != CAMPAIGN or handle.job.state != JobState.INTERRUPTED:
            what = f"job {job_id} ({handle.job.kind}) is {handle.job.state}"
            raise IllegalTransition(f"{what}: only an interrupted campaign can be resumed")
        handle.move(JobState.RUNNING, outcome=None)
        self._spawn(handle)
        return handle.job

    async def interrupt(self, job_id: str) -> Job:
        """Stop a running campaign so that it can be resumed; jobs that it has begun go on. Raises JobUnknown."""
        handle = self._book.handle(job_id)
        task = self._tasks.running.get(job_id)
        if handle.job.kind == CAMPAIGN and handle.job.state == JobState.RUNNING and task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            self._interrupt(handle, "campaign-interrupted", "The campaign was stopped.")
        return handle.job

    def _spawn(self, handle: JobHandle) -> None:
        self._tasks.spawn(handle, partial(self._run, handle))

    async def _run(self, handle: JobHandle) -> None:
        """Process the items that have not ended; the job then succeeds, whatever their outcomes."""
        run = _Run(handle, self._clock, Counter(await handle.store.do(partial(handle.store.item_counts, handle.id))))
        try:
            await self._run_or_interrupt(handle, run)
        except asyncio.CancelledError:
            if handle.job.state == JobState.CANCELLED:
                change = partial(handle.store.change_outcomes, handle.id, OPEN, ItemOutcome.CANCELLED)
                await handle.store.do(change)
            raise
        if handle.job.state == JobState.RUNNING:
            task = CampaignTask(handle.job.options["task"])
            why = EACH_PROVES if handle.job.options.get("apply") else NOTHING_WRITTEN
            handle.move(JobState.SUCCEEDED, outcome=Result(run.text(_noun(task)), proof_reason=why), progress=None)

    async def _run_or_interrupt(self, handle: JobHandle, run: _Run) -> None:
        """Process the items; a campaign that cannot store their outcomes is interrupted."""
        try:
            await self._run_items(handle, run)
        except* StoreError as errors:
            log.error("campaign interrupted", job=handle.id, reason=str(errors.exceptions[0]))
            cause = f"What became of an item could not be kept: {errors.exceptions[0]}"
            self._interrupt(handle, "store-error", cause)

    async def _run_items(self, handle: JobHandle, run: _Run) -> None:
        work = self.works[CampaignTask(handle.job.options["task"])]
        own = asyncio.Semaphore(handle.job.options.get("at_once") or MOST_ITEMS)
        left = await handle.store.do(partial(handle.store.items, handle.id, limit=MOST_ITEMS, outcomes=OPEN))
        async with asyncio.TaskGroup() as group:
            for row in left:
                await own.acquire()  # first its own: a campaign that is cancelled here holds nothing of others
                await work.lane.acquire()
                place = QueuePlace((own, work.lane), self._waiting)
                doing = group.create_task(self._run_item(handle, work, item_from_row(row), place, run))
                doing.add_done_callback(partial(_left, place))

    async def _run_item(self, handle: JobHandle, work: ItemWork, item: Item, place: QueuePlace, run: _Run) -> None:
        """Process one item; its start and its outcome are stored."""
        again = item.starts > 0
        item = dataclasses.replace(
            item, outcome=ItemOutcome.RUNNING, began_at=self._wall(), starts=item.starts + 1, text=""
        )
        await _keep(handle, item)
        ended = await self._end_of(handle, work, ItemTurn(handle.job, item, place, again))
        for document in ended.documents:
            await handle.store.do(partial(handle.store.save_document, handle.id, document))
        item = _with(item, ended, self._wall())
        await _keep(handle, item)
        outcome = {"number": item.number, "subject": item.subject, "outcome": item.outcome.value, "code": item.code}
        handle.announce("item", {**outcome, "text": item.text, "job_id": item.job_id})
        run.count(item.outcome)

    async def _end_of(self, handle: JobHandle, work: ItemWork, turn: ItemTurn) -> ItemEnd:
        item = turn.item
        if work.most_starts is not None and item.starts > work.most_starts:
            text = f"The service was stopped {work.most_starts} times while this item ran: look into its log."
            return ItemEnd(ItemOutcome.FAILED, text, "computation-interrupted")
        try:
            return await work.run(turn)
        except asyncio.CancelledError:
            if handle.job.state == JobState.CANCELLED:
                ended = ItemEnd(ItemOutcome.CANCELLED, await work.cancelled(turn), "job-cancelled")
                await _keep(handle, _with(item, ended, self._wall()))
            raise
        except (ServiceError, CalibError) as error:
            return ended_by(error)
        except Exception as error:
            log.exception("item of a campaign broke", job=handle.id, item=item.number)
            text = f"A defect of the program ended this item ({type(error).__name__}); its log says more."
            return ItemEnd(ItemOutcome.FAILED, text, "internal-error")

    def _interrupt(self, handle: JobHandle, code: str, cause: str) -> None:
        remedy = f"`mavcal campaign resume {handle.id}` goes on with the items that have not ended."
        handle.move(JobState.INTERRUPTED, outcome=Failure(code, cause, remedy), progress=None)


def uploads_of_campaign(job: Job, store: Store) -> set[str]:
    """The uploads that a campaign still needs: those left to process, and those they are compared with."""
    over = job.state in ENDED - {JobState.INTERRUPTED}
    if over or job.options.get("task") not in {CampaignTask.FIT, CampaignTask.GAP}:
        return set()
    beside = {job.options.get("sim"), *job.options.get("nominal", ())} - {None}
    return {row.subject for row in store.items(job.id, limit=MOST_ITEMS, outcomes=OPEN)} | beside


@dataclass
class _Run:
    """Progress of one run of a campaign."""

    handle: JobHandle
    clock: Callable[[], float]
    counts: Counter[str]

    def __post_init__(self) -> None:
        self.began, self.ended = self.clock(), 0
        self.total = self.counts.total()
        for outcome in OPEN:
            self.counts.pop(outcome.value, None)

    def count(self, outcome: ItemOutcome) -> None:
        """Count an item that has ended, and announce it."""
        self.counts[outcome.value] += 1
        self.ended += 1
        done = self.counts.total()
        eta = (self.clock() - self.began) / self.ended * (self.total - done)
        text = f"{done} of {self.total}: {_list(self.counts)}"
        self.handle.progress(Progress(float(done), float(self.total), "items", text, eta))

    def text(self, noun: str) -> str:
        """All items by outcome, as a sentence."""
        return f"{self.total} {noun}{'' if self.total == 1 else 's'}: {_list(self.counts)}."


def _list(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{counts[o]} {o.value.replace('_', ' ')}" for o in ItemOutcome if counts.get(o))


def _left(place: QueuePlace, _: asyncio.Task[None]) -> None:
    place.leave()


def _noun(task: CampaignTask) -> str:
    return NOUNS.get(task, "log")


def _with(item: Item, ended: ItemEnd, at: float) -> Item:
    changes = {name: getattr(ended, name) for name in ("outcome", "text", "code", "job_id", "result")}
    return dataclasses.replace(item, ended_at=at, **changes)


async def _keep(handle: JobHandle, item: Item) -> None:
    await handle.store.do(partial(handle.store.save_item, row_from_item(handle.id, item)))
