"""One life of the service in a crossed run: it begins or resumes the job, and ends it if no fault strikes."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from bench.campaign.crossed.plan import OPTIONS, Cross, Network, Process, VehicleFault, When
from bench.campaign.judge import Evidence, doubt_complaints
from bench.campaign.session import POLL_S, PROVE_S, Session
from bench.campaign.truth import Holding, holding
from mavcal.service.api.views import job_model
from mavcal.service.errors import ServiceError
from mavcal.service.jobs.model import Accept, Job
from mavcal.service.jobs.states import ENDED, JobState
from mavcal.service.simvehicle import SimulatedVehicle

Json = dict[str, Any]

LOOK_S = 0.3
ARMED_S = 0.7
"""Wall time after which the operator disarms."""
FAULTY_S = 20.0
"""Wall time after which every fault of the wire and of the vehicle is over: each job has to end."""
SAVED_S = 5.0
"""Wall time within which the service has saved what the disk refused, once it takes it again."""
DISK_TROUBLE = frozenset({Process.FULL, Process.DATABASE})
BEGUN = frozenset({JobState.REVIEW}) | frozenset(ENDED)


class DyingPool(ThreadPoolExecutor):
    """Its worker is killed while it has its first work."""

    def __init__(self, *, dies: bool) -> None:
        super().__init__(1)
        self.died = False
        self._dies = dies

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As of an executor whose process has ended."""
        if self._dies and not self.died:
            self.died = True
            broken: Future[Any] = Future()
            broken.set_exception(BrokenProcessPool("a worker of the pool was killed: injected"))
            return broken
        return super().submit(fn, *args, **kwargs)


@dataclass
class Life:
    """What one life sees and does."""

    cross: Cross
    sim: SimulatedVehicle
    bench: Session
    before: Holding
    accepted: bool
    """Whether an earlier life accepted the plan."""
    noted: Callable[[str, Any], None] = lambda _what, _data: None
    """Keeps what a later life has to know."""
    complaints: list[str] = field(default_factory=list)
    foreign: dict[str, float] = field(default_factory=dict)
    doubts: int = 0
    _loose: set[When] = field(default_factory=set)
    _doubted: object = None
    _armed_since: float | None = None
    _mended: int = 0
    _calmed: bool = False

    async def lived(self, job_id: str | None) -> Job:
        """Bring the job to its end."""
        await self._let_loose(When.CAPTURE, None)
        putting_right = asyncio.create_task(self._put_right())
        try:
            job = await (self._begun() if job_id is None else asyncio.to_thread(self.bench.engine.get, job_id))
            while True:
                job = self.bench.engine.get(job.id)
                if job.state == JobState.REVIEW and not self.accepted:
                    await self._accept(job)
                elif job.state in BEGUN:
                    await asyncio.sleep(SAVED_S if self.cross.process in DISK_TROUBLE else 0.0)
                    return self.bench.engine.get(job.id)
                elif job.state in (JobState.VERIFYING, JobState.ROLLING_BACK):
                    await self._let_loose(When.CHECK, job)
                elif job.state == JobState.IN_DOUBT and job.standing is not self._doubted:
                    await self._doubt_judged(job)
                await self.bench.obeyed(job)
                await asyncio.sleep(POLL_S)
                if putting_right.done():
                    putting_right.result()
        finally:
            putting_right.cancel()

    async def _begun(self) -> Job:
        kind = self.cross.job
        while True:
            await self.bench.ready()
            with suppress(ServiceError):  # of a vehicle that is not ready, a disk that is full: asked again
                return await self.bench.engine.submit(self.bench.vehicle.id, kind, OPTIONS[kind], None)
            await asyncio.sleep(LOOK_S)

    async def _accept(self, job: Job) -> None:
        """Accept the plan, as soon as the service takes it."""
        assert job.plan is not None
        await asyncio.to_thread(self.bench.operator.rest)
        await asyncio.to_thread(self.sim.wait, 4.0)
        await self._let_loose(When.WRITE, job)
        accept = Accept(job.plan.sha256, reboot=True, prove_s=PROVE_S)
        while not self.accepted:
            await self.bench.ready()
            try:
                await self.bench.engine.apply(job.id, accept)
            except ServiceError:
                await asyncio.sleep(LOOK_S)
                self.accepted = self.bench.engine.get(job.id).state != JobState.REVIEW
            else:
                self.accepted = True

    # --- faults

    async def _let_loose(self, when: When, job: Job | None) -> None:
        """Switch on the faults of a part of the job; those of a write strike with one of its parameters."""
        if when in self._loose:
            return
        self._loose.add(when)
        faults = [] if self.cross.network_when != when else _of_network(self.cross)
        faults += [] if self.cross.vehicle_when != when else _of_vehicle(self.cross)
        if when == When.WRITE and self.cross.taking_back:
            faults.append({"kind": "not_applied"})
        for fault in faults:
            if when == When.WRITE:
                assert job is not None
                assert job.plan is not None
                fault["trigger"] = {"nth_set": 1 + int(self.cross.share * len(job.plan.changes))}
            if fault["kind"] == "foreign_write":
                self._aim(fault, job)
            await self.sim.acall("fault", **fault)

    def _aim(self, fault: Json, job: Job | None) -> None:
        """A rival writes a parameter of the plan, or one that is nobody's business while there is no plan."""
        name, value = ("RTL_ALT", 1250.0) if self.cross.autopilot == "ardupilot" else ("MPC_THR_HOVER", 0.25)
        if job is not None and job.plan is not None:
            floats = [c for c in job.plan.changes if c.kind == "real32" and c.sd is not None]
            if floats:
                target = floats[int(self.cross.share * len(floats))]
                name, value = target.name, float(target.new) * 0.5 + 0.0123
        fault |= {"name": name, "value": value}
        self.foreign[name] = value
        self.noted("foreign", {name: value})

    async def _put_right(self) -> None:
        """What the operator and the network do by and by: disarm, mend the link."""
        loop = asyncio.get_running_loop()
        begun = loop.time()
        while True:
            await asyncio.sleep(LOOK_S)
            state = await self.sim.acall("state")
            self._armed_since = (self._armed_since or loop.time()) if state["armed"] else None
            if self._armed_since is not None and loop.time() - self._armed_since > ARMED_S:
                self._check_armed(state)
                await self.sim.acall("disarm")
            cut = [f for f in state["faults"] if f["kind"] == "loss" and f.get("p") == 1.0 and f["struck"]]
            over = len(cut) > self._mended and state["elapsed"] - cut[-1]["struck"][0] > cut[-1]["duration_s"]
            late = not self._calmed and self.accepted and loop.time() - begun > FAULTY_S
            if over or late:
                self._mended, self._calmed = len(cut), self._calmed or late
                await self.sim.acall("clear_faults")

    def _check_armed(self, state: Json) -> None:
        """Nothing is sent to an armed vehicle."""
        arming = [t for fault in state["faults"] if fault["kind"] == "arm" for t in fault["struck"]]
        late = [s for s in state["param_set_list"] if arming and s[0] > max(arming) + ARMED_S * self.cross.speed]
        if late:
            self.complaints.append(f"{len(late)} PARAM_SETs reached the vehicle long after it was armed")

    async def _doubt_judged(self, job: Job) -> None:
        """Compare the list of a job in doubt with the vehicle, unless the job goes on meanwhile."""
        now = await asyncio.to_thread(holding, self.sim)
        if self.bench.engine.get(job.id) is not job:
            return
        self._doubted = job.standing
        self.doubts += 1
        seen = Evidence(job_model(job).model_dump(mode="json"), self.before, now, self.foreign)
        self.complaints += doubt_complaints(seen)


def _of_network(cross: Cross) -> list[Json]:
    draw = random.Random(f"network {cross.seed} {cross.index}")
    p = {"p": draw.uniform(0.03, 0.15), "direction": draw.choice(("both", "in", "out"))}
    match cross.network:
        case Network.LOSS:
            return [{"kind": "loss", **p}]
        case Network.REORDER:
            return [{"kind": "reordering", **p}]
        case Network.DUPLICATION:
            return [{"kind": "duplication", **p}]
        case Network.CORRUPTION:
            return [{"kind": draw.choice(("bit_errors", "truncation")), **p}]
        case Network.PARTITION:
            return [{"kind": "loss", "p": 1.0, "duration_s": draw.uniform(0.5, 6.0) * cross.speed}]
        case Network.RECONNECT:
            return [{"kind": "disconnect"}]
        case Network.ADDRESS:
            return [{"kind": "move"}]
    return []


def _of_vehicle(cross: Cross) -> list[Json]:
    draw = random.Random(f"vehicle {cross.seed} {cross.index}")
    match cross.vehicle:
        case VehicleFault.REBOOT:
            return [{"kind": "reboot", "flush": draw.random() < 0.5}]
        case VehicleFault.ARM:
            return [{"kind": "arm"}]
        case VehicleFault.SILENCE:
            return [{"kind": "silence", "duration_s": draw.uniform(1.0, 6.0) * cross.speed}]
        case VehicleFault.LOST_ECHO:
            return [{"kind": "lost_echo", "count": draw.randint(1, 4)}]
        case VehicleFault.LATE_ECHO:
            return [{"kind": "late_echo", "count": draw.randint(1, 4), "delay_s": draw.uniform(1.0, 40.0)}]
        case VehicleFault.RIVAL:
            return [{"kind": "foreign_write"}]
        case VehicleFault.CALIBRATION:
            return [{"kind": "onboard_calibration", "duration_s": draw.uniform(0.5, 3.0) * cross.speed}]
    return []


def dies(cross: Cross) -> bool:
    """Whether a worker is killed."""
    return cross.process == Process.WORKER
