"""The rounds of one instance among others: what it keeps, gives up, and takes over."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from types import SimpleNamespace

import pytest

from mavcal.service.errors import PortBusy, StoreError
from mavcal.service.instances.instance import ROUNDS_A_LEASE, Membership
from mavcal.service.instances.leases import EVERY_INSTANCE, Owner
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobRow, LinkRow
from mavcal.service.vehicle.events import VehicleEvent, VehicleEventKind
from tests.patience import scaled
from tests.unit.commands.doubles import plain

US, THEM = Owner("us", "a", None), Owner("them", "b", "http://b/")
OURS = f"{EVERY_INSTANCE}us"


class Leases:
    """Leases of a database that everybody reaches: who owns what, and what we believe to hold."""

    owner, lease_s = US, 60.0

    def __init__(self) -> None:
        self.table: dict[str, Owner] = {}
        self.held: dict[str, None] = {}
        self.asked: list[str] = []
        self.away = False

    def renew(self):
        if self.away:
            raise StoreError("it is away")
        lost = {subject for subject in self.held if self.table.get(subject) is not US}
        for subject in lost:
            del self.held[subject]
        return lost

    def acquire(self, subject):
        self.asked.append(subject)
        if self.table.setdefault(subject, US) is not US:
            return False
        self.held[subject] = None
        return True

    def release(self, subject):
        self.held.pop(subject, None)
        self.table.pop(subject, None)

    def mine(self, prefix):
        return tuple(subject for subject in self.held if subject.startswith(prefix))

    def owners(self):
        return dict(self.table)


class Links:
    """What is open here; some endpoints cannot be opened."""

    def __init__(self) -> None:
        self.opened: dict[str, tuple[bool, bool]] = {}
        self.broken: set[str] = set()
        self.left: list[str] = []

    def all(self):
        return tuple(SimpleNamespace(id=url.replace(":", "-")) for url in self.opened)

    async def open(self, url, *, remember, trusted):
        if url in self.broken:
            raise PortBusy("another program uses it")
        self.opened[url] = (remember, trusted)

    async def leave(self, link_id):
        self.left.append(link_id)


class Engine:
    """Which jobs it was given and had to give up."""

    def __init__(self) -> None:
        self.taken: list[str] = []
        self.jobs = [plain("v1-job", JobState.REVIEW, vehicle_id="v1"), plain("fit", JobState.QUEUED, vehicle_id=None)]
        self.given_up: list[str] = []

    def take_over(self, rows):
        self.taken += [row.id for row in rows]

    def give_up(self, of):
        self.given_up += [job.id for job in self.jobs if of(job)]


class Vehicles:
    """Who is heard here."""

    def __init__(self) -> None:
        self.heard: list[SimpleNamespace] = []
        self.told: list[Callable[[VehicleEvent], None]] = []

    def hear(self, vehicle_id, *, known=True):
        self.heard.append(SimpleNamespace(id=vehicle_id, identity=SimpleNamespace(known=known)))

    def all(self):
        return tuple(self.heard)

    def subscribe(self, told):
        self.told.append(told)
        return lambda: self.told.remove(told)


class House:
    """One instance and the database of all."""

    def __init__(self) -> None:
        self.leases, self.links, self.engine, self.vehicles = Leases(), Links(), Engine(), Vehicles()
        self.store = SqliteStore(None)
        self._at = itertools.count(1.0)

    def membership(self, *named: str) -> Membership:
        return Membership(self.leases, self.store, self.engine, self.links, self.vehicles, named=named)

    async def in_a_round(self) -> None:
        """Wait until a round has looked for jobs, which it does last."""
        asked, loop, jobs = asyncio.Event(), asyncio.get_running_loop(), self.store.jobs

        def look(**which: object) -> tuple[JobRow, ...]:
            loop.call_soon_threadsafe(asked.set)
            return jobs(**which)  # type: ignore[arg-type]

        self.store.jobs = look  # type: ignore[method-assign]
        await asked.wait()
        await self.store.do(lambda: None)

    def remember(self, *urls: str) -> None:
        for url in urls:
            self.store.save_link(LinkRow(url.replace(":", "-"), url, 1.0))

    def job(self, job_id: str, state: str, vehicle: str | None = None) -> None:
        at = next(self._at)
        self.store.save_job(JobRow(job_id, vehicle, "fit", state, at, at, {}))


@pytest.fixture
def house() -> Iterator[House]:
    made = House()
    yield made
    made.store.close()


async def test_an_instance_says_that_it_is_there_and_says_so_again_when_that_was_lost(house: House) -> None:
    member = house.membership()
    await member.round()
    await member.round()
    assert house.leases.asked == [OURS]
    house.leases.release(OURS)
    await member.round()
    assert house.leases.asked == [OURS, OURS]


async def test_links_that_nobody_has_open_are_opened_and_those_of_others_are_not(house: House) -> None:
    house.remember("tcp:v:1", "tcp:v:2", "tcp:v:3")
    house.leases.table["link:tcp-v-2"] = THEM
    house.links.opened["tcp:v:3"] = (True, False)
    await house.membership().round()
    assert house.links.opened == {"tcp:v:3": (True, False), "tcp:v:1": (True, False)}


async def test_a_link_of_our_former_life_is_opened_again(house: House) -> None:
    """After a restart the database still says that we own it."""
    house.remember("tcp:v:1")
    house.leases.table["link:tcp-v-1"] = US
    await house.membership().round()
    assert list(house.links.opened) == ["tcp:v:1"]


async def test_what_the_settings_name_is_trusted_and_not_remembered(house: House) -> None:
    await house.membership("tcp:v:9").round()
    assert house.links.opened == {"tcp:v:9": (False, True)}


@pytest.mark.parametrize(("others", "shares"), [(0, [5]), (1, [3, 1, 1]), (2, [2, 1, 1, 1])])
async def test_free_links_are_shared_among_those_who_are_there(house: House, others: int, shares: list[int]) -> None:
    house.remember(*(f"tcp:v:{port}" for port in range(1, 6)))
    house.leases.table |= {f"{EVERY_INSTANCE}{n}": Owner(str(n), "x", None) for n in range(others)}
    member, opened = house.membership(), []
    for _ in shares:
        before = len(house.links.opened)
        await member.round()
        opened.append(len(house.links.opened) - before)
    assert opened == shares
    assert len(house.links.opened) == 5


async def test_a_link_that_cannot_be_opened_keeps_no_other_closed(house: House) -> None:
    house.remember("tcp:v:1", "tcp:v:2")
    house.links.broken.add("tcp:v:1")
    house.vehicles.hear("v1")
    await house.membership().round()
    assert list(house.links.opened) == ["tcp:v:2"]
    assert "vehicle:v1" in house.leases.held


async def test_a_vehicle_that_has_said_who_it_is_is_owned_with_its_jobs(house: House) -> None:
    house.job("old", "succeeded", "v1")
    house.job("open", "applying", "v1")
    house.job("other", "applying", "v2")
    house.vehicles.hear("v1")
    house.vehicles.hear("v3", known=False)
    member = house.membership()
    await member.round()
    assert house.engine.taken == ["old", "open"]
    assert house.leases.mine("vehicle:") == ("vehicle:v1",)
    await member.round()
    assert house.engine.taken == ["old", "open"]  # once


@pytest.mark.parametrize("known_to_be_theirs", [True, False])
async def test_a_vehicle_of_another_instance_is_left_to_it(house: House, known_to_be_theirs: bool) -> None:
    house.job("open", "applying", "v1")
    house.vehicles.hear("v1")
    house.leases.table["vehicle:v1"] = THEM
    if not known_to_be_theirs:  # it was taken between our look and our try
        house.leases.owners = dict  # type: ignore[method-assign]
    await house.membership().round()
    assert house.engine.taken == []
    assert ("vehicle:v1" in house.leases.asked) is not known_to_be_theirs


async def test_jobs_without_a_vehicle_that_their_instance_left_go_on_here(house: House) -> None:
    for state in JobState:
        house.job(f"{state}", state)
    house.job("of a vehicle", "queued", "v1")
    house.job("theirs", "queued")
    house.leases.table["job:theirs"] = THEM
    await house.membership().round()
    assert set(house.engine.taken) == {str(state) for state in set(JobState) - ENDED}
    assert set(house.leases.mine("job:")) == {f"job:{state}" for state in house.engine.taken}


async def test_a_job_that_ended_between_two_looks_is_not_begun_again(house: House) -> None:
    house.job("j", "queued")
    acquire = house.leases.acquire

    def end_first(subject: str) -> bool:
        if subject == "job:j":
            house.job("j", "succeeded")
        return acquire(subject)

    house.leases.acquire = end_first  # type: ignore[method-assign]
    await house.membership().round()
    assert house.engine.taken == []
    assert house.leases.mine("job:") == ()
    assert "job:j" not in house.leases.table


async def test_what_was_lost_is_given_up_link_vehicle_and_job_alike(house: House) -> None:
    member = house.membership()
    for subject in ("link:tcp-v-1", "vehicle:v1", "job:fit"):
        house.leases.acquire(subject)
    await member.round()
    assert (house.links.left, house.engine.given_up) == ([], [])
    house.leases.table["link:tcp-v-1"] = THEM
    await member.round()
    assert (house.links.left, house.engine.given_up) == (["tcp-v-1"], [])
    house.leases.table["vehicle:v1"] = THEM
    await member.round()
    assert house.engine.given_up == ["v1-job"]
    house.leases.table["job:fit"] = THEM
    await member.round()
    assert house.engine.given_up == ["v1-job", "fit"]


async def test_a_vehicle_that_is_gone_for_a_whole_lease_is_left_to_whoever_hears_it(house: House) -> None:
    house.vehicles.hear("v1")
    member = house.membership()
    await member.round()
    gone, house.vehicles.heard = house.vehicles.heard, []
    for _ in range(ROUNDS_A_LEASE):
        await member.round()
    house.vehicles.heard = gone  # it comes back in time: the count begins again
    await member.round()
    house.vehicles.heard = []
    for _ in range(ROUNDS_A_LEASE):
        await member.round()
    await house.store.do(lambda: None)
    assert "vehicle:v1" in house.leases.held
    assert house.engine.given_up == []
    await member.round()
    await house.store.do(lambda: None)
    assert "vehicle:v1" not in house.leases.table
    assert house.engine.given_up == ["v1-job"]


@asynccontextmanager
async def going_on(member: Membership) -> AsyncIterator[asyncio.Task[None]]:
    """Rounds meanwhile."""
    task = asyncio.create_task(member.run())
    try:
        yield task
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_vehicle_that_says_who_it_is_is_not_kept_waiting_for_the_next_round(house: House) -> None:
    owned = asyncio.Event()
    house.engine.take_over = lambda rows: owned.set()  # type: ignore[method-assign]
    member = house.membership()
    async with asyncio.timeout(scaled(10)), going_on(member):
        await house.in_a_round()
        house.vehicles.hear("v1")
        house.vehicles.told[0](VehicleEvent(VehicleEventKind.IDENTIFIED, "v1", ""))
        await owned.wait()
    assert house.vehicles.told == []  # nobody listens any more


@pytest.mark.parametrize("steps", range(6))
async def test_a_vehicle_that_speaks_at_the_moment_of_the_stop_does_not_keep_it_going(house: House, steps: int) -> None:
    """`asyncio.wait_for` of Python 3.11 takes such a cancellation for itself, and the service never ended."""
    member = house.membership()
    async with going_on(member) as task:
        await house.in_a_round()
        for _ in range(20):  # it waits for the next one
            await asyncio.sleep(0)
        house.vehicles.told[0](VehicleEvent(VehicleEventKind.IDENTIFIED, "v1", ""))
        for _ in range(steps):
            await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait({task}, timeout=scaled(2))
        assert task.cancelled()


@pytest.mark.parametrize("error", [StoreError("it is away"), RuntimeError("a defect")])
async def test_a_round_that_breaks_is_not_the_last(house: House, error: Exception) -> None:
    house.leases.lease_s = 0.004
    renew, tries = house.leases.renew, itertools.count()

    def fail_twice() -> set[str]:
        if next(tries) < 2:
            raise error
        return renew()

    house.leases.renew = fail_twice  # type: ignore[method-assign]
    async with asyncio.timeout(scaled(10)), going_on(house.membership()):
        await house.in_a_round()
    assert OURS in house.leases.held
