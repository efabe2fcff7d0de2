"""One ledger a vehicle, by whatever id it has; rates on their way back are waited for, kept or taken over."""

from __future__ import annotations

import asyncio

import pytest

from mavcal.service.rates.ledger import RateLedgers
from mavcal.service.vehicle.rate_ledger import LiveWatch, RateLedger, RateUser
from tests.unit.jobs.fakes import FakeRegistry, FakeVehicle


class Returning:
    """Rates that are returned once `done` is set."""

    def __init__(self) -> None:
        self.done, self.cancelled = asyncio.Event(), False

    async def work(self) -> None:
        try:
            await self.done.wait()
        except asyncio.CancelledError:
            self.cancelled = True
            raise


def watch(id_: str, rate_hz: float, until: float = 10.0) -> LiveWatch:
    return LiveWatch(id_, "v", rate_hz, until)


@pytest.fixture
def registry() -> FakeRegistry:
    return FakeRegistry({"link-1-1": FakeVehicle({}, id="link-1-1")})


async def test_a_vehicle_keeps_its_ledger_when_it_gets_its_lasting_id(registry: FakeRegistry) -> None:
    ledgers = RateLedgers(registry)
    ledgers.of("link-1-1").watches["a"] = watch("a", 20.0)
    registry.vehicles["link-1-1"].id = "uid-1"
    registry.vehicles["uid-1"] = registry.vehicles["link-1-1"]
    assert ledgers.of("uid-1").wanted_hz(0.0) == 20.0
    assert ledgers.of("uid-1") is ledgers.of("link-1-1")


async def test_two_addresses_that_turn_out_to_be_one_vehicle_get_one_ledger(registry: FakeRegistry) -> None:
    registry.vehicles["other-1-1"] = FakeVehicle({}, id="other-1-1")
    ledgers, returning = RateLedgers(registry), Returning()
    ledgers.of("link-1-1").watches["a"] = watch("a", 20.0)
    ledgers.of("other-1-1").watches["b"] = watch("b", 50.0)
    ledgers.of("other-1-1").begin_return(RateUser.JOB, returning.work(), owner="j")
    registry.vehicles["other-1-1"] = registry.vehicles["link-1-1"]
    ledger = ledgers.of("link-1-1")
    assert ledger.wanted_hz(0.0) == 50.0
    assert ledger.returning(RateUser.JOB)
    assert ledgers.all() == (ledger,)
    returning.done.set()
    await ledger.returned(RateUser.JOB)
    assert not ledger.returning(RateUser.JOB)


async def test_a_unit_that_is_found_anew_keeps_who_watches_and_has_no_rates_set(registry: FakeRegistry) -> None:
    ledgers = RateLedgers(registry)
    gone = ledgers.of("link-1-1")
    gone.watches["a"] = watch("a", 20.0)
    gone.requested_us[27] = 20_000
    gone.note_before("link", 27, 500_000)
    del registry.vehicles["link-1-1"]
    assert ledgers.of("link-1-1") is gone
    registry.vehicles["link-1-1"] = FakeVehicle({}, id="link-1-1")
    ledger = ledgers.of("link-1-1")
    assert ledger is registry.vehicles["link-1-1"].rates
    assert ledger.wanted_hz(0.0) == 20.0
    assert ledger.requested_us == {}
    assert not ledger.knows_before("link", 27)
    assert ledgers.all() == (ledger,)


async def test_rates_that_are_kept_for_an_accept_stay_so_when_the_unit_is_found_anew(registry: FakeRegistry) -> None:
    ledgers = RateLedgers(registry)
    gone = ledgers.of("link-1-1")
    gone.begin_return(RateUser.JOB, gone.wait_for_hurry(), owner="j")
    await asyncio.sleep(0)
    registry.vehicles["link-1-1"] = FakeVehicle({}, id="link-1-1")
    ledger = ledgers.of("link-1-1")
    await asyncio.sleep(0.01)
    assert ledger.returning(RateUser.JOB)
    await ledger.returned(RateUser.JOB)  # somebody else needs the rates
    assert not ledger.returning(RateUser.JOB)


async def test_a_second_return_of_a_joined_ledger_waits_for_no_accept(registry: FakeRegistry) -> None:
    one, other = RateLedger(), RateLedger()
    for ledger in (one, other):
        ledger.begin_return(RateUser.JOB, ledger.wait_for_hurry(), owner="j")
    second = next(iter(other.tasks))
    one.join(other)
    await asyncio.wait({second}, timeout=1.0)
    assert second.done()
    assert one.returning(RateUser.JOB)
    await one.returned(RateUser.JOB)


async def test_a_watch_lapses_and_a_ledger_without_anything_is_forgotten(registry: FakeRegistry) -> None:
    ledgers = RateLedgers(registry)
    ledger = ledgers.of("link-1-1")
    ledger.watches |= {"a": watch("a", 50.0, until=1.0), "b": watch("b", 20.0)}
    assert [ledger.wanted_hz(now) for now in (0.5, 1.0, 10.0)] == [50.0, 20.0, 0.0]
    assert ledgers.all() == ()


async def test_rates_on_their_way_back_are_kept_for_their_own_job_alone(registry: FakeRegistry) -> None:
    ledger, returning = RateLedgers(registry).of("link-1-1"), Returning()
    ledger.begin_return(RateUser.JOB, returning.work(), owner="j")
    await asyncio.sleep(0)
    assert not await ledger.kept_for("another")
    assert ledger.returning(RateUser.JOB)
    assert await ledger.kept_for("j")
    assert returning.cancelled
    assert not ledger.returning(RateUser.JOB)


async def test_a_preflight_takes_over_what_an_earlier_one_owes(registry: FakeRegistry) -> None:
    ledger, returning = RateLedgers(registry).of("link-1-1"), Returning()
    assert ledger.taken_over(RateUser.PREFLIGHT) == {}
    ledger.begin_return(RateUser.PREFLIGHT, returning.work(), intervals={27: 500_000})
    await asyncio.sleep(0)
    assert ledger.taken_over(RateUser.PREFLIGHT) == {27: 500_000}
    await asyncio.sleep(0)
    assert returning.cancelled


async def test_a_return_that_replaces_another_is_waited_for_too(registry: FakeRegistry) -> None:
    """A look that gives way ends by beginning the return of its rates."""
    ledger, rates = RateLedgers(registry).of("link-1-1"), Returning()

    async def look() -> None:
        await asyncio.sleep(0)
        ledger.begin_return(RateUser.PREFLIGHT, rates.work(), intervals={27: 0})

    ledger.begin_return(RateUser.PREFLIGHT, asyncio.create_task(look()))
    waiting = asyncio.create_task(ledger.returned(RateUser.PREFLIGHT))
    await asyncio.sleep(0.01)
    assert not waiting.done()
    rates.done.set()
    await waiting
