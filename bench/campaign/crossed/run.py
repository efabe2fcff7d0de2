"""A crossed run: one vehicle, one data directory, one or two lives of the service, and the verdict."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import random
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import structlog

from bench.campaign.crossed import checks
from bench.campaign.crossed.disk import Disk, WallClock, installed, power_cut
from bench.campaign.crossed.forked import Forked, ForkedVehicle
from bench.campaign.crossed.life import DyingPool, Life, dies
from bench.campaign.crossed.plan import OPTIONS, Cross, Network, Process
from bench.campaign.crossed.report import CrossReport
from bench.campaign.crossed.stores import Ledger, StoreKind, watched
from bench.campaign.judge import ENDINGS, Ending, Evidence, by_itself, judge
from bench.campaign.session import session
from bench.campaign.truth import Holding, holding, residuals
from mavcal.service.api.views import job_model
from mavcal.service.jobs.crashpoints import At, CrashPoint, nowhere
from mavcal.service.jobs.model import Job
from mavcal.service.jobs.salvage import job_of
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store import Store

Json = dict[str, Any]

LIFE_S = 240.0
"""No life takes longer: a job that never ends is a failure."""
CLAIMS = {**ENDINGS, "failed": Ending.AS_BEFORE}
"""A capture that failed has written nothing."""


def run_cross(cross: Cross, kind: StoreKind | None = None) -> CrossReport:
    """Carry out one run; never raises: what goes wrong is a complaint of the report."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    began, spent = time.monotonic(), _processor()
    run = _Run(cross, kind or StoreKind())
    ending = Ending.FAILURE
    try:
        with tempfile.TemporaryDirectory(prefix="mavcal-crossed-") as folder:
            ending = run.outcome(Path(folder).resolve())
    except Exception as error:  # noqa: BLE001 - a run that breaks is a failure to be shown, not the end of the campaign
        run.complaints.append(f"{type(error).__name__}: {error}")
    return CrossReport(
        cross.index,
        cross.seed,
        cross.network.value,
        cross.process.value,
        cross.vehicle.value,
        cross.autopilot,
        cross.job,
        Ending.FAILURE if run.complaints else ending,
        tuple(run.complaints),
        run.struck,
        run.state,
        run.says,
        run.doubts,
        run.resumed,
        time.monotonic() - began,
        _processor() - spent,
    )


@dataclass
class _Run:
    cross: Cross
    kind: StoreKind
    complaints: list[str] = field(default_factory=list)
    struck: dict[str, bool] = field(default_factory=dict)
    state: str = ""
    says: str = ""
    doubts: int = 0
    resumed: bool = False
    _name: str = ""
    _where: str = ""
    """Where the job of the last life stood."""

    def outcome(self, folder: Path) -> Ending:
        c = self.cross
        self._name = f"run_{c.seed}_{c.index}_{os.getpid()}"
        data_dir, self._notes = folder / "data", folder / "notes"
        self._ledger, self._image = folder / "ledger", folder / "image"
        self._notes.touch()
        link = "tcp" if c.network == Network.RECONNECT else "udpout"
        sim = ForkedVehicle(c.autopilot, link=link, seed=c.simulator_seed, speed=c.speed, config=c.config)
        try:
            before = holding(sim)
            self._disk = Disk(c)
            installed(self._disk, WallClock(c.process == Process.CLOCK))
            if c.crash is not None and self._died(data_dir, sim, before):
                self._after_death(data_dir, sim)
            elif c.crash is not None:
                return self._judged(data_dir, sim, before, None)
            job = asyncio.run(self._lived(data_dir, sim, before, nowhere))
            return self._judged(data_dir, sim, before, job)
        finally:
            sim.stop()

    # --- lives

    def _died(self, data_dir: Path, sim: ForkedVehicle, before: Holding) -> bool:
        """Carry the life that is to end by itself in a child; whether it did, or came to the end of its job."""

        def body() -> int:
            os.setpgid(0, 0)
            sim.connect()
            asyncio.run(self._lived(data_dir, sim, before, self._killer(data_dir)))
            self._note("complaints", self.complaints)
            return 0

        child = Forked(body)
        try:
            code = child.wait(LIFE_S + 20.0)
        except subprocess.TimeoutExpired:
            self.complaints.append("the first life never ended")
            child.kill()
            code = child.wait()
        finally:
            child.stdin.close()
            child.stdout.close()
        for what, data in self._told():
            if what == "complaints":
                self.complaints += data
        if code not in (0, -signal.SIGKILL):
            self.complaints.append(f"the first life ended with code {code}")
        return code == -signal.SIGKILL

    def _killer(self, data_dir: Path) -> CrashPoint:
        assert self.cross.crash is not None
        at, occurrence = self.cross.crash
        count = 0

        def reach(now: At) -> None:
            nonlocal count
            count += now == at
            if now == at and count == occurrence:
                if self.cross.process == Process.POWER:
                    power_cut(data_dir, self._image, self._disk, random.Random(self.cross.simulator_seed))
                os.kill(os.getpid(), signal.SIGKILL)

        return reach

    def _after_death(self, data_dir: Path, sim: SimulatedVehicle) -> None:
        if self.cross.process == Process.POWER and self.kind.in_data_dir:
            shutil.rmtree(data_dir)
            self._image.rename(data_dir)
        if self.cross.network == Network.PARTITION:
            sim.call("clear_faults")  # the network is mended by the time that somebody starts the service again
        self.struck["process"] = True
        self.resumed = True
        self._logs = checks.recorded(data_dir)

    async def _lived(self, data_dir: Path, sim: SimulatedVehicle, before: Holding, reach: CrashPoint) -> Job:
        c = self.cross
        told = self._told()
        ledger = Ledger(self._ledger)
        inner = self.kind.opened(data_dir, self._name)
        jobs = [row.id for row in inner.jobs()]
        accepted = any(row.step == "accepted" for job_id in jobs for row in inner.journal(job_id))
        store = watched(inner, data_dir, self._disk, ledger)
        pool, wall = DyingPool(dies=dies(c)), WallClock(c.process == Process.CLOCK)
        try:
            async with (
                asyncio.timeout(LIFE_S),
                session(data_dir, sim, store, executor=pool, wall=wall, reach=reach) as bench,
            ):
                life = Life(c, sim, bench, before, accepted, self._note)
                for what, data in told:
                    if what == "foreign":
                        life.foreign |= data
                try:
                    return await life.lived(jobs[0] if jobs else None)
                finally:
                    known = bench.engine.list()
                    self._where = f"the job is {known[0].state}: {known[0].outcome}" if known else "no job has begun"
                    self.complaints += life.complaints
                    self.doubts += life.doubts
                    self.struck.setdefault("process", pool.died or self._disk.strikes > 0 or wall.jumps)
                    self._note("foreign", life.foreign)
        except TimeoutError:
            raise RuntimeError(f"this goes on for ever: {self._where or 'no vehicle is heard'}") from None
        finally:
            pool.shutdown()
            ledger.close()

    def _note(self, what: str, data: Any) -> None:
        with self._notes.open("a") as notes:
            notes.write(json.dumps([what, data]) + "\n")

    def _told(self) -> list[tuple[str, Any]]:
        return [tuple(json.loads(line)) for line in self._notes.read_text().splitlines()]

    # --- the verdict

    def _judged(self, data_dir: Path, sim: SimulatedVehicle, before: Holding, job: Job | None) -> Ending:
        """Compare what the store says once it is opened again with the vehicle, the ledger and the disk."""
        now, truth, state = holding(sim), sim.truth(), sim.state()
        self._count(state)
        foreign: dict[str, float] = {}
        for what, data in self._told():
            if what == "foreign":
                foreign |= data
        with closing(self.kind.opened(data_dir, self._name)) as store:
            self.complaints += checks.lost(self._ledger, store)
            self.complaints += checks.damaged(store)
            self.complaints += checks.overwritten(getattr(self, "_logs", {}))
            kept = _kept(store)
            if job is not None and kept is not None and kept.state != job.state:
                self.complaints.append(f"the job was {job.state} and is lost as that: the store says {kept.state}")
            told = job or kept
            if told is None:
                self.complaints.append("no job is left")
                return Ending.FAILURE
            self.state, self.says = told.state.value, str(told.outcome)
            evidence = Evidence(job_model(told).model_dump(mode="json"), before, now, foreign)
            excused = [name for name in now.stored if by_itself(evidence, name)]
            rows = store.journal(told.id)
            self.complaints += checks.contradicted(rows, now.stored, foreign, excused)
        left = []
        if told.kind != "level":
            fitted = [fit.instance for fit in told.results if fit.status != "refused"]
            left = list(residuals(truth, now.in_force, told.kind, OPTIONS[told.kind], fitted))
        ending, complaints = judge(evidence, left, CLAIMS)
        self.complaints += complaints
        return ending

    def _count(self, state: Json) -> None:
        """Which of the three faults struck."""
        kinds = {fault["kind"] for fault in state["faults"] if fault["struck"]}
        wire = {"loss", "reordering", "duplication", "bit_errors", "truncation", "disconnect", "move"}
        self.struck["network"] = bool(kinds & wire)
        self.struck["vehicle"] = bool(kinds - wire - {"not_applied"})
        self.struck.setdefault("process", False)


def _kept(store: Store) -> Job | None:
    rows = store.jobs()
    return job_of(rows[0], store) if rows else None


def _processor() -> float:
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime
