"""Where a segment of a telemetry log ends."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from mavcal.service.jobs.core.codec import row_from_job
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.segments import close_span, open_span
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SegmentPurpose
from mavcal.service.vehicle.job_vehicle import TlogPosition
from tests.unit.jobs.fakes import FakeVehicle


@pytest.mark.parametrize(("log", "end"), [("same.tlog", 6), ("new.tlog", 10)])
async def test_a_segment_ends_where_its_log_stands_or_with_its_file_if_the_vehicle_has_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, log: str, end: int
) -> None:
    path = tmp_path / "same.tlog"
    path.write_bytes(b"0123456789")
    store, vehicle = SqliteStore(None), FakeVehicle({})
    store.save_job(row_from_job(Job("j1", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0)))
    row = await open_span(store, "j1", SegmentPurpose.CAPTURE, TlogPosition(path, 2))
    monkeypatch.setattr(vehicle, "tlog_position", lambda: TlogPosition(tmp_path / log, 6))
    span = await close_span(store, row, vehicle)
    store.close()
    assert (span.start_byte, span.end_byte) == (2, end)
    assert span.sha256 == hashlib.sha256(b"0123456789"[2:end]).hexdigest()
