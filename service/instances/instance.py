"""One instance among others: which one it is, and its parts put together."""

from __future__ import annotations

import asyncio
import secrets
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from mavcal.service.errors import LinkElsewhere, StoreError
from mavcal.service.instances.follow import Follower
from mavcal.service.instances.leases import Leases, Owner
from mavcal.service.instances.membership import Membership
from mavcal.service.instances.ownership import LeasedJobs, link_subject
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.link_registry import LinkRegistry
from mavcal.service.settings import Settings
from mavcal.service.store.sql import Store
from mavcal.service.vehicle import VehicleRegistry

FILE = "instance"


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
        """Give every lease back: others take over at once."""
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
