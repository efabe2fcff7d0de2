"""Jobs, their events, and what was done to vehicles on their behalf, in statements that every database takes."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from mavcal.service.errors import StoreError
from mavcal.service.store.database import Session
from mavcal.service.store.rows import (
    EventRow,
    JobDocument,
    JobRow,
    JournalRow,
    Json,
    SegmentPurpose,
    SegmentRow,
    SnapshotPurpose,
    SnapshotRow,
)
from mavcal.service.store.sqlrows import (
    EVENT,
    JOB,
    SEGMENT,
    SqlRows,
    dump,
    event_row,
    job_row,
    marks,
    segment_row,
)

_JOBS_AT_ONCE = 100
_NEEDED = ("jobs", "job_events", "journal", "snapshots", "plans", "segments", "audit")
"""Tables without which nothing may be written to a vehicle."""


class SqlJobs(SqlRows):
    """Jobs, their events, and what was done to vehicles on their behalf."""

    def obstacle(self) -> str | None:
        """Why nothing may be written to a vehicle: a table is not there; None: all are."""
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
        self._database.in_order()  # who reads on after an id must miss none
        row = db.execute(
            "INSERT INTO job_events (job_id, sequence, at, kind, data) VALUES (?, "
            "(SELECT coalesce(max(sequence), 0) + 1 FROM job_events WHERE job_id = ?), ?, ?, ?) RETURNING id, sequence",
            (job_id, job_id, at, kind, dump(data)),
        )[0]
        return EventRow(row[0], job_id, row[1], at, kind, data)
