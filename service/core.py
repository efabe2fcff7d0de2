"""The parts of a running service, put together in one place.

A link may not be closed while a write needs it (DESIGN 6, rule 2).
"""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import structlog

from mavcal.service.campaigns.begin import CampaignDesk, running_campaigns
from mavcal.service.campaigns.campaigns import CAMPAIGN, uploads_of_campaign
from mavcal.service.children import Children, Limits
from mavcal.service.computations import UploadComputations
from mavcal.service.errors import LinkBusy, VehicleUnknown
from mavcal.service.fleet.ahead import TrendsAhead
from mavcal.service.fleet.book import FleetBook
from mavcal.service.heap import trim_for_ever
from mavcal.service.jobs.core.admission import WAY
from mavcal.service.jobs.core.codec import CODE as UNREADABLE
from mavcal.service.jobs.core.crashpoints import CrashPoint, no_crash
from mavcal.service.jobs.core.model import Failure, Job
from mavcal.service.jobs.core.settings import JobSettings
from mavcal.service.jobs.core.states import WRITING, JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.jobs.uploads import uploads_of
from mavcal.service.link.allowed import Allowed
from mavcal.service.link.link import Link
from mavcal.service.link_registry import LinkRegistry
from mavcal.service.rates.ledger import RateLedgers
from mavcal.service.rates.owed import OwedRates
from mavcal.service.rates.watching import LiveRates
from mavcal.service.recordings import Recordings
from mavcal.service.retention import Retention, Rotation
from mavcal.service.settings import Settings
from mavcal.service.signing import SigningAdmin
from mavcal.service.signing_keys import SigningKeys
from mavcal.service.simulated_hands import SimulatedHands
from mavcal.service.store import Store
from mavcal.service.storing import open_store
from mavcal.service.unfinished import Unfinished, left_over
from mavcal.service.vehicle.job_vehicle import VehicleSource
from mavcal.service.vehicle.registry import VehicleRegistry

if TYPE_CHECKING:
    from mavcal.service.instances.instance import Instance
    from mavcal.service.workers.remote import RemoteChildren


log = structlog.get_logger(__name__)

SPREAD = JobSettings(fits_at_once=64, diagnoses_at_once=16)
"""Settings of jobs where workers compute, since only workers then limit the load."""

LEAST_FREE_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Service:
    """The parts of a service for routes and commands."""

    settings: Settings
    store: Store
    links: LinkRegistry
    vehicles: VehicleRegistry
    jobs: JobEngine
    recordings: Recordings
    children: Children
    fleet: FleetBook
    campaigns: CampaignDesk
    signing: SigningAdmin
    live: LiveRates
    hands: SimulatedHands
    left: tuple[Unfinished, ...] = ()
    """Unfinished jobs of earlier runs, as they were before any link was open."""

    def obstacle(self) -> str | None:
        """Obstacle to running jobs now; None: nothing stands in the way."""
        free = shutil.disk_usage(self.settings.data_dir).free
        if free < LEAST_FREE_BYTES:
            return f"only {free // 2**20} MiB are free for recordings: free some space"
        return self.store.obstacle()

    async def close_link(self, link_id: str) -> None:
        """Close a link for good.

        Raises
        ------
        LinkUnknown
            If there is none of that id.
        LinkBusy
            If a write needs it.
        """
        require_unneeded(self.links.get(link_id), self.vehicles, self.jobs.list())
        await self.links.close(link_id)


@asynccontextmanager
async def running_service(
    settings: Settings, *, reach: CrashPoint = no_crash, attended: bool = False
) -> AsyncIterator[Service]:
    """A service from its data directory to its last closed link; `reach` is the engine's (tests).

    Raises
    ------
    DataDirLocked
        If another process owns the data directory.
    EndpointError, PortBusy
        If an endpoint of the settings can never work as it is.
    """
    store = open_store(settings)
    executor = ThreadPoolExecutor(max_workers=2, thread_name_prefix="fit")  # of live jobs alone
    vehicles = VehicleRegistry(yield_s=settings.mavlink.yield_s)
    tlogs = settings.data_dir / "tlogs"
    allowed = Allowed(settings.links.allowed, (tlogs, *settings.links.folders))
    instance = _instance(settings, store)
    keys = SigningKeys(settings.data_dir, settings.mavlink)
    links = LinkRegistry(
        store,
        tlogs,
        settings.mavlink,
        keys=keys,
        allowed=allowed,
        attach=vehicles.attach,
        detach=vehicles.detach,
        ownership=None if instance is None else instance.links,
    )
    signing = SigningAdmin(keys, links, vehicles, store, read_only=settings.read_only)
    folder, limits = settings.data_dir, settings.limits
    children = Children(folder / "children", most=limits.file_processes)
    of_files = Limits(limits.file_memory_bytes, limits.file_cpu_s, limits.file_wall_s)
    of_gaps = Limits(limits.file_memory_bytes, limits.gap_s, limits.gap_s)
    recordings = Recordings(
        store, settings.uploads, limit_bytes=limits.upload_bytes, children=children, limits=of_files
    )
    workers = None if settings.database_url is None else _workers(settings)
    computations = UploadComputations(recordings, workers or children, of_files, of_gaps)
    fleet = FleetBook(store, vehicles)
    doubted = (lambda _: None) if instance is None else instance.jobs.doubted
    ledgers = RateLedgers(VehicleSource(vehicles, doubted), OwedRates(settings.data_dir / "live-rates.json"))
    live = LiveRates(ledgers, read_only=settings.read_only)
    hands = SimulatedHands(vehicles.all, lambda: jobs.list())
    source = VehicleSource(vehicles, doubted, live.release)
    jobs = JobEngine(
        store,
        source,
        computations,
        ownership=None if instance is None else instance.jobs,
        settings=JobSettings() if workers is None else SPREAD,
        executor=executor,
        read_only=settings.read_only,
        reach=reach,
        record=fleet,
        ledgers=ledgers,
    )
    running = running_campaigns(jobs, source, computations)
    campaigns = CampaignDesk(running, computations, settings.read_only, attended)
    async with AsyncExitStack() as started:
        # Interrupted writes first, so that nothing later can prevent their completion or rollback.
        started.callback(store.close)
        if instance is not None:
            started.callback(instance.close)
        started.callback(executor.shutdown, wait=False, cancel_futures=True)
        started.callback(vehicles.close)
        started.push_async_callback(links.close_all)
        started.callback(recordings.close)
        started.push_async_callback(children.stop)
        if workers is not None:
            await workers.start()
            started.push_async_callback(workers.stop)
        started.push_async_callback(jobs.stop)
        await jobs.start()
        left = left_over(store, jobs.list())
        live.start(jobs.claim)
        started.push_async_callback(live.stop)
        await fleet.take_up(jobs.list())
        started.callback(fleet.close)
        if instance is None:
            await _open_links(links, settings, store)
        else:
            await started.enter_async_context(instance.taking_part(jobs, links, vehicles))
        retention = _retention(store, settings, jobs, links)
        rotation = Rotation(links.all, settings.retention, retention.sweep_now.set)
        ahead = TrendsAhead(store, lambda: fleet.measured)
        for work in (retention.run(), rotation.run(), trim_for_ever(), ahead.run(), hands.run()):
            started.push_async_callback(_cancelled, asyncio.create_task(work))
        parts = (store, links, vehicles, jobs, recordings, children, fleet, campaigns, signing, live, hands)
        yield Service(settings, *parts, left=left)


def _instance(settings: Settings, store: Store) -> Instance | None:
    """The instance of this process, if the settings name a shared database."""
    if settings.database_url is None:
        return None
    from mavcal.service.instances.instance import Instance

    try:
        return Instance(settings, store)
    except BaseException:
        store.close()
        raise


def _workers(settings: Settings) -> RemoteChildren:
    from mavcal.service.workers.remote import RemoteChildren

    assert settings.database_url is not None
    return RemoteChildren(settings.database_url.get_secret_value(), settings.uploads, settings.fleet.lease_s)


def _retention(store: Store, settings: Settings, jobs: JobEngine, links: LinkRegistry) -> Retention:
    def needed() -> set[str]:
        """Uploads that a plan or a diagnosis rests on, or that a fit still needs."""
        if any(isinstance(job.outcome, Failure) and job.outcome.code == UNREADABLE for job in jobs.list()):
            return {row.id for row in store.recordings()}  # nobody knows what a damaged job rests on
        of_campaigns = (uploads_of_campaign(job, store) for job in jobs.list() if job.kind == CAMPAIGN)
        return {upload for job in jobs.list() for upload in uploads_of(job)}.union(*of_campaigns)

    def open_files() -> set[Path]:
        return {link.tlog.path for link in links.all()}

    return Retention(store, settings.retention, settings.data_dir / "tlogs", needed, open_files)


async def _cancelled(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def _open_links(links: LinkRegistry, settings: Settings, store: Store) -> None:
    """Open the links of the settings, which must work, and links open before, which may be gone."""
    for url in settings.connect:
        await links.open(url, remember=False, trusted=True)
    for row in store.links():
        try:
            await links.open(row.url)
        except Exception as error:  # noqa: BLE001 - a row that cannot be used must not stop the start
            log.warning("link not opened again", url=row.url, reason=str(error))


def require_unneeded(link: Link, vehicles: VehicleRegistry, jobs: Iterable[Job]) -> None:
    """Raise LinkBusy if a write runs over this link, or is in doubt, and no other link leads to that vehicle."""
    for job in jobs:
        if job.state in WRITING and job.vehicle_id is not None and _needed(link, vehicles, job):
            raise LinkBusy(_refusal(link, job))


def _needed(link: Link, vehicles: VehicleRegistry, job: Job) -> bool:
    try:
        vehicle = vehicles.get(job.vehicle_id or "")
    except VehicleUnknown:  # not heard since a restart: it was spoken to over this link last
        return job.context.get(WAY) == link.id
    carrying = [channel.link for channel in vehicle.channels.alive]
    return link in vehicle.links and not any(other is not link for other in carrying)


def _refusal(link: Link, job: Job) -> str:
    stands = f"job {job.id} ({job.kind}) is {job.state.value.replace('_', ' ')} on vehicle {job.vehicle_id}"
    if job.state is JobState.IN_DOUBT:
        return (
            f"{stands}, which is heard on no other link than {link.id}: keep it disarmed and in reach until the write "
            "is finished or taken back, or open another link to it first"
        )
    return f"{stands} over link {link.id}: wait for its end, or open another link to the vehicle first"
