"""Deletes old uploads, telemetry logs, events and request keys, but never what a job rests on.

A link that stays open goes on in another telemetry log now and then, so that old ones can be forgotten.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import structlog

from mavcal.service.errors import StoreError
from mavcal.service.link.link import Link
from mavcal.service.settings import RetentionSettings
from mavcal.service.store.sql import Store

log = structlog.get_logger(__name__)

PERIOD_S = 3600.0
DAY_S = 86400.0
LOOK_S = 10.0
HOUR_S = 3600.0


@dataclass(frozen=True)
class Removable:
    """A recording that may be deleted: an upload, or a telemetry log that no link writes any more."""

    path: Path
    at: float
    size: int
    upload: str | None


@dataclass
class Retention:
    """Deletes what the settings allow. `needed` are uploads, `open_files` telemetry logs, that must stay for now."""

    store: Store
    settings: RetentionSettings
    tlog_dir: Path
    needed: Callable[[], Collection[str]]
    open_files: Callable[[], Collection[Path]]
    wall: Callable[[], float] = time.time
    sweep_now: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when there is more to forget than usual: the next sweep comes at once."""

    async def run(self) -> None:
        """Delete what is due at intervals, until cancelled."""
        while True:
            try:
                await self.sweep()
            except Exception:  # of any kind: one bad row must not end all sweeps until a restart; logged with its trace
                log.exception("nothing was forgotten this time")
            self.sweep_now.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(PERIOD_S):  # no wait_for: that of Python 3.11 can lose a cancellation
                    await self.sweep_now.wait()

    async def sweep(self) -> None:
        """Delete what is due."""
        needed, held = set(self.needed()), set(self.open_files())
        await self.store.do(lambda: self._forget_rows())
        items = await asyncio.to_thread(self._items, needed, held)
        for item in due(items, self.wall(), self.settings):
            await self.store.do(lambda: self._forget(item))  # noqa: B023 - done before the next one
            log.info("recording forgotten", upload=item.upload, bytes=item.size)

    def _forget_rows(self) -> None:
        now, kept = self.wall(), self.settings
        self.store.drop_old_events(now - kept.events_days * DAY_S, most=kept.events)
        self.store.drop_old_keys(now - kept.keys_days * DAY_S, most=kept.keys)

    def _items(self, needed: set[str], held: set[Path]) -> list[Removable]:
        """Everything that may be deleted: no upload of a job or diagnosis, no log with a segment of any job."""
        uploads = [
            Removable(row.path, row.at, row.size, row.id) for row in self.store.recordings() if row.id not in needed
        ]
        evidence = {path.resolve() for path in (*self.store.segment_paths(), *held)}
        logs = (path for path in self.tlog_dir.glob("*.tlog") if path.resolve() not in evidence)
        return [*uploads, *filter(None, map(_log, logs))]

    def _forget(self, item: Removable) -> None:
        """Delete the row before its file: a crash between them then leaves no row without a file."""
        if item.upload is not None:
            self.store.delete_recording(item.upload)
        elif item.path.resolve() in {path.resolve() for path in self.store.segment_paths()}:
            return  # a job has begun to rest on it meanwhile
        item.path.unlink(missing_ok=True)


def due(items: Iterable[Removable], now: float, settings: RetentionSettings) -> list[Removable]:
    """Recordings to delete: those too old, then the oldest while the total is too large; telemetry logs first."""
    oldest_first = sorted(items, key=lambda item: item.at)
    logs = [item for item in oldest_first if item.upload is None]
    going = _beyond(logs, now, settings.tlogs_days, settings.tlogs_bytes)
    left = [item for item in oldest_first if item not in going]
    return going + _beyond(left, now, settings.recordings_days, settings.recordings_bytes)


def _beyond(oldest_first: list[Removable], now: float, days: float | None, size: int | None) -> list[Removable]:
    total, going = sum(item.size for item in oldest_first), []
    for item in oldest_first:
        old = days is not None and item.at < now - days * DAY_S
        if old or (size is not None and total > size):
            going.append(item)
            total -= item.size
    return going


def _log(path: Path) -> Removable | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return Removable(path, found.st_mtime, found.st_size, None)


@dataclass
class Rotation:
    """Looks at the open links; `rotated` is called when one has begun another file.

    A capture and the window of a check keep their link's file until they end: a segment of a job lies in one file.
    """

    links: Callable[[], Iterable[Link]]
    settings: RetentionSettings
    rotated: Callable[[], None]
    clock: Callable[[], float] = time.monotonic

    async def run(self) -> None:
        """Check the links at intervals, until cancelled."""
        while True:
            await asyncio.sleep(LOOK_S)
            self.look()

    def look(self) -> None:
        """Have every link whose file is large or old enough go on in another one."""
        for link in self.links():
            if not self._due(link):
                continue
            try:
                begun = link.rotate()
            except StoreError as error:  # it goes on in the old one, and is asked again
                log.warning("no other telemetry log could be begun", link=link.id, reason=str(error))
                continue
            if begun:
                log.info("telemetry log begun", link=link.id, path=str(link.tlog.path))
                self.rotated()

    def _due(self, link: Link) -> bool:
        """Whether the file is large or old enough to be closed; an empty one never is."""
        held = link.tlog
        old = self.clock() - held.begun_at >= self.settings.tlog_hours * HOUR_S
        return held.position > 0 and (old or held.position >= self.settings.tlog_bytes)
