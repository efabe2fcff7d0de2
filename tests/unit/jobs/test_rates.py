"""Message rates that a job changed are put back: after a review's patience, before another capture, never twice."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from mavcal.service.errors import CommandTimeout
from mavcal.service.jobs.core.handle import JobHandle
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.rates import JobRates, ask_for_streams, return_streams
from mavcal.service.rates.ledger import RateLedgers
from mavcal.service.store import SqliteStore
from mavcal.service.vehicle.rate_ledger import RateUser
from tests.unit.jobs.conftest import until
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle


class Changed:
    """Jobs of one vehicle that have asked for streams."""

    def __init__(self, review_s: float = 60.0) -> None:
        self.store = SqliteStore(None)
        self.vehicle = FakeVehicle({}, id="v", message_intervals={27: 500_000})
        self.ledgers = RateLedgers(FakeRegistry({"v": self.vehicle}))
        self.rates = JobRates(self.ledgers, self._found, review_s)

    async def _found(self, _handle: JobHandle) -> FakeVehicle:
        await asyncio.sleep(0)
        return self.vehicle

    def job(self, id_: str, state: JobState = JobState.REVIEW) -> JobHandle:
        handle = JobHandle(Job(id_, "v", "gyro", {}, state, 0.0, 0.0), self.store, lambda _: None)
        handle.change("state", {})
        return handle

    async def asked(self, id_: str, state: JobState = JobState.REVIEW) -> JobHandle:
        handle = self.job(id_, state)
        await ask_for_streams(handle, self.vehicle, {27: 50.0, 30: 10.0})
        assert self.vehicle.message_intervals == {27: 20_000, 30: 100_000}
        return handle

    @property
    def put_back(self) -> bool:
        return self.vehicle.message_intervals == {27: 500_000, 30: 0}


@pytest.fixture
def changed() -> Iterator[Changed]:
    found = Changed()
    yield found
    found.store.close()


async def test_what_was_before_is_in_the_journal_and_is_put_back(changed: Changed) -> None:
    handle = await changed.asked("one", JobState.FAILED)
    assert handle.write_record().intervals == {27: 500_000, 30: 0}
    changed.rates.begin_return(handle)
    await until(lambda: not changed.rates.tasks)
    assert changed.put_back
    assert handle.write_record().intervals == {}


async def test_asking_again_does_not_take_the_changed_rate_for_the_old_one(changed: Changed) -> None:
    handle = await changed.asked("one")
    await ask_for_streams(handle, changed.vehicle, {27: 100.0, 33: 5.0})
    assert handle.write_record().intervals == {27: 500_000, 30: 0, 33: 0}


async def test_a_review_keeps_its_rates_for_an_accept(changed: Changed) -> None:
    handle = await changed.asked("one")
    changed.rates.begin_return(handle)
    await asyncio.sleep(0.01)
    assert not changed.put_back
    await changed.rates.before_write(handle)
    assert changed.rates.tasks == set()
    assert not changed.put_back


async def test_a_write_that_waits_for_the_rates_of_a_preflight_keeps_those_of_its_job(changed: Changed) -> None:
    handle = await changed.asked("one")
    changed.rates.begin_return(handle)
    await asyncio.sleep(0)
    looked = asyncio.Event()
    changed.ledgers.of("v").begin_return(RateUser.PREFLIGHT, looked.wait())
    writing = asyncio.create_task(changed.rates.before_write(handle))
    await asyncio.sleep(0.01)
    assert not writing.done()
    looked.set()
    await writing
    assert changed.rates.tasks == set()
    assert not changed.put_back


async def test_a_review_that_is_not_accepted_has_them_put_back() -> None:
    changed = Changed(review_s=0.01)
    changed.rates.begin_return(await changed.asked("one"))
    await until(lambda: changed.put_back)
    changed.store.close()


@pytest.mark.parametrize("begin", ["capture", "write"])
async def test_another_jobs_capture_and_write_do_not_wait_for_the_accept(changed: Changed, begin: str) -> None:
    changed.rates.begin_return(await changed.asked("first"))
    if begin == "capture":
        await changed.rates.before_capture("v")
    else:
        await changed.rates.before_write(changed.job("second", JobState.RUNNING))
    assert changed.put_back


async def test_what_an_earlier_job_owes_waits_for_the_recovered_write_of_another(changed: Changed) -> None:
    """A return in the middle of the check took the samples away: "the vehicle sends no inertial data"."""
    owing, recovered = await changed.asked("first", JobState.FAILED), changed.job("second", JobState.IN_DOUBT)
    async with changed.rates.turn(recovered):
        changed.rates.begin_return(owing)
        await asyncio.sleep(0.01)
        assert not changed.put_back
    await until(lambda: changed.put_back)


async def test_a_job_that_changed_nothing_leaves_nothing_to_do(changed: Changed) -> None:
    changed.rates.begin_return(changed.job("one"))
    assert changed.rates.tasks == set()
    await changed.rates.before_capture("v")


async def test_rates_that_cannot_be_put_back_are_said_and_kept_for_later(changed: Changed) -> None:
    handle = await changed.asked("one")

    async def silent(_intervals: object) -> None:
        await asyncio.sleep(0)
        raise CommandTimeout("no answer")

    works, changed.vehicle.set_intervals = changed.vehicle.set_intervals, silent  # type: ignore[method-assign]
    await return_streams(handle, changed.vehicle)
    assert handle.job.warnings == ("the message rates could not be put back yet: no answer",)
    assert handle.write_record().intervals == {27: 500_000, 30: 0}
    changed.vehicle.set_intervals = works  # type: ignore[method-assign]
    await return_streams(handle, changed.vehicle)
    assert changed.put_back
    assert handle.write_record().intervals == {}


async def test_warnings_of_a_slow_link_are_kept(changed: Changed) -> None:
    async def slow(*_: object, **__: object) -> tuple[str, ...]:
        await asyncio.sleep(0)
        return ("the link is slow",)

    changed.vehicle.request_streams = slow  # type: ignore[method-assign]
    handle = changed.job("one")
    await ask_for_streams(handle, changed.vehicle, {27: 50.0})
    assert handle.job.warnings == ("the link is slow",)
    assert [row.step for row in changed.store.journal("one")] == [JournalStep.STREAMS]
