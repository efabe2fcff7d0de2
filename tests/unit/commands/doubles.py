"""Stand-ins for what the commands ask: a screen that keeps its lines, and jobs that change as a script says."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

from mavcal.client.enums import Autopilot
from mavcal.client.jobs import JobModel, PlanModel
from mavcal.client.models import UnfinishedModel
from mavcal.client.requests import PlanOptions
from mavcal.service.api.views import job_model, unfinished_model
from mavcal.service.commands.screen import Screen
from mavcal.service.errors import JobUnknown, VehicleUnknown
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import JobRow
from mavcal.service.unfinished import Unfinished, left_over, unfinished


class KeptScreen(Screen):
    """Keeps every line instead of showing it; prompts are lines too, and progress is kept apart."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []
        self.shares: list[float] = []

    def line(self, text: str = "", *, bold: bool = False) -> None:
        """See Screen."""
        self.lines.append(text)

    def progress(self, progress: Mapping[str, Any]) -> None:
        """See Screen."""
        self.shares.append(progress["current"] / progress["target"])


def plain(job_id: str, state: JobState, **more: Any) -> Job:
    """A job without results; of vehicle v1 where nothing else is said."""
    return Job(**{"id": job_id, "vehicle_id": "v1", "kind": "gyro", "options": {}, "state": state,
                  "created_at": 0.0, "updated_at": 0.0, **more})  # fmt: skip


def of_service(job: Job) -> JobModel:
    """The job as the client of a running service gets it."""
    return JobModel.model_validate(job_model(job).model_dump(mode="json"))


@dataclass
class FakeVehicle:
    """What the commands look at of a vehicle; it may be written to after `refusals` looks."""

    id: str = "v1"
    link: str = ""
    refusals: int = 0
    autopilot: Autopilot = Autopilot.PX4
    firmware: str = "1.17.0"
    system: int = 1

    @property
    def links(self) -> list[str]:
        """See VehicleModel."""
        return [self.link] if self.link else []

    @property
    def writable(self) -> bool:
        """See VehicleModel."""
        self.refusals -= 1
        return self.refusals < 0


STEP_S = 1000.0
"""Between two steps, by the clock of the service; far more than a busy machine takes for all of them."""
PATIENCE_S = 1.0
"""How long a command may wait for another event of a job, once the script is over."""

Step = tuple[Job, str, Mapping[str, Any]]
"""A job as it is when an event of it is heard, and that event."""


@dataclass
class ScriptedJobs:
    """The jobs of a service; `steps` happen to whoever subscribes, and `done` lists what was asked of them."""

    jobs: dict[str, Job] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)
    done: list[tuple[Any, ...]] = field(default_factory=list)
    refusal: Exception | None = None
    """Raised by the next request."""
    planned: Job | None = None
    """What planning again makes of a job."""

    def get(self, job_id: str) -> Job:
        """See JobEngine."""
        if job_id not in self.jobs:
            raise JobUnknown(f"there is no job {job_id}")
        return self.jobs[job_id]

    def list(self) -> list[Job]:
        """See JobEngine."""
        return list(self.jobs.values())

    async def events(self, job_id: str) -> AsyncIterator[Any]:
        """What a client is told of one job from now on; a step without a kind lets the loop run.

        Whoever waits for more than the steps fails, instead of waiting as long as a person would.
        """
        number = 0
        for number, (job, kind, data) in enumerate(self.steps, 1):
            self.jobs[job.id] = job
            if kind and job.id == job_id:
                told = SimpleNamespace(model_dump=lambda mode, data=data: dict(data))
                yield SimpleNamespace(data=SimpleNamespace(kind=kind, at=time.time() + number * STEP_S, data=told))
            for _ in range(5):
                await asyncio.sleep(0)
        self.steps = []
        await asyncio.sleep(PATIENCE_S)
        raise AssertionError(f"job {job_id} is followed beyond its {number} steps")

    def ask(self, *what: Any) -> None:
        """Note a request, or refuse it."""
        if self.refusal is not None:
            refusal, self.refusal = self.refusal, None
            raise refusal
        self.done.append(what)


@dataclass(eq=False)
class FakeLink:
    """A link that leads nowhere."""

    url: str
    reason: str = ""
    vehicles: list[str] = field(default_factory=list)

    @property
    def id(self) -> str:
        """See LinkModel."""
        return self.url


class FakeService:
    """As much of a service as the commands take, on a store in memory: its client, and the door to it."""

    def __init__(self, *jobs: Job, shared: bool = False) -> None:
        self.shared = shared
        self.jobs: Any = ScriptedJobs({job.id: job for job in jobs})
        self.links: dict[str, FakeLink] = {}
        self.opened: list[str] = []
        self.vehicles: dict[str, FakeVehicle] = {}
        self.store: Any = SqliteStore(None)
        for job in jobs:
            self.store.save_job(JobRow(job.id, job.vehicle_id, job.kind, job.state.value, 0.0, 0.0, {}))

    @property
    def client(self) -> Any:
        """See Door."""
        return self

    def joined(self, url: str, *ids: str) -> FakeLink:
        """A link with vehicles of these ids on it."""
        link = self.links.setdefault(url, FakeLink(url))
        link.vehicles += ids
        self.vehicles |= {each: FakeVehicle(each, url) for each in ids}
        return link

    async def open(self, url: str) -> str:
        """See Door; a link has its address as its id here."""
        self.opened.append(url)
        self.links.setdefault(url, FakeLink(url))
        return url

    async def wait_for_cleanup(self, _seconds: float = 0.0, *, written: str | None = None) -> None:
        """See Door."""
        self.jobs.ask("wait_for_cleanup")

    async def list_links(self) -> list[FakeLink]:
        """See AsyncClient."""
        return list(self.links.values())

    async def get_link(self, link_id: str) -> FakeLink:
        """See AsyncClient."""
        return self.links[link_id]

    async def list_vehicles(self) -> list[FakeVehicle]:
        """See AsyncClient."""
        return list(self.vehicles.values())

    async def get_vehicle(self, vehicle_id: str) -> FakeVehicle:
        """See AsyncClient."""
        if vehicle_id not in self.vehicles:
            raise VehicleUnknown(f"there is no vehicle {vehicle_id}")
        return self.vehicles[vehicle_id]

    async def get_job(self, job_id: str) -> JobModel:
        """See AsyncClient."""
        return of_service(self.jobs.get(job_id))

    async def list_jobs(self, *, limit: int, after: str | None, **wanted: Any) -> list[JobModel]:
        """See AsyncClient; everything is on the first page."""
        assert limit
        found = [of_service(job) for job in self.jobs.list()]
        return [] if after else [job for job in found if all(getattr(job, n) == v for n, v in wanted.items())]

    async def list_unfinished(self) -> list[UnfinishedModel]:
        """See AsyncClient."""
        return [_unfinished_model(found) for found in left_over(self.store, self.jobs.list())]

    async def get_unfinished(self, job_id: str) -> UnfinishedModel:
        """See AsyncClient."""
        return _unfinished_model(unfinished(self.store, self.jobs.get(job_id)))

    def follow_job(self, job_id: str) -> AsyncIterator[Any]:
        """See AsyncClient."""
        return cast("AsyncIterator[Any]", self.jobs.events(job_id))

    async def cancel_job(self, job_id: str) -> None:
        """See AsyncClient."""
        self.jobs.ask("cancel", job_id)
        self._is_now(job_id, JobState.CANCELLED)

    async def answer_job(self, job_id: str, *, value: str) -> None:
        """See AsyncClient."""
        self.jobs.ask("answer", job_id, value)

    async def apply_plan(self, job_id: str, *, plan_sha256: str, **how: Any) -> None:
        """See AsyncClient."""
        self.jobs.ask("apply", job_id, plan_sha256, how)

    async def revert_job(self, job_id: str) -> JobModel:
        """See AsyncClient."""
        self.jobs.ask("revert", job_id)
        return self._is_now(job_id, JobState.REVERTED)

    async def renew_plan(self, job_id: str, *, plan_options: PlanOptions) -> PlanModel | None:
        """See AsyncClient."""
        self.jobs.ask("plan_again", job_id, plan_options.model_dump(exclude_unset=True))
        assert self.jobs.planned is not None
        self.jobs.jobs[job_id] = self.jobs.planned
        return of_service(self.jobs.planned).plan

    def _is_now(self, job_id: str, state: JobState) -> JobModel:
        self.jobs.jobs[job_id] = replace(self.jobs.jobs[job_id], state=state)
        return of_service(self.jobs.jobs[job_id])


def _unfinished_model(found: Unfinished) -> UnfinishedModel:
    return UnfinishedModel.model_validate(unfinished_model(found).model_dump(mode="json"))
