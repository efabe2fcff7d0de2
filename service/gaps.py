"""Gap diagnoses of uploaded recordings: a child process each, one after the other, results kept as files."""

from __future__ import annotations

import asyncio
import json
import re
import secrets
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import structlog

from mavcal.calib.errors import CalibError
from mavcal.service.children import DIAGNOSE, Children, Limits
from mavcal.service.errors import ChildEnded, GapsBusy, GapUnfinished, GapUnknown
from mavcal.service.recordings import Recordings
from mavcal.service.store.rows import RecordingRow

log = structlog.get_logger(__name__)

Json = dict[str, Any]

MOST_WAITING = 8
"""Diagnoses that may be queued or running at a time."""

DAMAGED = "its record or report on the disk is damaged: ask for the diagnosis again"

_ID = re.compile(r"[0-9a-f]{16}")


class GapState(StrEnum):
    """Where a diagnosis stands."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class GapRow:
    """One diagnosis: its uploads and its state; `error` says why it failed."""

    id: str
    created_at: float
    real: str
    sim: str | None
    nominal: tuple[str, ...]
    state: GapState = GapState.QUEUED
    error: str | None = None


class Gaps:
    """The diagnoses of one data directory."""

    def __init__(self, recordings: Recordings, folder: Path, *, children: Children, limits: Limits) -> None:
        self._recordings = recordings
        self._folder = folder
        self._children = children
        self._limits = limits
        self._turn = asyncio.Semaphore(1)
        self._tasks: dict[str, asyncio.Task[None]] = {}
        folder.mkdir(parents=True, exist_ok=True)
        for row in self.all():
            if row.state in {GapState.QUEUED, GapState.RUNNING}:
                self._keep(replace(row, state=GapState.FAILED, error="the service was stopped: ask again"))

    def all(self) -> tuple[GapRow, ...]:
        """Every diagnosis, oldest first."""
        rows = [_row_of(path) for path in self._folder.glob("*.json")]
        return tuple(sorted((row for row in rows if row is not None), key=lambda row: row.created_at))

    def get(self, gap_id: str) -> GapRow:
        """The diagnosis of that id.

        Raises
        ------
        GapUnknown
            If there is none.
        """
        row = _row_of(self._folder / f"{gap_id}.json") if _ID.fullmatch(gap_id) else None
        if row is None:
            raise GapUnknown(f"there is no gap diagnosis {gap_id}; GET /api/v1/gaps lists them")
        return row

    def report(self, gap_id: str) -> Json | None:
        """The report's JSON; None while there is none. One that cannot be read makes a diagnosis that failed."""
        row = self.get(gap_id)
        if row.state is not GapState.DONE:
            return None
        try:
            loaded: Json = json.loads((self._folder / f"{gap_id}.report").read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            log.error("a gap report cannot be read", id=gap_id, reason=str(error))
            self._keep(replace(row, state=GapState.FAILED, error=DAMAGED))
            return None
        return loaded

    def page(self, gap_id: str) -> Path:
        """The file of the report's page.

        Raises
        ------
        GapUnfinished
            If there is none (yet).
        """
        row = self.get(gap_id)
        if row.state is not GapState.DONE:
            raise GapUnfinished(f"the diagnosis is {row.state.value}{f': {row.error}' if row.error else ''}")
        return self._folder / f"{gap_id}.html"

    def start(self, real: str, sim: str | None, nominal: Sequence[str]) -> GapRow:
        """Begin a diagnosis of uploads.

        Raises
        ------
        RecordingUnknown
            If an upload does not exist.
        GapsBusy
            If too many are waiting.
        """
        uploads = [self._recordings.get(i) for i in (real, *(() if sim is None else (sim,)), *nominal)]
        if len(self._tasks) >= MOST_WAITING:
            raise GapsBusy(f"{len(self._tasks)} diagnoses are waiting or running: try again when one has ended")
        row = GapRow(secrets.token_hex(8), time.time(), real, sim, tuple(nominal))
        self._keep(row)
        task = asyncio.create_task(self._run(row, uploads))
        self._tasks[row.id] = task
        task.add_done_callback(lambda _: self._tasks.pop(row.id, None))
        return row

    async def stop(self) -> None:
        """End what is running."""
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(self, row: GapRow, uploads: Sequence[RecordingRow]) -> None:
        error: str | None = "the service was stopped: ask again"
        try:
            async with self._turn:
                self._keep(replace(row, state=GapState.RUNNING))
                error = await self._diagnose(row, uploads)
        except Exception as defect:
            log.error("gap diagnosis failed", id=row.id, exc_info=defect)
            error = "an unexpected error; the log of the service has it under this id"
        finally:
            self._keep(replace(row, state=GapState.DONE if error is None else GapState.FAILED, error=error))

    async def _diagnose(self, row: GapRow, uploads: Sequence[RecordingRow]) -> str | None:
        """Have it diagnosed; what is wrong, None if nothing is."""
        parts = [{"path": str(u.path), "reading": u.body["reading"], "sha256": u.sha256} for u in uploads]
        order = {
            "real": parts[0],
            "sim": None if row.sim is None else parts[1],
            "nominal": parts[1 if row.sim is None else 2 :],
            "title": f"Sim-to-real gap of {uploads[0].name}",
            "out": str(self._folder / row.id),
        }
        try:
            await self._children.run(DIAGNOSE, order, self._limits)
        except CalibError as error:
            return _without_paths(str(error), uploads)
        except ChildEnded as ended:
            return f"the diagnosis ended without a report: {ended.cause}"
        return None

    def _keep(self, row: GapRow) -> None:
        path = self._folder / f"{row.id}.json"
        fresh = path.with_suffix(".new")
        fresh.write_text(json.dumps(asdict(row)), encoding="utf-8")
        fresh.replace(path)


def _row_of(path: Path) -> GapRow | None:
    """The row in a file; one that cannot be read is a diagnosis that failed."""
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        return GapRow(**{**fields, "nominal": tuple(fields["nominal"]), "state": GapState(fields["state"])})
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        log.error("the record of a gap diagnosis cannot be read", id=path.stem, reason=str(error))
        return GapRow(path.stem, 0.0, "", None, (), GapState.FAILED, DAMAGED)


def _without_paths(text: str, uploads: Sequence[RecordingRow]) -> str:
    for upload in uploads:
        text = text.replace(str(upload.path), upload.name).replace(upload.path.name, upload.name)
    return text
