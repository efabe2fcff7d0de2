"""Reads and writes rows: in transactions, in the order of the calls, JSON as text.

Writes are made in one thread, so that the event loop never waits for the disk.
"""

from __future__ import annotations

import asyncio
import copy
import json
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self, TypeVar

from mavcal.service.store.database import Database, Row, Session
from mavcal.service.store.datadir import DataDirLock
from mavcal.service.store.rows import AuditRow, EventRow, JobRow, Json, RecordingRow, SegmentPurpose, SegmentRow

T = TypeVar("T")

Fence = Callable[[Session], None]


class WriteLine:
    """Runs what it is given one after the other. Its thread begins with the first work."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="store")
        self._lock = threading.Lock()
        self._last: Future[object] | None = None
        self._thread: int | None = None

    def soon(self, work: Callable[[], T]) -> Future[T]:
        """Future of `work`, which runs after everything requested before."""

        def run() -> T:
            self._thread = threading.get_ident()
            return work()

        with self._lock:
            future = self._pool.submit(run)
            self._last = future  # type: ignore[assignment]
        return future

    async def do(self, work: Callable[[], T]) -> T:
        """Await `work`, run after everything requested before. A cancelled caller leaves only when it is done."""
        future = asyncio.wrap_future(self.soon(work))
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            while not future.done():
                with suppress(asyncio.CancelledError):
                    await asyncio.wait({future})
            if not future.cancelled():
                future.exception()  # looked at: the caller is gone
            raise

    def caught_up(self) -> None:
        """Block until everything requested is done, unless called from the worker thread."""
        last = self._last
        if last is not None and not last.done() and threading.get_ident() != self._thread:
            wait([last])

    def close(self) -> None:
        """Finish the remaining work and end the thread."""
        self._pool.shutdown(wait=True)


class SqlRows:
    """Transactions on one database, and the data directory that belongs to it, if any."""

    def __init__(self, database: Database, owned: DataDirLock | None = None) -> None:
        self._line = WriteLine()
        self._database = database
        self._owned = owned
        self._fence: Fence | None = None

    @property
    def version(self) -> int:
        """Version number of the schema."""
        return self._database.version

    def fenced(self, fence: Fence) -> Self:
        """The same store, in which `fence` is called at the beginning of every transaction, and refuses it by raising.

        Only the store itself is closed.
        """
        behind = copy.copy(self)
        behind._fence = fence
        return behind

    def close(self) -> None:
        """Close the store and give the data directory back."""
        self._line.close()
        self._database.close()
        if self._owned is not None:
            self._owned.release()

    def soon(self, work: Callable[[], T]) -> Future[T]:
        """Have `work` done in the store's thread, after everything that was asked of it before."""
        return self._line.soon(work)

    async def do(self, work: Callable[[], T]) -> T:
        """The same, and wait for it without holding up the event loop."""
        return await self._line.do(work)

    def _read(self, sql: str, values: Sequence[Any] = ()) -> list[Row]:
        with self._database.errors():
            return self._database.read(sql, values)

    def _run(self, sql: str, values: Sequence[Any] = (), *, durable: bool = True) -> list[Row]:
        """One statement as a transaction; the rows that it returns."""
        with self._write(durable=durable) as db:
            return db.execute(sql, values)

    @contextmanager
    def _write(self, *, durable: bool = True) -> Iterator[Session]:
        """One transaction: it is on the disk when this returns (if `durable`), or nothing of it is."""
        self._line.caught_up()
        database = self._database
        with database.alone(), database.errors():
            database.begin(durable=durable)
            try:
                if self._fence is not None:
                    self._fence(database)
                yield database
                self._commit(durable)
            except BaseException:
                database.rollback()
                raise

    def _commit(self, _durable: bool) -> None:
        self._database.commit()


def marks(count: int) -> str:
    """Placeholders for `count` values; at least one, to be filled with None."""
    return ", ".join("?" * max(count, 1))


def dump(value: Json) -> str:
    """The JSON text that is stored."""
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def object_of(text: str) -> Json:
    """The JSON object of a row; empty for a damaged one, so that the others can still be read."""
    try:
        value = json.loads(text)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


JOB = "id, vehicle_id, kind, state, created_at, updated_at, body"
EVENT = "id, job_id, sequence, at, kind, data"
SEGMENT = "id, job_id, purpose, path, start_byte, end_byte, sha256"
RECORDING = "id, at, name, path, size, sha256, body"
AUDIT = "id, at, actor, action, subject, detail, sha256"
"""Columns as the functions below read them."""


def job_row(row: Row) -> JobRow:
    """Reads :data:`JOB`."""
    return JobRow(row[0], row[1], row[2], row[3], row[4], row[5], object_of(row[6]))


def event_row(row: Row) -> EventRow:
    """Reads :data:`EVENT`."""
    return EventRow(row[0], row[1], row[2], row[3], row[4], object_of(row[5]))


def segment_row(row: Row) -> SegmentRow:
    """Reads :data:`SEGMENT`."""
    return SegmentRow(row[0], row[1], SegmentPurpose(row[2]), Path(row[3]), row[4], row[5], row[6])


def recording_row(row: Row) -> RecordingRow:
    """Reads :data:`RECORDING`."""
    return RecordingRow(row[0], row[1], row[2], Path(row[3]), row[4], row[5], object_of(row[6]))


def audit_row(row: Row) -> AuditRow:
    """Reads :data:`AUDIT`."""
    return AuditRow(row[0], row[1], row[2], row[3], row[4], object_of(row[5]), row[6])
