"""The durable state, in statements that every database takes.

A method that changes something returns only when the change would survive a loss of power. Exceptions say so: events,
and the outcomes of a campaign's items. Methods may be called from any thread; from an event loop those that write go
through :meth:`Store.do` or :meth:`Store.soon`, which keep their order.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from mavcal.service.errors import StoreError
from mavcal.service.store import chain
from mavcal.service.store.database import Database, Session
from mavcal.service.store.fleet import FleetTables
from mavcal.service.store.rows import (
    AuditRow,
    EventRow,
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
from mavcal.service.store.sqlitems import SqlItems
from mavcal.service.store.sqlrows import (
    AUDIT,
    EVENT,
    JOB,
    RECORDING,
    SEGMENT,
    audit_row,
    dump,
    event_row,
    job_row,
    marks,
    recording_row,
    segment_row,
)

_JOBS_AT_ONCE = 100
_NEEDED = ("jobs", "job_events", "journal", "snapshots", "plans", "segments", "audit")
"""Tables without which nothing may be written to a vehicle."""
ENDED = ("succeeded", "reverted", "failed", "cancelled", "interrupted")
"""States of jobs in which nothing proceeds by itself; as in :mod:`service.jobs.core.states`, which a test compares."""


class Store(SqlItems, FleetTables):
    """Jobs, campaigns, fleet, uploads, links and audit trail in one database."""

    def obstacle(self) -> str | None:
        """Why nothing may be written to a vehicle: a missing table; None: all are there."""
        missing = [name for name in _NEEDED if not self._readable(name)]
        if not missing:
            return None
        listed = ", ".join(missing)
        return f"the database has no table {listed}: restore it from a backup, or use another data directory"

    def _readable(self, table: str) -> bool:
        try:
            self._read(f"SELECT 1 FROM {table} LIMIT 1")
        except StoreError:
            return False
        return True

    # --- jobs and events

    def save_job(self, row: JobRow, *, event: tuple[str, Json] | None = None) -> EventRow | None:
        """Insert or replace a job; with `event` (kind, data) the change and its event are one transaction."""
        with self._write() as db:
            db.execute(
                f"INSERT INTO jobs ({JOB}) VALUES ({marks(7)}) ON CONFLICT (id) DO UPDATE SET "
                "state = excluded.state, updated_at = excluded.updated_at, body = excluded.body",
                (row.id, row.vehicle_id, row.kind, row.state, row.created_at, row.updated_at, dump(row.body)),
            )
            return None if event is None else self._insert_event(db, row.id, row.updated_at, *event)

    def job(self, job_id: str) -> JobRow | None:
        """The job, or None if there is none of that id."""
        self._line.caught_up()
        rows = self._read(f"SELECT {JOB} FROM jobs WHERE id = ?", (job_id,))
        return job_row(rows[0]) if rows else None

    def jobs(self, *, vehicle_id: str | None = None, states: Collection[str] | None = None) -> tuple[JobRow, ...]:
        """Jobs in the order of their creation; None: of every vehicle, in every state."""
        self._line.caught_up()
        asked: list[str] = []
        values: list[Any] = []
        if vehicle_id is not None:
            asked.append("vehicle_id = ?")
            values.append(vehicle_id)
        if states is not None:
            asked.append(f"state IN ({marks(len(states))})")
            values += sorted(states) or [None]
        where = f"WHERE {' AND '.join(asked)}" if asked else ""
        rows = self._read(f"SELECT {JOB} FROM jobs {where} ORDER BY created_at, rowid", values)
        return tuple(map(job_row, rows))

    def each_job(self) -> Iterator[JobRow]:
        """Every job in the order of creation, read in small parts: those of years need not be held at once."""
        self._line.caught_up()
        ids = [row[0] for row in self._read("SELECT id FROM jobs ORDER BY created_at, rowid")]
        for first in range(0, len(ids), _JOBS_AT_ONCE):
            some = ids[first : first + _JOBS_AT_ONCE]
            asked = f"SELECT {JOB} FROM jobs WHERE id IN ({marks(len(some))}) ORDER BY created_at, rowid"
            yield from map(job_row, self._read(asked, some))

    def add_event(self, job_id: str, at: float, kind: str, data: Json) -> EventRow:
        """Append an event. Not forced to the disk: a loss of power may lose the last ones."""
        with self._write(durable=False) as db:
            return self._insert_event(db, job_id, at, kind, data)

    def events(self, job_id: str | None = None, *, after: int = 0, limit: int = 1000) -> tuple[EventRow, ...]:
        """Events after `after`: a sequence number of that job, or an id over all jobs if `job_id` is None."""
        self._line.caught_up()
        if job_id is None:
            sql = f"SELECT {EVENT} FROM job_events WHERE id > ? ORDER BY id LIMIT ?"
            return tuple(map(event_row, self._read(sql, (after, limit))))
        sql = f"SELECT {EVENT} FROM job_events WHERE job_id = ? AND sequence > ? ORDER BY sequence LIMIT ?"
        return tuple(map(event_row, self._read(sql, (job_id, after, limit))))

    def last_event_id(self) -> int:
        """The id of the newest event of any job; 0: there is none."""
        self._line.caught_up()
        return int(self._read("SELECT coalesce(max(id), 0) FROM job_events")[0][0])

    def drop_events(self, job_id: str, kind: str, *, keep: int) -> None:
        """Forget all but the last `keep` events of a kind (progress that has been superseded)."""
        self._run(
            "DELETE FROM job_events WHERE job_id = ? AND kind = ? AND id NOT IN (SELECT id FROM job_events "
            "WHERE job_id = ? AND kind = ? ORDER BY id DESC LIMIT ?)",
            (job_id, kind, job_id, kind, keep),
            durable=False,
        )

    # --- what was done to vehicles

    def add_journal(self, job_id: str, at: float, step: str, data: Json) -> JournalRow:
        """Append a step to the journal of a job."""
        row = self._run(
            "INSERT INTO journal (job_id, at, step, data) VALUES (?, ?, ?, ?) RETURNING id",
            (job_id, at, step, dump(data)),
        )[0]
        return JournalRow(row[0], job_id, at, step, data)

    def journal(self, job_id: str) -> tuple[JournalRow, ...]:
        """The journal of a job, oldest first."""
        rows = self._read("SELECT id, job_id, at, step, data FROM journal WHERE job_id = ? ORDER BY id", (job_id,))
        return tuple(JournalRow(r[0], r[1], r[2], r[3], json.loads(r[4])) for r in rows)

    def add_snapshot(self, job_id: str, at: float, purpose: SnapshotPurpose, sha256: str, body: Json) -> SnapshotRow:
        """Keep parameters as they were read."""
        row = self._run(
            "INSERT INTO snapshots (job_id, at, purpose, sha256, body) VALUES (?, ?, ?, ?, ?) RETURNING id",
            (job_id, at, purpose.value, sha256, dump(body)),
        )[0]
        return SnapshotRow(row[0], job_id, at, purpose, sha256, body)

    def snapshot(self, job_id: str, purpose: SnapshotPurpose) -> SnapshotRow | None:
        """The newest snapshot of that purpose."""
        rows = self._read(
            "SELECT id, job_id, at, purpose, sha256, body FROM snapshots WHERE job_id = ? AND purpose = ? "
            "ORDER BY id DESC LIMIT 1",
            (job_id, purpose.value),
        )
        return next((SnapshotRow(r[0], r[1], r[2], SnapshotPurpose(r[3]), r[4], json.loads(r[5])) for r in rows), None)

    def add_plan(self, job_id: str, sha256: str, at: float, body: Json) -> None:
        """Keep a plan under its digest; the same plan twice is one."""
        self._run(
            "INSERT INTO plans (sha256, job_id, at, body) VALUES (?, ?, ?, ?) ON CONFLICT DO NOTHING",
            (sha256, job_id, at, dump(body)),
        )

    def plan(self, job_id: str, sha256: str) -> Json | None:
        """A plan of that job by its digest."""
        rows = self._read("SELECT body FROM plans WHERE job_id = ? AND sha256 = ?", (job_id, sha256))
        return json.loads(rows[0][0]) if rows else None

    def open_segment(self, job_id: str, purpose: SegmentPurpose, path: Path, start_byte: int) -> SegmentRow:
        """Begin a segment."""
        row = self._run(
            f"INSERT INTO segments (job_id, purpose, path, start_byte) VALUES (?, ?, ?, ?) RETURNING {SEGMENT}",
            (job_id, purpose.value, str(path), start_byte),
        )[0]
        return segment_row(row)

    def close_segment(self, segment_id: int, end_byte: int, sha256: str) -> SegmentRow:
        """State where a segment ends and what it contains."""
        rows = self._run(
            f"UPDATE segments SET end_byte = ?, sha256 = ? WHERE id = ? RETURNING {SEGMENT}",
            (end_byte, sha256, segment_id),
        )
        if not rows:
            raise StoreError(f"there is no segment {segment_id}")
        return segment_row(rows[0])

    def segments(self, job_id: str, purpose: SegmentPurpose | None = None) -> tuple[SegmentRow, ...]:
        """The segments of a job, oldest first; None: of every purpose."""
        rows = self._read(f"SELECT {SEGMENT} FROM segments WHERE job_id = ? ORDER BY id", (job_id,))
        return tuple(row for row in map(segment_row, rows) if purpose in (None, row.purpose))

    def save_document(self, job_id: str, document: JobDocument) -> None:
        """Keep a document of a job, instead of an earlier one of its name."""
        self._run(
            "INSERT INTO documents (job_id, name, media_type, body) VALUES (?, ?, ?, ?) ON CONFLICT (job_id, name) "
            "DO UPDATE SET media_type = excluded.media_type, body = excluded.body",
            (job_id, document.name, document.media_type, document.body),
        )

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

    def _insert_event(self, db: Session, job_id: str, at: float, kind: str, data: Json) -> EventRow:
        self._database.in_order()  # a reader that continues after an id must miss no event
        row = db.execute(
            "INSERT INTO job_events (job_id, sequence, at, kind, data) VALUES (?, "
            "(SELECT coalesce(max(sequence), 0) + 1 FROM job_events WHERE job_id = ?), ?, ?, ?) RETURNING id, sequence",
            (job_id, job_id, at, kind, dump(data)),
        )[0]
        return EventRow(row[0], job_id, row[1], at, kind, data)

    # --- uploads and what is forgotten in time

    def add_recording(self, row: RecordingRow) -> None:
        """Keep an uploaded log."""
        values = (row.id, row.at, row.name, str(row.path), row.size, row.sha256, dump(row.body))
        self._run(f"INSERT INTO recordings ({RECORDING}) VALUES ({marks(7)})", values)

    def recording(self, recording_id: str) -> RecordingRow | None:
        """An uploaded log, or None."""
        rows = self._read(f"SELECT {RECORDING} FROM recordings WHERE id = ?", (recording_id,))
        return recording_row(rows[0]) if rows else None

    def recordings(self) -> tuple[RecordingRow, ...]:
        """Uploaded logs, oldest first."""
        rows = self._read(f"SELECT {RECORDING} FROM recordings ORDER BY at, rowid")
        return tuple(map(recording_row, rows))

    def delete_recording(self, recording_id: str) -> None:
        """Forget an uploaded log; one that is not there is no error."""
        self._run("DELETE FROM recordings WHERE id = ?", (recording_id,))

    def segment_paths(self) -> tuple[Path, ...]:
        """Every telemetry log that has a segment of a job."""
        return tuple(Path(r[0]) for r in self._read("SELECT DISTINCT path FROM segments"))

    def drop_old_events(self, before: float, *, most: int) -> None:
        """Forget events of jobs that have ended: those before a time, and all but the newest `most`."""
        self._run(  # the newest event of a job keeps its sequence going
            "DELETE FROM job_events WHERE id NOT IN (SELECT max(id) FROM job_events GROUP BY job_id) "
            f"AND job_id IN (SELECT id FROM jobs WHERE state IN ({marks(len(ENDED))})) "
            "AND (at < ? OR id <= (SELECT id FROM job_events ORDER BY id DESC LIMIT 1 OFFSET ?))",
            (*ENDED, before, most),
            durable=False,
        )

    def drop_old_keys(self, before: float, *, most: int) -> None:
        """Forget request keys used before a time, and all but the newest `most`."""
        self._run(
            "DELETE FROM idempotency_keys WHERE at < ? OR (at, rowid) <= "
            "(SELECT at, rowid FROM idempotency_keys ORDER BY at DESC, rowid DESC LIMIT 1 OFFSET ?)",
            (before, most),
            durable=False,
        )

    # --- links, signatures, requests

    def save_link(self, row: LinkRow) -> None:
        """Insert or replace a link."""
        sql = "INSERT INTO links (id, url, at) VALUES (?, ?, ?) ON CONFLICT (id) DO UPDATE SET url = excluded.url"
        self._run(sql, (row.id, row.url, row.at))

    def delete_link(self, link_id: str) -> None:
        """Forget a link; one that is not there is no error."""
        self._run("DELETE FROM links WHERE id = ?", (link_id,))

    def links(self) -> tuple[LinkRow, ...]:
        """Links in the order of their creation."""
        return tuple(LinkRow(r[0], r[1], r[2]) for r in self._read("SELECT id, url, at FROM links ORDER BY at, rowid"))

    def signing_timestamp(self, stream: str) -> int:
        """The newest accepted signature time stamp of a stream; 0: none yet."""
        rows = self._read("SELECT timestamp FROM signing_timestamps WHERE stream = ?", (stream,))
        return int(rows[0][0]) if rows else 0

    def save_signing_timestamp(self, stream: str, timestamp: int) -> None:
        """Raise the time stamp of a stream; a smaller one changes nothing."""
        self._run(
            "INSERT INTO signing_timestamps (stream, timestamp) VALUES (?, ?) ON CONFLICT (stream) DO UPDATE SET "
            "timestamp = excluded.timestamp WHERE excluded.timestamp > signing_timestamps.timestamp",
            (stream, timestamp),
        )

    def idempotency_key(self, key: str) -> tuple[str, str] | None:
        """The request (its digest) and the job that a key was used for; None: it is new."""
        rows = self._read("SELECT request_sha256, job_id FROM idempotency_keys WHERE key = ?", (key,))
        return (str(rows[0][0]), str(rows[0][1])) if rows else None

    def claim_idempotency_key(self, key: str, request_sha256: str, job_id: str, at: float) -> None:
        """Use a key for a request; raises StoreError if it was used before."""
        sql = "INSERT INTO idempotency_keys (key, request_sha256, job_id, at) VALUES (?, ?, ?, ?)"
        self._run(sql, (key, request_sha256, job_id, at))

    def release_idempotency_key(self, key: str) -> None:
        """Forget a key, so that it may be used again; one that is not known changes nothing."""
        self._run("DELETE FROM idempotency_keys WHERE key = ?", (key,))

    # --- audit

    def add_audit(self, at: float, actor: str, action: str, subject: str, detail: Json) -> AuditRow:
        """Append to the audit trail; the row's digest covers all rows before it."""
        with self._write() as db:
            self._database.in_order()  # each row covers the one before
            found = db.execute(f"SELECT {AUDIT} FROM audit ORDER BY id DESC LIMIT 1")
            newest = audit_row(found[0]) if found else None
            previous = chain.BEGINNING if newest is None else newest.sha256
            if newest is not None and previous is None:  # the first row of the chain covers those from before it
                rows = db.execute(f"SELECT {AUDIT} FROM audit ORDER BY id")
                previous = chain.check(map(audit_row, rows), newest.id).head
            assert previous is not None
            row = AuditRow(1 if newest is None else newest.id + 1, at, actor, action, subject, detail)
            row = replace(row, sha256=chain.link(previous, row))
            values = (row.id, at, actor, action, subject, dump(detail), row.sha256)
            db.execute(f"INSERT INTO audit ({AUDIT}) VALUES ({marks(7)})", values)
            return row

    def audit(self, *, after: int = 0, limit: int = 1000) -> tuple[AuditRow, ...]:
        """The audit trail after a row id, oldest first."""
        sql = f"SELECT {AUDIT} FROM audit WHERE id > ? ORDER BY id LIMIT ?"
        return tuple(map(audit_row, self._read(sql, (after, limit))))

    def check_audit(self) -> chain.ChainCheck:
        """Whether the audit trail is as it was written."""
        with self._database.errors(), self._database.snapshot() as db:
            return checked(db, self._database)


def checked(db: Session, database: type[Database] | Database) -> chain.ChainCheck:
    """Check the audit trail as one state of a database shows it."""
    given_out = int(db.execute(database.audit_end)[0][0])
    rows = db.execute(f"SELECT {AUDIT} FROM audit WHERE id <= ? ORDER BY id", (given_out,))
    return chain.check(map(audit_row, rows), given_out)
