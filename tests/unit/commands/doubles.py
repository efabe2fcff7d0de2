"""Stand-ins for what the commands ask: a screen that keeps its lines, and jobs that change as a script says."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

from mavcal.calib.recording import Identity
from mavcal.client.jobs import JobModel
from mavcal.service.api.views import job_model
from mavcal.service.commands.screen import Screen
from mavcal.service.errors import JobUnknown, VehicleUnknown
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.link_registry import link_id_of
from mavcal.service.store import SqliteStore
from mavcal.service.store.rows import EventRow, JobRow


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
    """What the commands look at; it may be written to after `refusals` looks."""

    id: str = "v1"
    link: Any = None
    refusals: int = 0
    identity: Any = field(
        default_factory=lambda: SimpleNamespace(
            **vars(Identity("px4", 2, (1, 17, 0), "00ab", 1, 1)), version_text="1.17.0", known=True
        )
    )

    @property
    def links(self) -> tuple[Any, ...]:
        """See Vehicle."""
        return () if self.link is None else (self.link,)

    def writable(self) -> Any:
        """See Vehicle."""
        self.refusals -= 1
        return SimpleNamespace(ok=self.refusals < 0)


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

    async def subscribe(self, _job: str | None, after: int) -> AsyncIterator[EventRow]:
        """See JobEngine; a step without a kind lets the loop run."""
        for number, (job, kind, data) in enumerate(self.steps, after + 1):
            self.jobs[job.id] = job
            if kind:
                yield EventRow(number, job.id, number, 0.0, kind, data)
            else:
                for _ in range(5):
                    await asyncio.sleep(0)
        self.steps = []
        await asyncio.Event().wait()

    def _asked(self, *what: Any) -> None:
        if self.refusal is not None:
            refusal, self.refusal = self.refusal, None
            raise refusal
        self.done.append(what)

    async def cancel(self, job_id: str) -> None:
        """See JobEngine."""
        self._asked("cancel", job_id)
        self.jobs[job_id] = replace(self.jobs[job_id], state=JobState.CANCELLED)

    async def answer(self, job_id: str, value: str) -> None:
        """See JobEngine."""
        self._asked("answer", job_id, value)

    async def apply(self, job_id: str, accept: Accept, *, look: bool = False) -> None:
        """See JobEngine."""
        self._asked("apply", job_id, accept, look)

    async def revert(self, job_id: str) -> Job:
        """See JobEngine."""
        self._asked("revert", job_id)
        self.jobs[job_id] = replace(self.jobs[job_id], state=JobState.REVERTED)
        return self.jobs[job_id]

    async def plan_again(self, job_id: str, options: Mapping[str, Any]) -> Job:
        """See JobEngine."""
        self._asked("plan_again", job_id, dict(options))
        assert self.planned is not None
        self.jobs[job_id] = self.planned
        return self.planned

    async def tidied(self) -> None:
        """See JobEngine."""
        self._asked("tidied")


@dataclass(eq=False)
class FakeLink:
    """A link that leads nowhere."""

    endpoint: str
    reason: str = ""


@dataclass
class FakeLinks:
    """Links by address; opening one is noted."""

    known: dict[str, Any] = field(default_factory=dict)
    opened: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    async def open(self, url: str, **how: Any) -> Any:
        """See LinkRegistry."""
        self.opened.append((url, how))
        return self.known.setdefault(url, FakeLink(url))

    def all(self) -> list[Any]:
        """See LinkRegistry."""
        return list(self.known.values())

    def get(self, link_id: str) -> Any:
        """See LinkRegistry."""
        return next(link for url, link in self.known.items() if link_id_of(url) == link_id)


@dataclass
class FakeVehicles:
    """Vehicles by id; one is heard on a link if it is one of that link's."""

    there: dict[str, FakeVehicle] = field(default_factory=dict)

    def get(self, vehicle_id: str) -> FakeVehicle:
        """See VehicleRegistry."""
        if vehicle_id not in self.there:
            raise VehicleUnknown(f"there is no vehicle {vehicle_id}")
        return self.there[vehicle_id]

    def all(self) -> list[FakeVehicle]:
        """See VehicleRegistry."""
        return list(self.there.values())

    async def wait_for_vehicle(self, link: Any) -> FakeVehicle:
        """See VehicleRegistry."""
        for vehicle in self.there.values():
            if vehicle.link is link:
                return vehicle
        await asyncio.Event().wait()
        raise AssertionError


class FakeService:
    """As much of a service as the commands take, on a store in memory."""

    def __init__(self, *jobs: Job, connect: tuple[str, ...] = ("tcp:v:1",)) -> None:
        self.jobs: Any = ScriptedJobs({job.id: job for job in jobs})
        self.links: Any = FakeLinks()
        self.vehicles: Any = FakeVehicles()
        self.settings: Any = SimpleNamespace(connect=connect)
        self.store: Any = SqliteStore(None)
        for job in jobs:
            self.store.save_job(JobRow(job.id, job.vehicle_id, job.kind, job.state.value, 0.0, 0.0, {}))

    def joined(self, url: str, *ids: str) -> FakeLink:
        """A link with vehicles of these ids on it."""
        link = FakeLink(url)
        self.links.known[url] = link
        self.vehicles.there |= {each: FakeVehicle(each, link) for each in ids}
        return link
