"""The rows of the store. Times are wall-clock seconds since 1970; ``body`` and ``data`` are JSON objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

Json = Mapping[str, Any]


class SnapshotPurpose(StrEnum):
    """Why parameters were read and kept."""

    COMPOSED_ON = "composed_on"  # the calibration parameters that a plan was composed on
    BEFORE_WRITE = "before_write"  # the values that a rollback restores


class SegmentPurpose(StrEnum):
    """Why a span of a telemetry log is kept."""

    CAPTURE = "capture"  # what the fit was made of
    BEFORE = "before"  # stream under the old parameters, for the physical check
    AFTER = "after"  # stream under the new parameters, for the physical check


@dataclass(frozen=True)
class JobRow:
    """A job as it was last saved."""

    id: str
    vehicle_id: str | None
    """None: the job needs no vehicle."""
    kind: str
    state: str
    created_at: float
    updated_at: float
    body: Json


@dataclass(frozen=True)
class EventRow:
    """Something that happened to a job. `id` orders the events of all jobs, `sequence` those of one, from 1."""

    id: int
    job_id: str
    sequence: int
    at: float
    kind: str
    data: Json


@dataclass(frozen=True)
class JournalRow:
    """One step of a write transaction, recorded before or after it was made."""

    id: int
    job_id: str
    at: float
    step: str
    data: Json


@dataclass(frozen=True)
class SnapshotRow:
    """Parameters of a vehicle at one moment."""

    id: int
    job_id: str
    at: float
    purpose: SnapshotPurpose
    sha256: str
    body: Json


@dataclass(frozen=True)
class SegmentRow:
    """A span of a telemetry log. `end_byte` and `sha256` are None while it is still being written."""

    id: int
    job_id: str
    purpose: SegmentPurpose
    path: Path
    start_byte: int
    end_byte: int | None
    sha256: str | None


@dataclass(frozen=True)
class JobDocument:
    """A file that a job has made."""

    name: str
    media_type: str
    body: bytes


@dataclass(frozen=True)
class ItemRow:
    """One vehicle or log of a campaign; `number` counts from 1 in the order in which they are begun."""

    job_id: str
    number: int
    subject: str
    outcome: str
    body: Json


@dataclass(frozen=True)
class RecordingRow:
    """An uploaded log."""

    id: str
    at: float
    name: str
    path: Path
    size: int
    sha256: str
    body: Json


@dataclass(frozen=True)
class LinkRow:
    """An endpoint that is opened again at the next start."""

    id: str
    url: str
    at: float


@dataclass(frozen=True)
class AuditRow:
    """Who asked for what."""

    id: int
    """Rows are numbered in the order of their arrival."""
    at: float
    """Wall-clock time, s since 1970."""
    actor: str
    action: str
    subject: str
    detail: Json
    sha256: str | None = None  # service.store.chain
    """Covers this row and all before it; None: from before there was a chain."""


@dataclass(frozen=True)
class UnitRow:
    """A unit of the fleet: what people call it, and what it said of itself last."""

    id: str
    name: str
    """Empty: nobody has named it."""
    tags: tuple[str, ...]
    autopilot: str
    firmware: str
    seen_at: float


@dataclass(frozen=True)
class SensorRow:
    """What one job or preflight measured of one sensor; `body` is a :class:`calib.fleet.record.SensorRecord`."""

    source_id: str
    sensor: str
    instance: int
    source: str
    """``job`` or ``preflight``."""
    unit_id: str
    at: float
    body: Json


@dataclass(frozen=True)
class PreflightRow:
    """The last preflight of a unit."""

    unit_id: str
    at: float
    verdict: str
    body: Json


@dataclass(frozen=True)
class FleetRows:
    """Everything about every unit."""

    units: tuple[UnitRow, ...]
    sensors: tuple[SensorRow, ...]
    """Oldest first."""
    preflights: tuple[PreflightRow, ...]
