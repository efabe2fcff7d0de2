from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from mavcal.calib.firmware.in_force.fingerprint import fingerprint
from mavcal.calib.firmware.plan import (
    AfterWrite,
    Change,
    ParameterKind,
    ParameterVerdict,
    ProofVerdict,
    Value,
    Verification,
    WritePlan,
    snapshot_sha256,
)
from mavcal.calib.recording import Sensor
from mavcal.service.jobs.core.crashpoints import At, no_crash
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.context import WriteContext
from mavcal.service.jobs.write.guard import WriteGuard
from mavcal.service.jobs.write.transaction import Transaction
from mavcal.service.store.postgres import PostgresStore
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.store.sql import Store
from mavcal.service.vehicle.job_vehicle import ParameterReading
from tests.patience import scaled
from tests.postgres import Server
from tests.stores import made_by, new_store
from tests.unit.jobs.fakes import FakeVehicle

ON_EACH_STORE = {"test_engine", "test_engine_life", "test_computing", "test_transaction", "test_handle"}
"""Modules whose tests run on SQLite and on PostgreSQL."""


ON_SQLITE = {
    "test_a_change_counts_as_kept_only_when_it_is_on_the_disk",  # fills the disk of SQLite
    "test_a_full_disk_before_a_send_takes_back_what_was_sent",
    "test_killed_anywhere_twice_it_ends_verified_or_as_before",  # makes a store hundreds of times
}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    both = metafunc.module.__name__.rpartition(".")[2] in ON_EACH_STORE
    if both and metafunc.function.__name__ not in ON_SQLITE:
        metafunc.parametrize("kind_of_store", ["sqlite", "postgres"], indirect=True)


@pytest.fixture(scope="session")
def empty_store(postgres: Server) -> str:
    """Name of a database with the tables of a store, and nothing in them."""
    url = postgres.database()
    PostgresStore(url, None).close()
    return url.rpartition("/")[2]


@pytest.fixture(autouse=True)
def kind_of_store(request: pytest.FixtureRequest) -> Iterator[None]:
    """Stores of this test are of this kind."""
    if getattr(request, "param", "sqlite") == "sqlite":
        yield
        return
    server, template = request.getfixturevalue("postgres"), request.getfixturevalue("empty_store")
    with made_by(lambda: PostgresStore(server.database(template=template), None)):
        yield


QUICK = JobSettings(
    settle_s={"ardupilot": 0.0, "px4": 0.0},
    save_s={"ardupilot": 0.0, "px4": 0.0},
    settle_least_s=0.0,
    watch_s=0.001,
    retry_s=0.001,
    same_boot_s=0.5,
)
IMPATIENT = replace(QUICK, reboot_timeout_s=0.2, operator_reboot_s=0.2, busy_s=0.2)
"""For tests of what happens once a limit has passed; what is to end well must not race against one."""

OLD = {"INS_GYROFFS_X": 0.0, "INS_GYROFFS_Y": 0.001, "INS_GYROFFS_Z": 0.0, "INS_GYR_ID": 1000.0, "FLAG": 1.0}
NEW = {"INS_GYROFFS_X": 0.01, "INS_GYROFFS_Y": -0.02, "INS_GYROFFS_Z": 0.005}


class Killed(BaseException):
    """The process ends here."""


@dataclass
class FakeCheck:
    """A physical check that says what the vehicle holds, without a stream."""

    deaf: set[str] = field(default_factory=set)

    async def before(self, guard: WriteGuard) -> None:
        guard.check()

    async def after(self, guard: WriteGuard, values: Mapping[str, Value]) -> Verification:
        guard.check()

        def verdict(name: str) -> ProofVerdict:
            return ProofVerdict.CONTRADICTED if name in self.deaf else ProofVerdict.PROVED

        return Verification(tuple(ParameterVerdict(n, verdict(n), 1.0, 0.1, "", "") for n in values if n in NEW))


def float32(value: float) -> float:
    return float(np.float32(value))


def make_plan(vehicle: FakeVehicle, *, session: bool = False, reboot: bool = False, command: bool = True) -> WritePlan:
    old = vehicle.values()
    changes = [
        Change(n, old[n], float32(v), ParameterKind.REAL32, "offset", sd=1e-4, needs_reboot=reboot, sensor=Sensor.GYRO)
        for n, v in NEW.items()
    ]
    if session:
        changes.insert(0, Change("FLAG", 1.0, 0.0, ParameterKind.REAL32, "off for now", session=True))
    return WritePlan(
        fingerprint(vehicle.identity, old),
        snapshot_sha256(old),
        tuple(changes),
        after=(AfterWrite(241, (0.0, 0.0, 0.0, 0.0, 76.0, 0.0, 0.0), "marks"),) if command else (),
    )


@dataclass
class Bench:
    """A job that was accepted, its vehicle, and a way to run or to resume its write."""

    vehicle: FakeVehicle
    store: Store
    plan: WritePlan
    handle: JobHandle
    accept: Accept
    check: FakeCheck
    reach: Callable[[At], None] = no_crash
    settings: JobSettings = QUICK
    before: dict[str, ParameterReading] = field(init=False)

    def __post_init__(self) -> None:
        self.before = dict(self.vehicle.parameters)

    def attempt(self) -> WriteContext:
        return WriteContext(self.handle, self.vehicle, self.plan, self.accept, self.check, self.settings, self.reach)

    @property
    def transaction(self) -> Transaction:
        return Transaction(self.handle, self.attempt, self.settings.retry_s)

    @property
    def state(self) -> JobState:
        return self.handle.job.state

    async def apply(self) -> None:
        await self.handle.record(JournalStep.ACCEPTED)
        await self.transaction.apply()

    def restarted(self) -> Bench:
        """The service after a crash: only the store and the vehicle are left."""
        row = self.store.job(self.handle.id)
        assert row is not None
        from mavcal.service.jobs.core.codec import job_from_row

        handle = JobHandle(job_from_row(row), self.store, lambda _: None)
        return Bench(self.vehicle, self.store, self.plan, handle, self.accept, self.check)

    def held(self) -> dict[str, Value]:
        return {n: self.vehicle.values()[n] for n in NEW}


async def until(condition: Callable[[], bool], seconds: float = 5.0) -> None:
    """Let the loop run until `condition` holds."""
    async with asyncio.timeout(scaled(seconds)):
        while not condition():  # noqa: ASYNC110 - the condition is about the whole world, not about one event
            await asyncio.sleep(0.001)


MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench() -> Iterator[MakeBench]:
    stores: list[Store] = []

    def make(
        *,
        session: bool = False,
        reboot: bool = False,
        command: bool = True,
        accept_reboot: bool = True,
        store: Store | None = None,
    ) -> Bench:
        vehicle = FakeVehicle.with_floats(OLD)
        store = store or new_store()
        stores.append(store)
        plan = make_plan(vehicle, session=session, reboot=reboot, command=command)
        job = Job("j1", vehicle.id, "gyro", {}, JobState.APPLYING, 0.0, 0.0, fingerprint=plan.fingerprint, plan=plan)
        handle = JobHandle(job, store, lambda _: None, progress_s=0.0)
        handle.change("state", {})
        store.add_snapshot("j1", 0.0, SnapshotPurpose.COMPOSED_ON, plan.snapshot_sha256, vehicle.values())
        accept = Accept(plan.sha256, reboot=accept_reboot)
        return Bench(vehicle, store, plan, handle, accept, FakeCheck())

    yield make
    for store in stores:
        store.close()
