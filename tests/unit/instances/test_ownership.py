from __future__ import annotations

import asyncio

import pytest

from mavcal.service.errors import LeaseLost, StoreError
from mavcal.service.instances.instance import LeasedJobs, job_subject, link_subject, vehicle_subject
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import plain


class Leases:
    """What this instance holds; it gets what is free."""

    def __init__(self, *held, free=True):
        self.held, self.free = set(held), free
        self.broken = False

    def acquire(self, subject):
        if self.free:
            self.held.add(subject)
        return self.free

    def release(self, subject):
        if self.broken:
            raise StoreError("it is away")
        self.held.discard(subject)

    def holds(self, subject):
        return subject in self.held

    def fence(self, subject):
        return ("fence", subject)


class Store:
    def fenced(self, fence):
        return ("store", fence)

    async def do(self, work):
        return work()


def owned(leases):
    return LeasedJobs(leases, Store(), lambda: None)


FIT = plain("f", JobState.QUEUED, kind="fit", vehicle_id=None)
GYRO = plain("g", JobState.QUEUED)


def test_a_job_goes_with_its_vehicle_and_one_without_has_a_lease_of_its_own():
    assert job_subject(GYRO) == vehicle_subject("v1")
    assert job_subject(FIT) == "job:f"
    assert (
        len({vehicle_subject("x"), link_subject("x"), job_subject(plain("x", JobState.QUEUED, vehicle_id=None))}) == 3
    )


async def test_a_job_without_a_vehicle_is_leased_when_it_begins():
    leases = Leases()
    await owned(leases).begin(FIT)
    await owned(leases).begin(GYRO)  # its vehicle's lease came with the link
    assert leases.held == {"job:f"}
    with pytest.raises(LeaseLost, match="job:f is owned by another instance"):
        await owned(Leases(free=False)).begin(FIT)


def test_what_is_written_of_a_job_is_fenced_by_its_lease():
    assert owned(Leases()).store_of(GYRO) == ("store", ("fence", vehicle_subject("v1")))
    assert owned(Leases()).store_of(FIT) == ("store", ("fence", "job:f"))


@pytest.mark.parametrize(
    ("job", "held"),
    [
        (plain("f", JobState.SUCCEEDED, vehicle_id=None), False),
        (plain("f", JobState.FITTING, vehicle_id=None), True),  # it goes on
        (plain("f", JobState.SUCCEEDED, vehicle_id="v1"), True),  # whose lease it has is not its own
    ],
)
async def test_a_lease_is_given_back_when_its_job_has_ended(job, held):
    leases = Leases(job_subject(job))
    jobs = owned(leases)
    jobs.ended(job)
    await asyncio.gather(*jobs._ending)
    assert leases.holds(job_subject(job)) is held


async def test_a_database_that_is_away_at_the_end_is_no_error():
    leases = Leases("job:f")
    leases.broken = True
    jobs = owned(leases)
    jobs.ended(plain("f", JobState.FAILED, vehicle_id=None))
    await asyncio.gather(*jobs._ending)
    await asyncio.sleep(0)
    assert jobs._ending == set()


def test_a_vehicle_of_another_instance_may_not_be_written_to():
    assert owned(Leases(vehicle_subject("v1"))).doubted("v1") is None
    assert "another instance" in owned(Leases(vehicle_subject("v1"))).doubted("v2")
