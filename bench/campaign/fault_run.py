"""One fault run: a vehicle in its own process, the engine in this one, a job, a write, and what strikes it."""

from __future__ import annotations

import asyncio
import math
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.campaign.judge import Ending, Evidence, OwnWrite, Stop, doubt_complaints, held_back, judge, stop_complaints
from bench.campaign.report import FaultReport, Pinned
from bench.campaign.scenario import (
    LINK_DELETED,
    LINK_DIES,
    LINKS,
    OPTIONS,
    SECOND_LINK,
    STOPPING,
    WIRE,
    Phase,
    Scenario,
    Strike,
)
from bench.campaign.session import POLL_S, Session, session
from bench.campaign.truth import Holding, holding, residuals
from mavcal.service.api.views import job_model
from mavcal.service.errors import LinkBusy, PlanChanged, ServiceError
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import WRITING, JobState
from mavcal.service.simvehicle import SimulatedVehicle

Json = dict[str, Any]

RUN_S = 170.0
"""No run takes longer: a job that never ends is a failure."""
TRACKED_S = 0.5
"""Wall time after arming in which a PARAM_SET may still arrive that had left before."""
VISIBLE_S = {"arm": 0.5, "reboot": 2.0, "silence": 3.5, "onboard_calibration": 1.5, "move": 1.0, "twin": 5.0}
"""Wall time after which the service has to know of a stopping fault, over what its link takes."""
JOINED_S = 30.0
"""Wall time within which the same vehicle on one more link is recognised."""
NOTED_S = 10.0
"""Wall time within which a run has heard of its job's last state."""
ENDED = (JobState.SUCCEEDED, JobState.REVERTED, JobState.REVIEW)


def run_fault(scenario: Scenario) -> FaultReport:
    """Carry out one run; never raises: what goes wrong is a complaint of the report."""
    began = time.monotonic()
    run = _FaultRun(scenario)
    try:
        ending, complaints = asyncio.run(run.outcome())
    except Exception as error:  # noqa: BLE001 - a run that breaks is a failure to be shown, not the end of the campaign
        ending, complaints = Ending.FAILURE, (f"{type(error).__name__}: {error}",)
    complaints = (*complaints, *run.complaints)
    return FaultReport(
        scenario.index,
        scenario.seed,
        Ending.FAILURE if complaints else ending,
        complaints,
        dict(run.strikes),
        run.doubts,
        tuple(run.pinned),
        run.says,
        time.monotonic() - began,
        run.stops,
    )


@dataclass
class _FaultRun:
    scenario: Scenario
    complaints: list[str] = field(default_factory=list)
    strikes: Counter[str] = field(default_factory=Counter)
    doubts: int = 0
    pinned: list[Pinned] = field(default_factory=list)
    says: str = ""
    _foreign: dict[str, float] = field(default_factory=dict)
    _loose: set[Phase] = field(default_factory=set)
    _doubted: object = None
    _armed_at: float | None = None
    stops: int = 0
    """Stopping faults after which nothing more could be sent."""
    _states: list[tuple[float, str]] = field(default_factory=list)
    _link_changes: list[asyncio.Task[None]] = field(default_factory=list)

    async def outcome(self) -> tuple[Ending, tuple[str, ...]]:
        s = self.scenario
        async with asyncio.timeout(RUN_S):
            with tempfile.TemporaryDirectory(prefix="mavcal-campaign-") as folder:
                seed, links = s.seed * 10_000 + s.index, ["udpout"] * s.links
                vehicle = await asyncio.to_thread(
                    SimulatedVehicle, s.autopilot, link=links, seed=seed, speed=s.speed, config=s.config
                )
                try:
                    async with session(Path(folder), vehicle) as bench:
                        return await self._run(bench, vehicle)
                finally:
                    await asyncio.to_thread(vehicle.stop)

    async def _run(self, bench: Session, vehicle: SimulatedVehicle) -> tuple[Ending, tuple[str, ...]]:
        await self._let_loose(vehicle, self.scenario.ambient, None)
        job = await bench.reviewed(vehicle, self.scenario.job, OPTIONS[self.scenario.job])
        if job.state == JobState.SUCCEEDED and self.scenario.config["parameters"].get("IMU_GYRO_CAL_EN"):
            return Ending.AS_BEFORE, ()  # PX4 has calibrated its gyros by itself: there was nothing to write
        if job.state != JobState.REVIEW or job.plan is None:
            return Ending.FAILURE, (f"no plan came of the capture: {job.outcome}",)
        before = await asyncio.to_thread(holding, vehicle)
        await self._two_links(bench, vehicle, job)
        await self._let_loose(vehicle, self._of(Phase.WRITE), job)
        noting = asyncio.create_task(self._note_states(bench, vehicle, job.id))
        try:
            await self._applied(bench, job)
            job = await self._followed(bench, vehicle, job.id, before)
        except TimeoutError:
            self.says = str(bench.engine.get(job.id).outcome)
            return Ending.FAILURE, (f"the job is {bench.engine.get(job.id).state} for ever",)
        finally:
            await self._all_noted(bench.engine.get(job.id))
            noting.cancel()
            for change in self._link_changes:
                change.cancel()
            await asyncio.gather(*self._link_changes, return_exceptions=True)
            await self._count(vehicle, bench.engine.get(job.id))
        self.says = self.says or _sentence(job)
        if job.state == JobState.IN_DOUBT:
            return Ending.IN_DOUBT, ()
        evidence = await self._evidence(vehicle, job, before)
        truth = await asyncio.to_thread(vehicle.truth)
        self._check_complete(job, len(truth[f"{job.kind}s"]))
        fitted = [fit.instance for fit in job.results if fit.status != "refused"]
        left = residuals(truth, evidence.now.in_force, job.kind, OPTIONS[job.kind], fitted)
        return judge(evidence, left)

    async def _applied(self, bench: Session, job: Job) -> None:
        """Accept the plan; the vehicle may have calibrated by itself since it was made."""
        try:
            await bench.applied(job)
        except PlanChanged as error:
            self.says = str(error)

    def _check_complete(self, job: Job, count: int) -> None:
        """Every instance was fitted, or the job says that it was left out."""
        for instance in set(range(count)) - {fit.instance for fit in job.results}:
            if not any(f"{instance + 1} " in warning for warning in job.warnings):
                self.complaints.append(f"{job.kind} {instance} was left out without a word")

    # --- while the job writes

    async def _followed(self, bench: Session, vehicle: SimulatedVehicle, job_id: str, before: Holding) -> Job:
        """Wait for the job's end; meanwhile faults strike, doubts are judged, and an operator puts things right."""
        async with asyncio.timeout(RUN_S - 40.0):
            while True:
                job = bench.engine.get(job_id)
                if job.state in ENDED:
                    return job
                if job.state == JobState.VERIFYING:
                    await self._let_loose(vehicle, self._of(Phase.VERIFY), job)
                    await bench.obeyed(job)
                elif job.state == JobState.ROLLING_BACK:
                    await self._let_loose(vehicle, self._of(Phase.ROLL_BACK), job)
                elif job.state == JobState.IN_DOUBT and job.standing is not self._doubted:
                    if await self._doubt_judged(bench, vehicle, job, before) and not self.scenario.resolve:
                        return job
                    await self._put_right(vehicle)
                await asyncio.sleep(POLL_S)

    def _of(self, phase: Phase) -> tuple[Strike, ...]:
        """The strikes of a phase, the first time."""
        if phase in self._loose:
            return ()
        self._loose.add(phase)
        return tuple(strike for strike in self.scenario.strikes if strike.phase == phase)

    async def _let_loose(self, vehicle: SimulatedVehicle, strikes: tuple[Strike, ...], job: Job | None) -> None:
        for strike in strikes:
            if strike.kind in (SECOND_LINK, LINK_DELETED):
                continue  # of the service's end: see _two_links
            options = dict(strike.options)
            if "wall_s" in options:
                options["duration_s"] = options.pop("wall_s") * self.scenario.speed
            if job is not None and strike.phase == Phase.WRITE:
                assert job.plan is not None
                options["trigger"] = {"nth_set": 1 + int(strike.share * len(job.plan.changes))}
            if strike.kind == "foreign_write":
                self._aim(options, job)
            await vehicle.acall("fault", kind="cut" if strike.kind == LINK_DIES else strike.kind, **options)

    async def _two_links(self, bench: Session, vehicle: SimulatedVehicle, job: Job) -> None:
        """Open the second link, now or in mid-write, and have the first one closed where that is to be tried."""
        assert job.plan is not None
        for strike in self.scenario.strikes:
            if strike.kind not in LINKS:
                continue
            nth = 1 + int(strike.share * len(job.plan.changes))
            if strike.kind != SECOND_LINK and not strike.options.get("alone"):
                await self._joined(bench, vehicle)
            if strike.kind == SECOND_LINK:
                change = self._second_link(bench, vehicle, nth)
            elif strike.kind == LINK_DELETED:
                change = self._first_deleted(bench, vehicle, nth, alone=bool(strike.options.get("alone")))
            else:
                continue
            self._link_changes.append(asyncio.create_task(change))

    async def _joined(self, bench: Session, vehicle: SimulatedVehicle) -> None:
        await bench.more(vehicle.urls[1])
        async with asyncio.timeout(JOINED_S):
            while len(bench.vehicle.links) < 2:  # noqa: ASYNC110 - the vehicle's answers alone change it
                await asyncio.sleep(POLL_S)

    async def _second_link(self, bench: Session, vehicle: SimulatedVehicle, nth: int) -> None:
        await self._until_set(vehicle, nth)
        self.strikes[SECOND_LINK] += 1
        try:
            await self._joined(bench, vehicle)
        except TimeoutError:
            self.complaints.append("the same vehicle on a second link was not recognised")

    async def _first_deleted(self, bench: Session, vehicle: SimulatedVehicle, nth: int, *, alone: bool) -> None:
        await self._until_set(vehicle, nth)
        self.strikes[LINK_DELETED] += 1
        try:
            await bench.close("campaign")
        except LinkBusy:
            if not alone:
                self.complaints.append("the link was not closed although another one leads to the vehicle")
        else:
            if alone and any(job.state in WRITING for job in bench.engine.list()):
                self.complaints.append("the only link was closed in mid-write")

    async def _until_set(self, vehicle: SimulatedVehicle, nth: int) -> None:
        before = (await vehicle.acall("state"))["param_sets"]
        while (await vehicle.acall("state"))["param_sets"] < before + nth:
            pass  # every question gives the loop away

    def _aim(self, options: Json, job: Job | None) -> None:
        """Point a third party's write at a parameter of the plan, with a value that is neither old nor new."""
        aim = options.pop("aim", None)
        if aim is not None:
            assert job is not None
            assert job.plan is not None
            floats = [c for c in job.plan.changes if c.kind == "real32" and c.sd is not None]
            target = floats[int(aim * len(floats))]
            options |= {"name": target.name, "value": float(target.new) * 0.5 + 0.0123}
        self._foreign[options["name"]] = float(options["value"])

    async def _doubt_judged(self, bench: Session, vehicle: SimulatedVehicle, job: Job, before: Holding) -> bool:
        """Compare the list with the vehicle; False if the job went on before that could be done."""
        evidence = await self._evidence(vehicle, job, before)
        now = bench.engine.get(job.id)
        if now.state != JobState.IN_DOUBT or now.standing is not job.standing:
            return False
        self._doubted = job.standing
        self.doubts += 1
        self.complaints += doubt_complaints(evidence)
        with suppress(ServiceError):
            await bench.engine.submit(bench.vehicle.id, "gyro")
            self.complaints.append("in doubt, and the vehicle is open for new jobs")
        return True

    async def _put_right(self, vehicle: SimulatedVehicle) -> None:
        """What the operator does about a doubt: disarm, restart a vehicle that calibrates, mend the link."""
        state = await vehicle.acall("state")
        kinds = {fault["kind"] for fault in state["faults"] if fault["struck"]}
        if state["armed"]:
            await asyncio.sleep(TRACKED_S)
            await self._check_armed(vehicle)
            await vehicle.acall("disarm")
        if "twin" in kinds or self.doubts > 1:
            await vehicle.acall("clear_faults")
        if "onboard_calibration" in kinds and self._armed_at is None and state["boots"] == 0:
            await vehicle.acall("reboot")

    async def _check_armed(self, vehicle: SimulatedVehicle) -> None:
        """Nothing is sent to an armed vehicle."""
        state = await vehicle.acall("state")
        arming = [t for fault in state["faults"] if fault["kind"] == "arm" for t in fault["struck"]]
        if not arming:
            return
        late = [s for s in state["param_set_list"] if s[0] > max(arming) + TRACKED_S * self.scenario.speed]
        if late:
            self.complaints.append(f"{len(late)} PARAM_SETs reached the vehicle long after it was armed")

    async def _note_states(self, bench: Session, vehicle: SimulatedVehicle, job_id: str) -> None:
        """When, by the vehicle's clock that goes on through restarts, the job enters which state."""
        async for event in bench.engine.subscribe(job_id):
            if event.kind == "state":
                now = await vehicle.acall("state")
                self._states.append((now["elapsed"], event.data["state"]))

    async def _all_noted(self, job: Job) -> None:
        """Wait until the last state is noted too: every note asks the vehicle, which takes its time when it is busy."""
        with suppress(TimeoutError):
            async with asyncio.timeout(NOTED_S):
                while not self._states or self._states[-1][1] != job.state:  # noqa: ASYNC110 - time alone changes it
                    await asyncio.sleep(POLL_S)

    def _check_stops(self, state: Json, faults: list[Json]) -> None:
        """After a stopping fault nothing more is sent, and the job is in doubt."""
        stops = [
            Stop(f["kind"], t, t + VISIBLE_S[f["kind"]] * self.scenario.speed, tuple(self._states))
            for f in faults
            if f["kind"] in STOPPING and f.get("duration_s", 1e9) > VISIBLE_S[f["kind"]] * self.scenario.speed
            for t in f["struck"]
        ]
        self.stops = sum(stop.demanded for stop in stops)
        self.complaints += stop_complaints(stops, state["param_set_list"])

    # --- afterwards

    async def _evidence(self, vehicle: SimulatedVehicle, job: Job, before: Holding) -> Evidence:
        now = await asyncio.to_thread(holding, vehicle)
        state = await vehicle.acall("state")
        ended = self._states[-1][0] if self._states and job.state in ENDED else math.inf
        own = {name: OwnWrite(value, when > ended) for when, name, value in state["own_writes"]}
        return Evidence(job_model(job).model_dump(mode="json"), before, now, self._foreign, own)

    async def _count(self, vehicle: SimulatedVehicle, job: Job) -> None:
        """Strikes after the first PARAM_SET: every fault but the ambient ones is set up to strike only then."""
        state = await vehicle.acall("state")
        faults = state["faults"][len(self.scenario.ambient) :]
        if not state["param_sets"]:
            return
        self._check_stops(state, faults)
        for fault in faults:
            fault["kind"] = LINK_DIES if fault["kind"] == "cut" else fault["kind"]
            struck = bool(fault["struck"]) and (fault["kind"] not in WIRE or fault["hits"] > 0)
            self.strikes[fault["kind"]] += struck
        self.pinned += [pin for name in held_back(state, faults) if (pin := _pin(name, job)) is not None]


def _pin(name: str, job: Job) -> Pinned | None:
    """What became of a parameter that was accepted and not applied; None: the check never came to it."""
    if job.verification is None:
        return None
    verdict = next((v for v in job.verification.parameters if v.name == name), None)
    if verdict is None or not verdict.acts_on_stream or verdict.sd <= 0:
        return None
    missed = job.state == JobState.SUCCEEDED and verdict.verdict == "proved"
    return Pinned(name, verdict.effect / verdict.sd, missed, named=verdict.verdict == "contradicted")


def _sentence(job: Job) -> str:
    outcome = job.outcome
    return str(getattr(outcome, "text", None) or getattr(outcome, "cause", ""))
