"""What the service asks of durable state.

Every method that changes something returns only when the change would survive a loss of power, except those that say
otherwise: events, and what has become of a campaign's items. Methods may be called from any thread;
from an event loop those that write go through :meth:`JobStore.do` or :meth:`JobStore.soon`, which keep their order.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Protocol, TypeVar

from mavcal.service.store.chain import ChainCheck
from mavcal.service.store.rows import (
    AuditRow,
    EventRow,
    FleetRows,
    ItemRow,
    JobDocument,
    JobRow,
    JournalRow,
    Json,
    LinkRow,
    PreflightRow,
    RecordingRow,
    SegmentPurpose,
    SegmentRow,
    SensorRow,
    SnapshotPurpose,
    SnapshotRow,
    UnitRow,
)

T = TypeVar("T")


class JobStore(Protocol):
    """Jobs, what happened to them, and what was done to vehicles on their behalf."""

    def soon(self, work: Callable[[], T]) -> Future[T]:
        """Have `work` done in the store's own thread, after everything that was asked of it before."""
        ...

    async def do(self, work: Callable[[], T]) -> T:
        """The same, and wait for it without holding up the event loop."""
        ...

    def obstacle(self) -> str | None:
        """Why nothing may be written to a vehicle: a table is not there; None: all are."""
        ...

    def save_job(self, row: JobRow, *, event: tuple[str, Json] | None = None) -> EventRow | None:
        """Insert or replace a job; with `event` (kind, data) the change and its event are one transaction."""
        ...

    def job(self, job_id: str) -> JobRow | None:
        """The job, or None if there is none of that id."""
        ...

    def jobs(self, *, vehicle_id: str | None = None, states: Collection[str] | None = None) -> tuple[JobRow, ...]:
        """Jobs in the order of their creation; None: of every vehicle, in every state."""
        ...

    def each_job(self) -> Iterator[JobRow]:
        """Every job in the order of creation, read in small parts: those of years need not be held at once."""
        ...

    def add_event(self, job_id: str, at: float, kind: str, data: Json) -> EventRow:
        """Append an event. Not forced to the disk: a loss of power may lose the last ones."""
        ...

    def events(self, job_id: str | None = None, *, after: int = 0, limit: int = 1000) -> tuple[EventRow, ...]:
        """Events after `after`: a sequence number of that job, or an id over all jobs if `job_id` is None."""
        ...

    def last_event_id(self) -> int:
        """The id of the newest event of any job; 0: there is none."""
        ...

    def drop_events(self, job_id: str, kind: str, *, keep: int) -> None:
        """Forget all but the last `keep` events of a kind (progress that has been superseded)."""
        ...

    def add_journal(self, job_id: str, at: float, step: str, data: Json) -> JournalRow:
        """Append a step to the journal of a job."""
        ...

    def journal(self, job_id: str) -> tuple[JournalRow, ...]:
        """The journal of a job, oldest first."""
        ...

    def add_snapshot(self, job_id: str, at: float, purpose: SnapshotPurpose, sha256: str, body: Json) -> SnapshotRow:
        """Keep parameters as they were read."""
        ...

    def snapshot(self, job_id: str, purpose: SnapshotPurpose) -> SnapshotRow | None:
        """The newest snapshot of that purpose."""
        ...

    def add_plan(self, job_id: str, sha256: str, at: float, body: Json) -> None:
        """Keep a plan under its digest; the same plan twice is one."""
        ...

    def plan(self, job_id: str, sha256: str) -> Json | None:
        """A plan of that job by its digest."""
        ...

    def open_segment(self, job_id: str, purpose: SegmentPurpose, path: Path, start_byte: int) -> SegmentRow:
        """Begin a segment."""
        ...

    def close_segment(self, segment_id: int, end_byte: int, sha256: str) -> SegmentRow:
        """State where a segment ends and what it contains."""
        ...

    def segments(self, job_id: str, purpose: SegmentPurpose | None = None) -> tuple[SegmentRow, ...]:
        """The segments of a job, oldest first; None: of every purpose."""
        ...

    def save_document(self, job_id: str, document: JobDocument) -> None:
        """Keep a document of a job, instead of an earlier one of its name."""
        ...

    def document(self, job_id: str, name: str) -> JobDocument | None:
        """A document of a job; None: it has none of that name."""
        ...

    def add_items(self, rows: Sequence[ItemRow]) -> None:
        """Keep the items of a campaign, all or none."""
        ...

    def save_item(self, row: ItemRow) -> None:
        """Keep what has become of an item. Not forced to the disk: a loss of power may take the last ones back."""
        ...

    def items(
        self, job_id: str, *, after: int = 0, limit: int = 1000, outcomes: Collection[str] | None = None
    ) -> tuple[ItemRow, ...]:
        """Items of a campaign behind a number, in their order; `outcomes` None: of every outcome."""
        ...

    def item_counts(self, job_id: str) -> dict[str, int]:
        """How many items of a campaign have each outcome; outcomes that none has are left out."""
        ...

    def change_outcomes(self, job_id: str, outcomes: Collection[str], to: str) -> None:
        """Give all items of these outcomes another one. Not forced to the disk."""
        ...

    def delete_job(self, job_id: str) -> None:
        """Forget a job that never wrote, with its events and documents; one that is not there is no error."""
        ...


class FleetStore(Protocol):
    """Units, what was measured of their sensors, and their last preflights."""

    def fleet(self, unit_id: str | None = None) -> FleetRows:
        """Everything about every unit, or about one."""
        ...

    def unit(self, unit_id: str) -> UnitRow | None:
        """A unit, or None."""
        ...

    def save_unit(self, row: UnitRow) -> None:
        """Insert or replace a unit."""
        ...

    def see_unit(self, unit_id: str, autopilot: str, firmware: str, at: float) -> None:
        """Keep what a unit said of itself; its name and tags stay."""
        ...

    def add_sensor_records(self, source_id: str, rows: Collection[SensorRow], *, keep: int = 0) -> None:
        """Keep what one job or preflight measured; the same one twice is one.

        `keep` not 0: of the preflights of that unit only so many are kept, the newest.
        """
        ...

    def drop_sensor_records(self, source_id: str) -> None:
        """Forget what a job measured; one that is not there is no error."""
        ...

    def fleet_sources(self) -> frozenset[str]:
        """Jobs and preflights whose measurements were taken."""
        ...

    def save_preflight(self, row: PreflightRow) -> None:
        """Keep the last preflight of a unit, instead of the one before."""
        ...


class Store(JobStore, FleetStore, Protocol):
    """Everything durable."""

    def add_recording(self, row: RecordingRow) -> None:
        """Keep an uploaded log."""
        ...

    def recording(self, recording_id: str) -> RecordingRow | None:
        """An uploaded log, or None."""
        ...

    def recordings(self) -> tuple[RecordingRow, ...]:
        """Uploaded logs, oldest first."""
        ...

    def delete_recording(self, recording_id: str) -> None:
        """Forget an uploaded log; one that is not there is no error."""
        ...

    def segment_paths(self) -> tuple[Path, ...]:
        """Every telemetry log that has a segment of a job."""
        ...

    def drop_old_events(self, before: float, *, most: int) -> None:
        """Forget events of jobs that have ended: those before a time, and all but the newest `most`."""
        ...

    def drop_old_keys(self, before: float, *, most: int) -> None:
        """Forget request keys used before a time, and all but the newest `most`."""
        ...

    def save_link(self, row: LinkRow) -> None:
        """Insert or replace a link."""
        ...

    def delete_link(self, link_id: str) -> None:
        """Forget a link; one that is not there is no error."""
        ...

    def links(self) -> tuple[LinkRow, ...]:
        """Links in the order of their creation."""
        ...

    def signing_timestamp(self, stream: str) -> int:
        """The newest accepted signature time stamp of a stream; 0: none yet."""
        ...

    def save_signing_timestamp(self, stream: str, timestamp: int) -> None:
        """Raise the time stamp of a stream; a smaller one changes nothing."""
        ...

    def idempotency_key(self, key: str) -> tuple[str, str] | None:
        """The request (its digest) and the job that a key was used for; None: it is new."""
        ...

    def claim_idempotency_key(self, key: str, request_sha256: str, job_id: str, at: float) -> None:
        """Use a key for a request; raises StoreError if it was used before."""
        ...

    def release_idempotency_key(self, key: str) -> None:
        """Forget a key, so that it may be used again; one that is not known changes nothing."""
        ...

    def add_audit(self, at: float, actor: str, action: str, subject: str, detail: Json) -> AuditRow:
        """Append to the audit trail; the row's digest covers all rows before it."""
        ...

    def check_audit(self) -> ChainCheck:
        """Whether the audit trail is as it was written."""
        ...

    def audit(self, *, after: int = 0, limit: int = 1000) -> tuple[AuditRow, ...]:
        """The audit trail after a row id, oldest first."""
        ...

    def close(self) -> None:
        """Close the store and give the data directory back."""
        ...
