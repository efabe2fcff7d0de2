"""Whatever is raised wherever: a job that writes ends at an end, or is in doubt with a task that tries again."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from structlog.testing import capture_logs

from mavcal.service.errors import DiskFull, ParameterTimeout, VehicleUnknown, WriteFailed, WriteStopped
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.states import ENDED, WRITING, JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.jobs.write.context import WriteContext
from mavcal.service.store import SqliteStore
from tests.examples import examples
from tests.unit.jobs.conftest import NEW, OLD, QUICK, FakeCheck, float32
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle
from tests.unit.jobs.test_engine import reviewed

BEFORE = {name: float32(OLD[name]) for name in NEW}
AFTER = {name: float32(value) for name, value in NEW.items()}


class UnforeseenError(Exception):
    """An error of no tree that the service knows."""


ERRORS: tuple[Callable[[], BaseException], ...] = (
    lambda: KeyError("x"),
    lambda: ValueError("x"),
    lambda: OSError(5, "Input/output error"),
    lambda: TimeoutError(),
    lambda: AssertionError(),
    lambda: ExceptionGroup("several", [KeyError("x"), ValueError("y")]),
    lambda: sqlite3.OperationalError("disk I/O error"),
    lambda: asyncio.CancelledError(),  # of a task inside; nobody cancelled the job
    lambda: UnforeseenError("x"),
    lambda: DiskFull(),
    lambda: WriteFailed("no"),
    lambda: WriteStopped("stop"),
    lambda: ParameterTimeout("no answer", name="x"),
    lambda: VehicleUnknown(),
)
VEHICLE = ("identify", "read_parameter", "set_parameter", "command", "set_intervals", "condition", "on_parameter")
STORE = ("add_journal", "journal", "save_job", "add_event", "snapshot", "add_snapshot")
WRITE_POINTS = [at for at in At if not at.value.startswith("capture") and at not in (At.FITTED, At.ACCEPTED)]


@dataclass
class Trouble:
    """Raises at the `nth` call of one method, or at a named instant, and so often as it was told to."""

    make: Callable[[], BaseException]
    nth: int
    times: int
    calls: int = 0
    struck: int = 0
    active: bool = False

    def strike(self) -> None:
        if not self.active:
            return
        self.calls += 1
        if self.calls >= self.nth and self.struck < self.times:
            self.struck += 1
            raise self.make()

    def spoil(self, owner: Any, method: str) -> None:
        original = getattr(owner, method)

        def sync(*args: Any, **kwargs: Any) -> Any:
            self.strike()
            return original(*args, **kwargs)

        async def waiting(*args: Any, **kwargs: Any) -> Any:
            self.strike()
            return await original(*args, **kwargs)

        setattr(owner, method, waiting if asyncio.iscoroutinefunction(original) else sync)


@dataclass
class Engine(JobEngine):
    """An engine whose physical check needs no stream."""

    check: FakeCheck = field(default_factory=FakeCheck)

    def __init__(self, store: SqliteStore, vehicle: FakeVehicle, reach: Callable[[At], None], check: FakeCheck) -> None:
        super().__init__(store, FakeRegistry({vehicle.id: vehicle}), settings=QUICK, reach=reach)
        self.check = check
        attempt = self._transactions.attempt

        def checked(job: Job, handle: JobHandle) -> WriteContext:
            made = attempt(job, handle)
            made.check = self.check
            return made

        self._transactions.attempt = checked  # type: ignore[method-assign]

    def stranded(self) -> list[str]:
        """Jobs that are not at an end and have no task."""
        busy = {job.id for job in self.list() if job.state not in ENDED | {JobState.REVIEW}}
        return [i for i in busy if i not in self.tasks.running or self.tasks.running[i].done()]


@settings(max_examples=examples(120), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    where=st.one_of(
        st.tuples(st.just("reach"), st.sampled_from(WRITE_POINTS)),
        st.tuples(st.just("vehicle"), st.sampled_from(VEHICLE)),
        st.tuples(st.just("store"), st.sampled_from(STORE)),
    ),
    make=st.sampled_from(ERRORS),
    nth=st.integers(1, 12),
    times=st.sampled_from([1, 2, 5, 40]),
    deaf=st.booleans(),
    reverting=st.booleans(),
    armed=st.booleans(),
)
def test_no_exception_of_any_kind_strands_a_write(
    where: tuple[str, Any],
    make: Callable[[], BaseException],
    nth: int,
    times: int,
    deaf: bool,
    reverting: bool,
    armed: bool,
) -> None:
    vehicle, store = FakeVehicle.with_floats(OLD), SqliteStore(None)
    trouble = Trouble(make, nth, times)

    def reach(at: At) -> None:
        if where == ("reach", at):
            trouble.strike()

    async def run() -> JobState:
        engine = Engine(store, vehicle, reach, FakeCheck({"INS_GYROFFS_Y"} if deaf else set()))
        job = reviewed(vehicle)
        assert job.plan is not None
        _keep(store, job, vehicle)
        await engine.start()
        if where[0] == "vehicle":
            trouble.spoil(vehicle, where[1])
        elif where[0] == "store":
            trouble.spoil(store, where[1])
        if armed:
            vehicle.after_set = lambda n: vehicle.change_state(armed=True) if n == 2 else None
        accepted = Accept(job.plan.sha256)
        trouble.active = not reverting
        try:
            await engine.apply("j1", accepted)
        except (Exception, asyncio.CancelledError):  # noqa: BLE001 - refused to the caller
            trouble.active = False
            assert engine.get("j1").state == JobState.REVIEW
            assert vehicle.sets == []
        await _ended(engine, vehicle)
        if reverting and engine.get("j1").state == JobState.SUCCEEDED:
            trouble.active = True
            try:
                await engine.revert("j1")
            except (Exception, asyncio.CancelledError):  # noqa: BLE001
                trouble.active = False
                assert engine.get("j1").state == JobState.SUCCEEDED
            await _ended(engine, vehicle)
        state = engine.get("j1").state
        trouble.active = False
        await engine.stop()
        return state

    with capture_logs():  # every trouble is logged with its traceback, which takes longer than the write
        state = asyncio.run(run())
    held = {name: vehicle.values()[name] for name in NEW}
    assert state in (JobState.SUCCEEDED, JobState.REVERTED, JobState.REVIEW)
    assert held == (AFTER if state == JobState.SUCCEEDED else BEFORE)
    store.close()


def _keep(store: SqliteStore, job: Job, vehicle: FakeVehicle) -> None:
    from mavcal.service.jobs.core.codec import row_from_job
    from mavcal.service.store.rows import SnapshotPurpose

    assert job.plan is not None
    store.save_job(row_from_job(job))
    store.add_snapshot(job.id, 0.0, SnapshotPurpose.COMPOSED_ON, job.plan.snapshot_sha256, vehicle.values())


async def _ended(engine: Engine, vehicle: FakeVehicle) -> None:
    """Until the job is at an end; meanwhile it always has a task, and a doubt its list."""
    async with asyncio.timeout(20):
        while (job := engine.get("j1")).state in WRITING:
            assert not engine.stranded()
            if job.state == JobState.IN_DOUBT:
                assert job.standing
                if vehicle.state.armed:
                    vehicle.after_set = lambda _: None
                    vehicle.change_state(armed=False)
            await asyncio.sleep(0.0005)
