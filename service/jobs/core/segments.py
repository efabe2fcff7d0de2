"""Segments of telemetry logs: opened when something begins, closed with their digest when it ends."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from mavcal.service.errors import CaptureEnded
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Job, LogSpan
from mavcal.service.store.rows import SegmentPurpose, SegmentRow
from mavcal.service.store.sql import Store
from mavcal.service.vehicle.job_vehicle import JobVehicle, TlogPosition

SET_ASIDE = "set_aside"
"""In a job's context: the id of the newest segment that its fit does not use."""


def captured(job: Job, store: Store) -> tuple[SegmentRow, ...]:
    """The segments that the job's fit is made of, oldest first; without those that were set aside."""
    rows = store.segments(job.id, SegmentPurpose.CAPTURE)
    return tuple(row for row in rows if row.id > int(job.context.get(SET_ASIDE, 0)))


async def open_span(store: Store, job_id: str, purpose: SegmentPurpose, position: TlogPosition) -> SegmentRow:
    """Begin a segment at a place of the vehicle's log."""
    return await store.do(lambda: store.open_segment(job_id, purpose, position.path, position.byte))


@asynccontextmanager
async def spanned(handle: JobHandle, vehicle: JobVehicle, purpose: SegmentPurpose) -> AsyncIterator[None]:
    """Record a segment of the vehicle's log, in one file, from the start of the block to its end, however that ends."""
    with vehicle.unbroken_tlog():
        row = await open_span(handle.store, handle.id, purpose, vehicle.tlog_position())
        try:
            yield
        finally:
            await asyncio.shield(close_span(handle.store, row, vehicle))


async def close_span(store: Store, row: SegmentRow, vehicle: JobVehicle | None) -> LogSpan:
    """Close a segment at the present end of its log, force it to the disk, and store its digest.

    `vehicle` is None, or has another log, if the segment was left open by a crash: it then ends with its file.
    """
    end: int | None = None
    if vehicle is not None:
        position = vehicle.tlog_position()
        if position.path == row.path:
            await vehicle.sync_tlog()
            end = position.byte
    data = await asyncio.to_thread(read_range, row.path, row.start_byte, end)
    digest = await asyncio.to_thread(lambda: hashlib.sha256(data).hexdigest())
    return span_of(await store.do(lambda: store.close_segment(row.id, row.start_byte + len(data), digest)))


def span_of(row: SegmentRow) -> LogSpan:
    """The span of a closed row."""
    assert row.end_byte is not None
    assert row.sha256 is not None
    return LogSpan(row.path, row.start_byte, row.end_byte, row.sha256)


def content_of(span: LogSpan) -> bytes:
    """The bytes of a closed segment. Raises CaptureEnded if they are not there, or are others than they were."""
    data = read_range(span.path, span.start_byte, span.end_byte)
    if hashlib.sha256(data).hexdigest() != span.sha256:
        raise CaptureEnded(f"the recording {span.path.name} is not what it was when the job ended: it was damaged")
    return data


def read_range(path: Path, start: int, end: int | None) -> bytes:
    """Bytes of a file; None: up to its end. Raises CaptureEnded if it is not there."""
    try:
        with path.open("rb") as file:
            file.seek(start)
            return file.read() if end is None else file.read(end - start)
    except OSError as error:
        raise CaptureEnded(f"the recording {path.name} cannot be read: {error.strerror}") from error
