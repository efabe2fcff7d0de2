"""Everything durable, in statements that every database takes.

Every method that changes something returns only when the change would survive a loss of power, except those that say
otherwise: events, and what has become of a campaign's items. Methods may be called from any thread;
from an event loop those that write go through :meth:`Store.do` or :meth:`Store.soon`, which keep their order.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mavcal.service.store import chain
from mavcal.service.store.database import Database, Session
from mavcal.service.store.fleet import FleetTables
from mavcal.service.store.rows import AuditRow, Json, LinkRow, RecordingRow
from mavcal.service.store.sqlitems import SqlItems
from mavcal.service.store.sqljobs import SqlJobs
from mavcal.service.store.sqlrows import AUDIT, RECORDING, audit_row, dump, marks, recording_row

ENDED = ("succeeded", "reverted", "failed", "cancelled", "interrupted")
"""States of jobs in which nothing goes on by itself; as in :mod:`service.jobs.core.states`, which a test compares."""


class Store(SqlJobs, SqlItems, FleetTables):
    """Jobs, campaigns, fleet, uploads, links and audit trail in one database."""

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
