from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from calib.recording import Identity
from service.errors import CaptureEnded
from service.jobs.capture import Capture
from service.jobs.handle import JobHandle
from service.jobs.model import Job
from service.jobs.states import JobState
from service.store import SqliteStore
from service.store.rows import SegmentPurpose
from service.testing import FakeVehicle

from .conftest import QUICK


class SlowToStart(FakeVehicle):
    """Its streams come one after the other while they are asked for; then it does not answer any more."""

    async def request_streams(self, rates: Mapping[int, float], *, measure_s: float) -> tuple[str, ...]:
        self.tlog.write_bytes(bytes(1000))
        return await super().request_streams(rates, measure_s=measure_s)

    async def identify(self) -> Identity:
        raise CaptureEnded("that is enough", remedy="")


async def test_the_segment_begins_when_every_stream_was_asked_for(tmp_path: Path) -> None:
    """Else a replay would see a long beginning with some of the sensors, and leave the others out."""
    vehicle = SlowToStart.with_floats({}, tlog=tmp_path / "a.tlog")
    vehicle.tlog.touch()
    store = SqliteStore(None)
    job = Job("one", vehicle.id, "gyro", {}, JobState.RUNNING, 0.0, 0.0)
    handle = JobHandle(job, store, lambda _: None)
    handle.change("state", {})
    with pytest.raises(CaptureEnded, match="enough"):
        await Capture(handle, vehicle, QUICK).run()
    (segment,) = store.segments(job.id, SegmentPurpose.CAPTURE)
    assert segment.start_byte == 1000
    store.close()
