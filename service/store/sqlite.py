"""The store in one SQLite file: write-ahead log, one writer at a time, readers that never wait for it.

State is written with ``synchronous = FULL`` (an fsync a commit: 5 ms on a good disk, 50 ms on an SD card), events with
``NORMAL``. Whoever runs on an event loop writes through :meth:`SqliteStore.do` or :meth:`SqliteStore.soon`.
"""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from mavcal.service.errors import DiskFull, StoreError
from mavcal.service.store import chain
from mavcal.service.store.datadir import DataDirLock, require_database
from mavcal.service.store.line import WriteLine
from mavcal.service.store.migrate import migrate, migrations
from mavcal.service.store.rows import (
    AuditRow,
    EventRow,
    ItemRow,
    JobDocument,
    JobRow,
    JournalRow,
    Json,
    LinkRow,
    RecordingRow,
    SegmentPurpose,
    SegmentRow,
    SnapshotPurpose,
    SnapshotRow,
)
from mavcal.service.store.sqlitems import SqlItems, item_row, select_items

T = TypeVar("T")

DATABASE = "mavcal.sqlite3"
ENDED = ("succeeded", "reverted", "failed", "cancelled", "interrupted")
"""States of jobs in which nothing goes on by itself; as in :mod:`service.jobs.states`, which a test compares."""

MOST_ITEMS = 1_000_000
"""Items that are read of a campaign at a time; it has fewer."""

_DISK_TROUBLE = {sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN}


class SqliteStore(SqlItems):
    """Durable state of one data directory; None keeps it in memory (for tests and one-off commands).

    Raises
    ------
    DataDirLocked
        If another process owns the directory.
    DiskFull
        From every method that writes, when the disk is full; nothing of that write remains.
    """

    def __init__(self, data_dir: Path | None) -> None:
        self._lock = threading.RLock()
        self._line = WriteLine()
        self._owned = None if data_dir is None else DataDirLock(data_dir)
        self._durable: bool | None = None
        target = ":memory:" if data_dir is None else (data_dir / DATABASE).absolute().as_uri()
        try:
            with _typed_errors():
                self._db = _connection(target)
                if data_dir is not None:
                    require_database(data_dir, empty=_is_empty(self._db))
                self._db.execute("PRAGMA journal_mode = WAL")
                self._db.execute("PRAGMA synchronous = FULL")
                self.version = migrate(self._db, migrations())
                self._db.execute("PRAGMA foreign_keys = ON")  # after migrations, which may make a table once more
                # A database in memory belongs to its one connection.
                self._reader, self._reading = (
                    (self._db, self._lock) if data_dir is None else (_connection(target), threading.RLock())
                )
        except StoreError:
            if self._owned is not None:
                self._owned.release()
            raise

    def close(self) -> None:
        """Close the store and give the data directory back."""
        self._line.close()
        with self._lock, self._reading:
            self._reader.close()
            self._db.close()
        if self._owned is not None:
            self._owned.release()

    def soon(self, work: Callable[[], T]) -> Future[T]:
        """Have `work` done in the store's thread, after everything that was asked of it before."""
        return self._line.soon(work)

    async def do(self, work: Callable[[], T]) -> T:
        """The same, and wait for it without holding up the event loop."""
        return await self._line.do(work)

    # --- jobs and events

    def save_job(self, row: JobRow, *, event: tuple[str, Json] | None = None) -> EventRow | None:
        """Insert or replace a job; with `event` (kind, data) the change and its event are one transaction."""
        with self._write() as db:
            db.execute(
                "INSERT INTO jobs VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (id) DO UPDATE SET "
                "state = excluded.state, updated_at = excluded.updated_at, body = excluded.body",
                (row.id, row.vehicle_id, row.kind, row.state, row.created_at, row.updated_at, _dump(row.body)),
            )
            return None if event is None else _insert_event(db, row.id, row.updated_at, *event)

    def job(self, job_id: str) -> JobRow | None:
        """The job, or None if there is none of that id."""
        self._line.caught_up()
        rows = self._read("SELECT * FROM jobs WHERE id = ?", (job_id,))
        return _job(rows[0]) if rows else None

    def jobs(self, *, vehicle_id: str | None = None, states: Collection[str] | None = None) -> tuple[JobRow, ...]:
        """Jobs in the order of their creation; None: of every vehicle, in every state."""
        self._line.caught_up()
        rows = self._read(
            "SELECT * FROM jobs WHERE (?1 IS NULL OR vehicle_id = ?1) AND "
            "(?2 IS NULL OR state IN (SELECT value FROM json_each(?2))) ORDER BY created_at, rowid",
            (vehicle_id, None if states is None else json.dumps(sorted(states))),
        )
        return tuple(_job(r) for r in rows)

    def add_event(self, job_id: str, at: float, kind: str, data: Json) -> EventRow:
        """Append an event. Not forced to the disk: a loss of power may lose the last ones."""
        with self._write(durable=False) as db:
            return _insert_event(db, job_id, at, kind, data)

    def events(self, job_id: str | None = None, *, after: int = 0, limit: int = 1000) -> tuple[EventRow, ...]:
        """Events after `after`: a sequence number of that job, or an id over all jobs if `job_id` is None."""
        self._line.caught_up()
        if job_id is None:
            rows = self._read("SELECT * FROM job_events WHERE id > ? ORDER BY id LIMIT ?", (after, limit))
        else:
            rows = self._read(
                "SELECT * FROM job_events WHERE job_id = ? AND sequence > ? ORDER BY sequence LIMIT ?",
                (job_id, after, limit),
            )
        return tuple(EventRow(r[0], r[1], r[2], r[3], r[4], _object(r[5])) for r in rows)

    def last_event_id(self) -> int:
        """The id of the newest event of any job; 0: there is none."""
        self._line.caught_up()
        return int(self._read("SELECT coalesce(max(id), 0) FROM job_events")[0][0])

    def drop_events(self, job_id: str, kind: str, *, keep: int) -> None:
        """Forget all but the last `keep` events of a kind (progress that has been superseded)."""
        with self._write(durable=False) as db:
            db.execute(
                "DELETE FROM job_events WHERE job_id = ?1 AND kind = ?2 AND id NOT IN (SELECT id FROM job_events "
                "WHERE job_id = ?1 AND kind = ?2 ORDER BY id DESC LIMIT ?3)",
                (job_id, kind, keep),
            )

    # --- what was done to vehicles

    def add_journal(self, job_id: str, at: float, step: str, data: Json) -> JournalRow:
        """Append a step to the journal of a job."""
        row = self._insert("INSERT INTO journal VALUES (NULL, ?, ?, ?, ?)", (job_id, at, step, _dump(data)))
        return JournalRow(row, job_id, at, step, data)

    def journal(self, job_id: str) -> tuple[JournalRow, ...]:
        """The journal of a job, oldest first."""
        rows = self._read("SELECT * FROM journal WHERE job_id = ? ORDER BY id", (job_id,))
        return tuple(JournalRow(r[0], r[1], r[2], r[3], json.loads(r[4])) for r in rows)

    def add_snapshot(self, job_id: str, at: float, purpose: SnapshotPurpose, sha256: str, body: Json) -> SnapshotRow:
        """Keep parameters as they were read."""
        values = (job_id, at, purpose.value, sha256, _dump(body))
        row = self._insert("INSERT INTO snapshots VALUES (NULL, ?, ?, ?, ?, ?)", values)
        return SnapshotRow(row, job_id, at, purpose, sha256, body)

    def snapshot(self, job_id: str, purpose: SnapshotPurpose) -> SnapshotRow | None:
        """The newest snapshot of that purpose."""
        rows = self._read(
            "SELECT * FROM snapshots WHERE job_id = ? AND purpose = ? ORDER BY id DESC LIMIT 1",
            (job_id, purpose.value),
        )
        return next((SnapshotRow(r[0], r[1], r[2], SnapshotPurpose(r[3]), r[4], json.loads(r[5])) for r in rows), None)

    def add_plan(self, job_id: str, sha256: str, at: float, body: Json) -> None:
        """Keep a plan under its digest; the same plan twice is one."""
        with self._write() as db:
            db.execute("INSERT OR IGNORE INTO plans VALUES (?, ?, ?, ?)", (sha256, job_id, at, _dump(body)))

    def plan(self, job_id: str, sha256: str) -> Json | None:
        """A plan of that job by its digest."""
        rows = self._read("SELECT body FROM plans WHERE job_id = ? AND sha256 = ?", (job_id, sha256))
        return json.loads(rows[0][0]) if rows else None

    def open_segment(self, job_id: str, purpose: SegmentPurpose, path: Path, start_byte: int) -> SegmentRow:
        """Begin a segment."""
        values = (job_id, purpose.value, str(path), start_byte)
        row = self._insert("INSERT INTO segments VALUES (NULL, ?, ?, ?, ?, NULL, NULL)", values)
        return SegmentRow(row, job_id, purpose, path, start_byte, None, None)

    def close_segment(self, segment_id: int, end_byte: int, sha256: str) -> SegmentRow:
        """State where a segment ends and what it contains."""
        with self._write() as db:
            row = db.execute(
                "UPDATE segments SET end_byte = ?, sha256 = ? WHERE id = ? RETURNING *", (end_byte, sha256, segment_id)
            ).fetchone()
            if row is None:
                raise StoreError(f"there is no segment {segment_id}")
            return _segment(row)

    def segments(self, job_id: str, purpose: SegmentPurpose | None = None) -> tuple[SegmentRow, ...]:
        """The segments of a job, oldest first; None: of every purpose."""
        rows = self._read(
            "SELECT * FROM segments WHERE job_id = ?1 AND (?2 IS NULL OR purpose = ?2) ORDER BY id",
            (job_id, None if purpose is None else purpose.value),
        )
        return tuple(_segment(r) for r in rows)

    def save_document(self, job_id: str, document: JobDocument) -> None:
        """Keep a document of a job, instead of an earlier one of its name."""
        values = (job_id, document.name, document.media_type, document.body)
        self._insert("INSERT OR REPLACE INTO documents VALUES (?, ?, ?, ?)", values)

    def document(self, job_id: str, name: str) -> JobDocument | None:
        """A document of a job; None: it has none of that name."""
        rows = self._read("SELECT name, media_type, body FROM documents WHERE job_id = ? AND name = ?", (job_id, name))
        return JobDocument(rows[0][0], rows[0][1], bytes(rows[0][2])) if rows else None

    def delete_job(self, job_id: str) -> None:
        """Forget a job that never wrote, with its events and documents; one that is not there is no error."""
        with self._write(durable=False) as db:
            db.execute("DELETE FROM documents WHERE job_id = ?", (job_id,))
            db.execute("DELETE FROM job_events WHERE job_id = ?", (job_id,))
            db.execute("DELETE FROM campaign_items WHERE job_id = ?", (job_id,))
            db.execute("DELETE FROM jobs WHERE id = ?", (job_id,))

    # --- uploads, links, signatures, requests, audit

    def add_recording(self, row: RecordingRow) -> None:
        """Keep an uploaded log."""
        values = (row.id, row.at, row.name, str(row.path), row.size, row.sha256, _dump(row.body))
        self._insert("INSERT INTO recordings VALUES (?, ?, ?, ?, ?, ?, ?)", values)

    def recording(self, recording_id: str) -> RecordingRow | None:
        """An uploaded log, or None."""
        rows = self._read("SELECT * FROM recordings WHERE id = ?", (recording_id,))
        return _recording(rows[0]) if rows else None

    def recordings(self) -> tuple[RecordingRow, ...]:
        """Uploaded logs, oldest first."""
        return tuple(_recording(r) for r in self._read("SELECT * FROM recordings ORDER BY at, rowid"))

    def delete_recording(self, recording_id: str) -> None:
        """Forget an uploaded log; one that is not there is no error."""
        self._insert("DELETE FROM recordings WHERE id = ?", (recording_id,))

    def segment_paths(self) -> tuple[Path, ...]:
        """Every telemetry log that has a segment of a job."""
        return tuple(Path(r[0]) for r in self._read("SELECT DISTINCT path FROM segments"))

    def drop_old_events(self, before: float, *, most: int) -> None:
        """Forget events of jobs that have ended: those before a time, and all but the newest `most`."""
        with self._write(durable=False) as db:  # the newest event of a job keeps its sequence going
            db.execute(
                "DELETE FROM job_events WHERE id NOT IN (SELECT max(id) FROM job_events GROUP BY job_id) "
                "AND job_id IN (SELECT id FROM jobs WHERE state IN (SELECT value FROM json_each(?1))) "
                "AND (at < ?2 OR id <= (SELECT id FROM job_events ORDER BY id DESC LIMIT 1 OFFSET ?3))",
                (json.dumps(ENDED), before, most),
            )

    def drop_old_keys(self, before: float, *, most: int) -> None:
        """Forget request keys used before a time, and all but the newest `most`."""
        with self._write(durable=False) as db:
            db.execute(
                "DELETE FROM idempotency_keys WHERE at < ?1 OR rowid IN "
                "(SELECT rowid FROM idempotency_keys ORDER BY at DESC, rowid DESC LIMIT -1 OFFSET ?2)",
                (before, most),
            )

    def save_link(self, row: LinkRow) -> None:
        """Insert or replace a link."""
        sql = "INSERT INTO links VALUES (?, ?, ?) ON CONFLICT (id) DO UPDATE SET url = excluded.url"
        self._insert(sql, (row.id, row.url, row.at))

    def delete_link(self, link_id: str) -> None:
        """Forget a link; one that is not there is no error."""
        self._insert("DELETE FROM links WHERE id = ?", (link_id,))

    def links(self) -> tuple[LinkRow, ...]:
        """Links in the order of their creation."""
        return tuple(LinkRow(r[0], r[1], r[2]) for r in self._read("SELECT * FROM links ORDER BY at, rowid"))

    def signing_timestamp(self, stream: str) -> int:
        """The newest accepted signature time stamp of a stream; 0: none yet."""
        rows = self._read("SELECT timestamp FROM signing_timestamps WHERE stream = ?", (stream,))
        return int(rows[0][0]) if rows else 0

    def save_signing_timestamp(self, stream: str, timestamp: int) -> None:
        """Raise the time stamp of a stream; a smaller one changes nothing."""
        self._insert(
            "INSERT INTO signing_timestamps VALUES (?, ?) ON CONFLICT (stream) DO UPDATE SET "
            "timestamp = max(timestamp, excluded.timestamp)",
            (stream, timestamp),
        )

    def idempotency_key(self, key: str) -> tuple[str, str] | None:
        """The request (its digest) and the job that a key was used for; None: it is new."""
        rows = self._read("SELECT request_sha256, job_id FROM idempotency_keys WHERE key = ?", (key,))
        return (str(rows[0][0]), str(rows[0][1])) if rows else None

    def claim_idempotency_key(self, key: str, request_sha256: str, job_id: str, at: float) -> None:
        """Use a key for a request; raises StoreError if it was used before."""
        self._insert("INSERT INTO idempotency_keys VALUES (?, ?, ?, ?)", (key, request_sha256, job_id, at))

    def add_audit(self, at: float, actor: str, action: str, subject: str, detail: Json) -> AuditRow:
        """Append to the audit trail; the row's digest covers all rows before it."""
        with self._write() as db:
            newest = db.execute("SELECT * FROM audit ORDER BY id DESC LIMIT 1").fetchone()
            if newest is None or newest[6] is not None:
                previous = chain.BEGINNING if newest is None else newest[6]
            else:  # the first row of the chain covers those from before it
                previous = chain.check(map(_audit, db.execute("SELECT * FROM audit ORDER BY id")), newest[0]).head
            row = AuditRow(1 if newest is None else newest[0] + 1, at, actor, action, subject, detail)
            row = replace(row, sha256=chain.link(previous, row))
            values = (row.id, at, actor, action, subject, _dump(detail), row.sha256)
            db.execute("INSERT INTO audit VALUES (?, ?, ?, ?, ?, ?, ?)", values)
            return row

    def audit(self, *, after: int = 0, limit: int = 1000) -> tuple[AuditRow, ...]:
        """The audit trail after a row id, oldest first."""
        rows = self._read("SELECT * FROM audit WHERE id > ? ORDER BY id LIMIT ?", (after, limit))
        return tuple(map(_audit, rows))

    def check_audit(self) -> chain.ChainCheck:
        """Whether the audit trail is as it was written."""
        with self._reading, _typed_errors():
            return _checked(self._reader)

    # --- plumbing

    def _read(self, sql: str, values: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        with self._reading, _typed_errors():
            return self._reader.execute(sql, values).fetchall()

    def _insert(self, sql: str, values: tuple[Any, ...]) -> int:
        with self._write() as db:
            return db.execute(sql, values).lastrowid or 0

    @contextmanager
    def _write(self, *, durable: bool = True) -> Iterator[sqlite3.Connection]:
        """One transaction: it is on the disk when this returns (if `durable`), or nothing of it is."""
        self._line.caught_up()
        with self._lock, _typed_errors():
            if durable != self._durable:
                self._db.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
                self._durable = durable
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._commit(durable)
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def _commit(self, _durable: bool) -> None:
        self._db.execute("COMMIT")


def check_audit_of(data_dir: Path) -> chain.ChainCheck:
    """Whether the audit trail of a data directory is as it was written, also while another process owns it.

    Raises
    ------
    StoreError
        If there is no database, or it has no chain.
    """
    with _read_only(data_dir) as db:
        return _checked(db)


def jobs_of(data_dir: Path) -> tuple[JobRow, ...]:
    """Every job of a data directory, oldest first, also while another process owns it.

    Raises
    ------
    StoreError
        If there is no database.
    """
    with _read_only(data_dir) as db:
        return tuple(map(_job, db.execute("SELECT * FROM jobs ORDER BY created_at, rowid")))


def items_of(data_dir: Path, job_id: str, outcomes: Collection[str] | None = None) -> tuple[ItemRow, ...]:
    """The items of a campaign, also while another process owns the data directory.

    Raises
    ------
    StoreError
        If there is no database.
    """
    with _read_only(data_dir) as db:
        sql, values = select_items(job_id, limit=MOST_ITEMS, outcomes=outcomes)
        return tuple(map(item_row, db.execute(sql, values)))


@contextmanager
def _read_only(data_dir: Path) -> Iterator[sqlite3.Connection]:
    """One state of the database of a data directory, whoever owns it."""
    path = data_dir / DATABASE
    if not path.is_file():
        raise StoreError(f"there is no database in {data_dir}: give the --data-dir of the service")
    with _typed_errors():
        db = _connection(f"{path.absolute().as_uri()}?mode=ro")
        try:
            db.execute("BEGIN")
            yield db
        finally:
            db.close()


def _checked(db: sqlite3.Connection) -> chain.ChainCheck:
    given_out = db.execute("SELECT coalesce(max(seq), 0) FROM sqlite_sequence WHERE name = 'audit'").fetchone()[0]
    rows = db.execute("SELECT * FROM audit WHERE id <= ? ORDER BY id", (given_out,))
    return chain.check(map(_audit, rows), given_out)


def _is_empty(db: sqlite3.Connection) -> bool:
    return int(db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]) == 0


def _connection(target: str) -> sqlite3.Connection:
    connection = sqlite3.connect(target, isolation_level=None, check_same_thread=False, timeout=5.0, uri=True)
    connection.text_factory = _text
    return connection


@contextmanager
def _typed_errors() -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the low byte is the primary code
        if code in _DISK_TROUBLE:
            raise DiskFull(f"{DiskFull.__doc__} ({error})") from error
        raise StoreError(f"the database refused: {error}") from error


def _insert_event(db: sqlite3.Connection, job_id: str, at: float, kind: str, data: Json) -> EventRow:
    row = db.execute(
        "INSERT INTO job_events (job_id, sequence, at, kind, data) VALUES (?1, "
        "(SELECT coalesce(max(sequence), 0) + 1 FROM job_events WHERE job_id = ?1), ?2, ?3, ?4) RETURNING id, sequence",
        (job_id, at, kind, _dump(data)),
    ).fetchone()
    return EventRow(row[0], job_id, row[1], at, kind, data)


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")  # a damaged text is one bad row, not a failed query


def _dump(value: Json) -> str:
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def _job(row: tuple[Any, ...]) -> JobRow:
    return JobRow(row[0], row[1], row[2], row[3], row[4], row[5], _object(row[6]))


def _object(text: str) -> Json:
    """The JSON object of a damaged row is empty: one row must not hide the others."""
    try:
        value = json.loads(text)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


def _audit(row: tuple[Any, ...]) -> AuditRow:
    return AuditRow(row[0], row[1], row[2], row[3], row[4], _object(row[5]), row[6])


def _segment(row: tuple[Any, ...]) -> SegmentRow:
    return SegmentRow(row[0], row[1], SegmentPurpose(row[2]), Path(row[3]), row[4], row[5], row[6])


def _recording(row: tuple[Any, ...]) -> RecordingRow:
    return RecordingRow(row[0], row[1], row[2], Path(row[3]), row[4], row[5], _object(row[6]))
