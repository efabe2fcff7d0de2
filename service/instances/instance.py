"""One instance among others: keeps its leases, gives up lost ones, and takes over free subjects.

It makes a round every quarter of a lease, and as soon as a vehicle has said who it is. Job events of all instances are
repeated here: read from the database, in their order, as they come. Jobs of a vehicle go with its lease; a job without
a vehicle has one of its own.
"""

from __future__ import annotations

import asyncio
import math
import secrets
import socket
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from functools import partial

import structlog

from mavcal.service.errors import LeaseLost, LinkElsewhere, StoreError
from mavcal.service.instances.leases import EVERY_INSTANCE, Leases, Owner
from mavcal.service.jobs.core.book import JobBook
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.link_registry import LinkRegistry, link_id_of
from mavcal.service.settings import Settings
from mavcal.service.store.rows import EventRow, JobRow
from mavcal.service.store.sql import Store
from mavcal.service.vehicle.events import VehicleEvent, VehicleEventKind
from mavcal.service.vehicle.registry import VehicleRegistry

log = structlog.get_logger(__name__)

FILE = "instance"
PERIOD_S = 0.5
"""Largest delay of another instance's event, s; our own events are published at once."""
PAGE = 500
ALIVE = sorted(set(JobState) - ENDED)
ROUNDS_A_LEASE = 4
Taker = Callable[[str], bool]
"""Whether a subject can be leased."""


def vehicle_subject(vehicle_id: str) -> str:
    """Subject of a vehicle's lease."""
    return f"vehicle:{vehicle_id}"


def link_subject(link_id: str) -> str:
    """Subject of a link's lease."""
    return f"link:{link_id}"


def job_subject(job: Job) -> str:
    """Subject whose lease makes a job ours."""
    return f"job:{job.id}" if job.vehicle_id is None else vehicle_subject(job.vehicle_id)


class LeasedJobs:
    """See :class:`service.jobs.core.ports.Ownership`.

    Parameters
    ----------
    leases
        What this instance holds.
    store
        The store of all instances.
    news
        Called from any thread when an event was kept.
    """

    shared = True

    def __init__(self, leases: Leases, store: Store, news: Callable[[], None]) -> None:
        self._leases, self._store = leases, store
        self.changed = news
        self._ending: set[asyncio.Task[None]] = set()

    async def begin(self, job: Job) -> None:
        """See Ownership."""
        subject = job_subject(job)
        if job.vehicle_id is None and not await asyncio.to_thread(self._leases.acquire, subject):
            raise LeaseLost(f"{subject} is owned by another instance")

    def store_of(self, job: Job) -> Store:
        """See Ownership."""
        return self._store.fenced(self._leases.fence(job_subject(job)))

    def ended(self, job: Job) -> None:
        """See Ownership: a job without a vehicle needs no lease once all of it is stored."""
        if job.vehicle_id is None and job.state in ENDED:
            task = asyncio.get_running_loop().create_task(self._give_back(job_subject(job)))
            self._ending.add(task)
            task.add_done_callback(self._ending.discard)

    def doubted(self, vehicle_id: str) -> str | None:
        """Why a vehicle may not be written to by this instance now; None: it may."""
        if self._leases.holds(vehicle_subject(vehicle_id)):
            return None
        return "another instance of the service owns this vehicle, or this one could not renew its lease"

    async def _give_back(self, subject: str) -> None:
        with suppress(StoreError, RuntimeError):  # the service is stopping, or the database is away: it then runs out
            await self._store.do(lambda: self._leases.release(subject))


class Instance:
    """One instance, which holds leases until it is closed.

    Raises
    ------
    StoreError
        If the database cannot be reached or used.
    """

    def __init__(self, settings: Settings, store: Store) -> None:
        assert settings.database_url is not None
        self._settings, self._store = settings, store
        url = settings.database_url.get_secret_value()
        self._leases = Leases(url, owner_of(settings), settings.fleet.lease_s)
        self._follower = Follower(store)
        self.jobs = LeasedJobs(self._leases, store, self._follower.news)
        """See :class:`service.jobs.core.ports.Ownership`."""
        self.links = LeasedLinks(self._leases)
        """See :class:`service.link_registry.LinkOwnership`."""

    @asynccontextmanager
    async def taking_part(
        self, engine: JobEngine, links: LinkRegistry, vehicles: VehicleRegistry
    ) -> AsyncIterator[None]:
        """Take over links and vehicles, and follow events of other instances, inside the block."""
        membership = Membership(self._leases, self._store, engine, links, vehicles, named=self._settings.connect)
        await membership.round()
        tasks = [asyncio.create_task(membership.run()), asyncio.create_task(self._follower.run(engine.book))]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def close(self) -> None:
        """Give every lease back, so that others take over at once."""
        with suppress(StoreError):
            for subject in self._leases.mine(""):
                self._leases.release(subject)
        self._leases.close()


class LeasedLinks:
    """See :class:`service.link_registry.LinkOwnership`."""

    def __init__(self, leases: Leases) -> None:
        self._leases = leases

    async def claim(self, link_id: str) -> None:
        """See LinkOwnership."""
        subject = link_subject(link_id)
        if not await asyncio.to_thread(self._leases.acquire, subject):
            owner = (await asyncio.to_thread(self._leases.owners)).get(subject)
            raise LinkElsewhere(f"link {link_id} is open at {owner or 'another instance'}: ask that one")

    async def release(self, link_id: str) -> None:
        """See LinkOwnership."""
        await asyncio.to_thread(self._leases.release, link_subject(link_id))


def owner_of(settings: Settings) -> Owner:
    """The owner of this data directory, which no other process has; its earlier leases are taken back at once."""
    path = settings.data_dir / FILE
    known = path.read_text(encoding="ascii").strip() if path.is_file() else ""
    if not known:
        known = secrets.token_hex(8)
        path.write_text(f"{known}\n", encoding="ascii")
    return Owner(known, settings.fleet.name or f"{socket.gethostname()}:{settings.port}", settings.fleet.url)


class Follower:
    """Reads on after the newest event that was known at the start."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._after = store.last_event_id()
        self._loop = asyncio.get_running_loop()
        self._news = asyncio.Event()

    def news(self) -> None:
        """Notify that there is an event to read; callable from any thread."""
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._news.set)

    async def run(self, book: JobBook) -> None:
        """Publish every event to the book, until cancelled."""
        while True:
            self._news.clear()
            try:
                while await self._page(book):
                    pass
            except StoreError as error:
                log.warning("events were not read", reason=str(error))
            with suppress(TimeoutError):  # no wait_for: Python 3.11 loses a cancellation that comes with the news
                async with asyncio.timeout(PERIOD_S):
                    await self._news.wait()

    async def _page(self, book: JobBook) -> bool:
        def read() -> tuple[tuple[EventRow, ...], dict[str, JobRow | None]]:
            events = self._store.events(after=self._after, limit=PAGE)
            return events, {event.job_id: self._store.job(event.job_id) for event in events if book.needs_row(event)}

        events, rows = await self._store.do(read)
        for event in events:
            self._after = event.id
            book.publish(event, rows.get(event.job_id))
        return len(events) == PAGE


class Membership:
    """Renews and takes over leases of one instance, round by round.

    Parameters
    ----------
    leases, store
        Those of the database.
    engine, links, vehicles
        What this instance works with.
    named
        Endpoints that the settings name: they are opened by the instances that name them, one at a time.
    """

    def __init__(
        self,
        leases: Leases,
        store: Store,
        engine: JobEngine,
        links: LinkRegistry,
        vehicles: VehicleRegistry,
        *,
        named: Sequence[str],
    ) -> None:
        self._leases, self._store, self._engine = leases, store, engine
        self._links, self._vehicles = links, vehicles
        self._named = {link_id_of(url): url for url in named}
        self._self = f"{EVERY_INSTANCE}{leases.owner.id}"
        self._wake = asyncio.Event()
        self._missed: dict[str, int] = {}
        """Number of rounds in which a vehicle of ours was missing, by subject."""

    async def run(self) -> None:
        """Make rounds until cancelled."""
        forget = self._vehicles.subscribe(self._hear)
        try:
            while True:
                self._wake.clear()
                try:
                    await self.round()
                except StoreError as error:  # leases run out meanwhile, and with them what may be written
                    log.warning("leases were not renewed", reason=str(error))
                except Exception:  # of any kind: without rounds every lease would be lost; logged with its trace
                    log.exception("a round broke")
                with suppress(TimeoutError):  # no wait_for: Python 3.11 loses a cancellation that comes with the wake
                    async with asyncio.timeout(self._leases.lease_s / ROUNDS_A_LEASE):
                        await self._wake.wait()
        finally:
            forget()

    async def round(self) -> None:
        """Renew leases, give up lost ones, take over free subjects. Raises StoreError."""
        for subject in await asyncio.to_thread(self._leases.renew):
            await self._lost(subject)
        if self._self not in self._leases.mine(EVERY_INSTANCE):
            await asyncio.to_thread(self._leases.acquire, self._self)
        owners = await asyncio.to_thread(self._leases.owners)
        self._leave_vehicles_that_went()
        await self._take_links(owners)
        free = partial(self._free, owners)
        await self._take_vehicles(free)
        await self._take_jobs(free)

    def _hear(self, event: VehicleEvent) -> None:
        if event.kind is VehicleEventKind.IDENTIFIED:
            self._wake.set()

    def _free(self, owners: Mapping[str, Owner], subject: str) -> bool:
        """Whether a subject can be leased: it is neither held here nor owned by another instance."""
        owner = owners.get(subject)
        return subject not in self._leases.mine("") and (owner is None or owner.id == self._leases.owner.id)

    # --- giving up

    async def _lost(self, subject: str) -> None:
        kind, _, name = subject.partition(":")
        log.error("a lease was lost to another instance", subject=subject)
        if kind == "link":
            await self._links.leave(name)
        else:
            self._engine.give_up(lambda job: job_subject(job) == subject)

    def _leave_vehicles_that_went(self) -> None:
        """Release vehicles that were not heard here for a whole lease, for instances that hear them."""
        heard = {vehicle_subject(vehicle.id) for vehicle in self._vehicles.all()}
        for subject in self._leases.mine("vehicle:"):
            missed = self._missed[subject] = 0 if subject in heard else self._missed.get(subject, 0) + 1
            if missed > ROUNDS_A_LEASE:
                del self._missed[subject]
                self._engine.give_up(lambda job: job_subject(job) == subject)  # noqa: B023 - called here
                self._store.soon(partial(self._leases.release, subject))

    # --- taking over

    async def _take_links(self, owners: Mapping[str, Owner]) -> None:
        """Open links that no instance has open, in each round only our share of them."""
        urls = {row.id: row.url for row in await self._store.do(self._store.links)} | self._named
        opened = {link.id for link in self._links.all()}
        free = [i for i in urls if i not in opened and self._free(owners, link_subject(i))]
        instances = sum(subject.startswith(EVERY_INSTANCE) for subject in owners)
        for link_id in free[: math.ceil(len(free) / max(instances, 1))]:
            named = link_id in self._named
            try:
                await self._links.open(urls[link_id], remember=not named, trusted=named)
            except Exception as error:  # noqa: BLE001 - one that cannot be used must not keep the others closed
                log.warning("link not opened", url=urls[link_id], reason=str(error))

    async def _take_vehicles(self, free: Taker) -> None:
        for vehicle in self._vehicles.all():
            subject = vehicle_subject(vehicle.id)
            if vehicle.identity.known and free(subject) and await asyncio.to_thread(self._leases.acquire, subject):
                rows = await self._store.do(partial(self._store.jobs, vehicle_id=vehicle.id))
                log.info("vehicle owned", vehicle=vehicle.id, jobs=len(rows))
                self._engine.take_over(rows)

    async def _take_jobs(self, free: Taker) -> None:
        """Take over jobs without a vehicle whose instance has left."""
        for row in await self._store.do(partial(self._store.jobs, states=ALIVE)):
            subject = f"job:{row.id}"
            if row.vehicle_id is not None or not free(subject):
                continue
            if await asyncio.to_thread(self._leases.acquire, subject):
                now = await self._store.do(partial(self._store.job, row.id))
                if now is not None and now.state in ALIVE:
                    log.info("job taken over", job=now.id)
                    self._engine.take_over([now])
                else:  # it ended between the two looks
                    await asyncio.to_thread(self._leases.release, subject)
