"""Campaigns through a folder of logs, on any executor: no vehicle, no link and no upload is needed."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.methods import METHODS
from mavcal.service.campaigns.campaigns import Campaigns, CampaignTask, ItemTurn, ItemWork
from mavcal.service.campaigns.executors import Workers
from mavcal.service.campaigns.items import ItemEnd, ItemOutcome, of_diagnosis, of_fits
from mavcal.service.campaigns.worker import Json, computed
from mavcal.service.children import DIAGNOSE, FIT, Limits
from mavcal.service.computations import PAGE, REPORT
from mavcal.service.jobs.core.admission import require_finite
from mavcal.service.jobs.core.book import JobBook
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.ports import Alone
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.tasks import JobTasks
from mavcal.service.jobs.uploads import MOST_STARTS
from mavcal.service.store import SqliteStore, Store
from mavcal.service.store.rows import JobDocument

FOLDER = "folder"
"""Option with the folder of a campaign through files, which is never run by a service."""


def files_of(folder: Path, pattern: str) -> list[str]:
    """Files below a folder whose name is like `pattern`, by their paths below it; hidden ones are left out.

    Raises
    ------
    InvalidInputError
        If there is no such folder, or no such file in it.
    """
    if not folder.is_dir():
        raise InvalidInputError(f"there is no folder {folder}")
    below = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    shown = (path for path in below if not any(part.startswith(".") for part in path.parts))
    found = sorted(path.as_posix() for path in shown if fnmatch(path.name, pattern))
    if not found:
        raise InvalidInputError(f"there is no file like {pattern} in {folder}")
    return found


@dataclass(frozen=True)
class FolderWork:
    """Work on each file by a worker process with limits."""

    workers: Workers
    limits: Limits
    lane: asyncio.Semaphore
    most_starts: int | None = MOST_STARTS

    async def cancelled(self, turn: ItemTurn) -> str:
        """See ItemWork."""
        return "The campaign was cancelled."


class FolderFits(FolderWork):
    """Fits each file by one method. Options: `folder`, `reading`, `method`, `options`."""

    async def run(self, turn: ItemTurn) -> ItemEnd:
        """See ItemWork."""
        method = turn.options["method"]
        order = {**_part(turn), "method": method, "options": turn.options["options"], "origin": False}
        answer = await _on(self.workers, FIT, order, self.limits)
        if "error" in answer:
            return _failed(answer["error"], turn)
        return of_fits(answer["done"]["fits"], method, sha256=answer["sha256"], seconds=answer["seconds"])


class FolderGaps(FolderWork):
    """Diagnoses the gap of each file. Options: `folder`, `reading`, `sim`, `nominal`."""

    async def run(self, turn: ItemTurn) -> ItemEnd:
        """See ItemWork."""
        options, part = turn.options, _part(turn)
        order: Json = {
            "path": part["path"],
            "real": part,
            "sim": None if options["sim"] is None else {**part, "path": options["sim"]},
            "nominal": [{**part, "path": path} for path in options["nominal"]],
            "title": f"Sim-to-real gap of {Path(turn.item.subject).name}",
        }
        answer = await _on(self.workers, DIAGNOSE, order, self.limits)
        if "error" in answer:
            return _failed(answer["error"], turn)
        done = answer["done"]
        report, page = json.dumps(done["report"], allow_nan=False), str(done["page"])
        documents = (
            JobDocument(REPORT, "application/json", report.encode()),
            JobDocument(PAGE, "text/html", page.encode()),
        )
        more = {"sha256": answer["sha256"], "seconds": answer["seconds"]}
        return of_diagnosis(turn.item, done["summary"], done["report"], documents, **more)


@dataclass(frozen=True)
class Archive:
    """The campaigns of a data directory that no service runs now."""

    store: Store
    campaigns: Campaigns
    book: JobBook

    async def fit(self, folder: Path, pattern: str, method: str, options: Mapping[str, Any], **more: Any) -> Job:
        """A method on each file; `more`: `reading` and `at_once`. Raises InvalidInputError."""
        if method not in METHODS:
            raise InvalidInputError(f"there is no method {method!r}; there are {', '.join(METHODS)}")
        require_finite(options)
        return await self._begin(CampaignTask.FIT, folder, pattern, {"method": method, "options": options, **more})

    async def gap(self, folder: Path, pattern: str, sim: Path | None, nominal: Sequence[Path], **more: Any) -> Job:
        """A diagnosis of each file; `more`: `reading` and `at_once`. Raises InvalidInputError."""
        beside = {"sim": None if sim is None else _whole(sim), "nominal": [_whole(path) for path in nominal]}
        return await self._begin(CampaignTask.GAP, folder, pattern, {**beside, **more})

    async def resume(self, job_id: str) -> Job:
        """Go on with a campaign, whatever stopped it. Raises JobUnknown, IllegalTransition."""
        self.campaigns.resume_at_start(self.book.handle(job_id))
        return await self.campaigns.resume(job_id)

    async def _begin(self, task: CampaignTask, folder: Path, pattern: str, options: Mapping[str, Any]) -> Job:
        found = await asyncio.to_thread(files_of, folder, pattern)
        chosen = {**options, FOLDER: _whole(folder)}
        return await self.campaigns.begin(task, chosen, [(path, "") for path in found], attended=True)


@asynccontextmanager
async def archive(data_dir: Path, given: Workers, of_fits: Limits, of_gaps: Limits) -> AsyncIterator[Archive]:
    """The campaigns of a data directory, with `given` to do their work; what runs at the end is left interrupted.

    Raises
    ------
    DataDirLocked
        If another process owns the data directory.
    """
    store = SqliteStore(data_dir)
    settings = JobSettings()
    book = JobBook(store, Alone(store), settings.progress_s, time.monotonic, time.time)
    tasks = JobTasks(settings.retry_s, _never_written, lambda _: None)
    campaigns = Campaigns(book, tasks, time.monotonic, time.time)
    lane = asyncio.Semaphore(given.at_once)
    works: dict[CampaignTask, ItemWork] = {
        CampaignTask.FIT: FolderFits(given, of_fits, lane),
        CampaignTask.GAP: FolderGaps(given, of_gaps, lane),
    }
    campaigns.works |= works
    try:
        book.load()
        yield Archive(store, campaigns, book)
    finally:
        for job_id in tuple(tasks.running):
            await campaigns.interrupt(job_id)
        book.close()
        store.close()


def _whole(path: Path) -> str:
    return str(path.absolute())


async def _never_written(_handle: JobHandle, _reason: str) -> None:
    """Do nothing: a campaign of files writes to no vehicle, so that nothing has to be recovered."""


async def _on(given: Workers, task: str, order: Json, limits: Limits) -> Json:
    return await asyncio.get_running_loop().run_in_executor(given.executor, computed, task, order, limits)


def _part(turn: ItemTurn) -> Json:
    path = Path(turn.options[FOLDER]) / turn.item.subject
    return {"path": str(path), "reading": dict(turn.options.get("reading") or {})}


def _failed(error: Mapping[str, str], turn: ItemTurn) -> ItemEnd:
    """End of an item whose file could not be fitted; the reason does not name the folder."""
    text = error["text"].replace(f"{turn.options[FOLDER]}/", "")
    return ItemEnd(ItemOutcome.FAILED, text[:1].upper() + text[1:], error["code"])
