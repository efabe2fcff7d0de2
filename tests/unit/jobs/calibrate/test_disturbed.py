"""A vehicle calibrates by itself in the middle of a capture."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from mavcal.service.jobs.calibrate.runner import EARLY_S, REPEATS
from mavcal.service.jobs.core.model import Failure, Job
from mavcal.service.jobs.core.segments import captured
from mavcal.service.jobs.core.states import CAPTURING, JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import SegmentPurpose, SegmentRow
from tests.unit.jobs.conftest import OLD, QUICK, until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle

Begin = Callable[[str], AbstractAsyncContextManager["Capturing"]]
PATIENT = replace(QUICK, busy_s=60.0, stall_s=600.0)


@dataclass
class Capturing:
    """A job of a vehicle that stands still for ever and sends nothing."""

    engine: JobEngine
    store: SqliteStore
    vehicle: FakeVehicle
    job_id: str

    @property
    def job(self) -> Job:
        return self.engine.get(self.job_id)

    async def begun(self, times: int) -> None:
        """Wait until the capture runs for the `times`-th time."""
        await until(lambda: len(self.segments()) == times and self.segments()[-1].end_byte is None)

    async def disturbed(self) -> None:
        """Begin a calibration of the vehicle's own, and wait until the capture has ended for it."""
        self.vehicle.change_state(calibrating=True)
        await until(lambda: self.segments()[-1].end_byte is not None)

    def segments(self) -> tuple[SegmentRow, ...]:
        return self.store.segments(self.job_id, SegmentPurpose.CAPTURE)


@pytest.fixture
def capturing(tmp_path: Path) -> Begin:
    @asynccontextmanager
    async def begin(kind: str) -> AsyncIterator[Capturing]:
        vehicle = FakeVehicle.with_floats(OLD, tlog=tmp_path / "a.tlog")
        vehicle.tlog.touch()
        store = SqliteStore(None)
        engine = JobEngine(store, FakeRegistry({vehicle.id: vehicle}), settings=PATIENT)
        await engine.start()
        try:
            job = await engine.submit(vehicle.id, kind)
            yield Capturing(engine, store, vehicle, job.id)
        finally:
            await engine.stop()
            store.close()

    return begin


@pytest.mark.parametrize("kind", ["gyro", "level", "accel-one-axis"])
async def test_a_rest_begins_again_and_what_came_before_is_set_aside(capturing: Begin, kind: str) -> None:
    async with capturing(kind) as c:
        await c.begun(1)
        await c.disturbed()
        await until(lambda: c.job.prompt is not None and c.job.prompt.step == "busy")
        assert any("the capture begins again" in text for text in c.job.warnings)
        c.vehicle.change_state(calibrating=False)
        await c.begun(2)
        assert c.job.state in CAPTURING
        assert captured(c.job, c.store) == c.segments()[1:]  # the fit is made of these alone
        assert c.vehicle.sets == []


@pytest.mark.parametrize(("elapsed", "again"), [(0.0, True), (EARLY_S + 1.0, False)])
async def test_a_warm_up_begins_again_in_its_first_minute_only(
    capturing: Begin, monkeypatch: pytest.MonkeyPatch, elapsed: float, again: bool
) -> None:
    monkeypatch.setattr("mavcal.service.jobs.calibrate.runner.EARLY_S", EARLY_S - elapsed)
    async with capturing("thermal") as c:
        await c.begun(1)
        await c.disturbed()
        c.vehicle.change_state(calibrating=False)
        if again:
            await c.begun(2)
        else:
            await until(lambda: c.job.state == JobState.FAILED)


async def test_it_begins_again_only_so_often(capturing: Begin) -> None:
    async with capturing("gyro") as c:
        for time in range(REPEATS + 1):
            await c.begun(time + 1)
            await c.disturbed()
            c.vehicle.change_state(calibrating=False)
        await until(lambda: c.job.state == JobState.FAILED)
        assert isinstance(c.job.outcome, Failure)
        assert c.job.outcome.code == "capture-disturbed"


async def test_poses_are_not_asked_for_again_in_silence_the_job_says_what_happened(capturing: Begin) -> None:
    async with capturing("accel") as c:
        await c.begun(1)
        await c.disturbed()
        await until(lambda: c.job.state == JobState.FAILED)
        assert isinstance(c.job.outcome, Failure)
        assert c.job.outcome.cause.startswith("the vehicle began a calibration of its own")
        assert c.job.outcome.remedy.startswith("Nothing was written. Let it finish, then start the job again")
