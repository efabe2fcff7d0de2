"""SIGKILL runs of ``mavcal serve``: killed when its journal reaches a step, started again, and left to itself."""

from __future__ import annotations

import sqlite3
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.campaign.judge import Ending, Evidence, judge
from bench.campaign.report import REPEATS, KillReport
from bench.campaign.scenario import OPTIONS, SPEED
from bench.campaign.truth import Holding, holding, residuals
from bench.running import RunningService
from mavcal.client import ApiProblem, Client, Unreachable
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.simvehicle import Operator, SimulatedVehicle

SERIES = 1000
"""Repetition n of a kill has its index plus n times this."""


@dataclass(frozen=True)
class Scene:
    """How the vehicle and the job are set up."""

    autopilot: str
    job: str
    fault: Mapping[str, Any] | None = None
    """Let loose when the plan is accepted; `share` places it among the plan's parameters."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Settings of the vehicle."""
    moves: bool = False
    """The vehicle is on two links; the service that takes the write up knows only the second."""
    gyro_off_by: float = 0.0
    """How far from its truth somebody has set PX4's first gyro along x before the job, rad/s: it is to be written.

    Along the other axes it is right: PX4 takes a change of more than 0.01 rad/s at once, and needs no restart then.
    """


_BARE = {"INS_GYR_CAL": 0.0}
"""No calibration of its own at boot: there is something to calibrate."""

SCENES: Mapping[str, Scene] = {
    "gyro": Scene("ardupilot", "gyro", None, _BARE),
    # IMU_GYRO_CAL_EN 1 let PX4 correct gyro_off_by itself once in 76 runs: nothing was left to write.
    "restart": Scene("px4", "gyro", None, {"IMU_GYRO_CAL_EN": 0.0}, gyro_off_by=0.004),
    "commands": Scene("ardupilot", "accel", None, _BARE),
    "not applied": Scene("ardupilot", "gyro", {"kind": "not_applied", "share": 0.5}, _BARE),
    "third party": Scene("ardupilot", "gyro", {"kind": "foreign_write", "share": 0.99, "value": 0.0321}, _BARE),
    "armed": Scene("ardupilot", "gyro", {"kind": "arm", "share": 0.6}, _BARE),
    "other link": Scene("ardupilot", "gyro", None, _BARE, moves=True),
    "capture": Scene("px4", "gyro", None, {"IMU_GYRO_CAL_EN": 0.0}),
}

_LEADS: Mapping[str, tuple[JournalStep, ...]] = {
    "gyro": (
        JournalStep.ACCEPTED,
        JournalStep.STREAMS,
        JournalStep.SNAPSHOT,
        JournalStep.SEND,
        JournalStep.ECHO,
        JournalStep.READ_BACK,
        JournalStep.VERIFIED,
        JournalStep.STREAMS_RESTORED,
        JournalStep.CLOSED,
    ),
    "restart": (JournalStep.REBOOT, JournalStep.REBOOTED, JournalStep.RESTORE, JournalStep.RESTORED),
    "commands": (JournalStep.COMMAND, JournalStep.COMMANDED),
    "not applied": (JournalStep.ROLL_BACK, JournalStep.UNDO, JournalStep.UNDONE),
    "third party": (JournalStep.LEFT,),
    "armed": (JournalStep.STOPPED,),
    "other link": (JournalStep.SEND, JournalStep.ECHO),
    "capture": (JournalStep.STREAMS,),
}
"""Which scene leads through which steps."""


@dataclass(frozen=True)
class Kill:
    """One run: kill at the `occurrence`-th row of `step` after the accept (in the scene ``capture``: at all)."""

    index: int
    seed: int
    scene: str
    step: JournalStep
    occurrence: int
    again: JournalStep | None = None
    """Killed a second time, at the first row of this step that the restarted service writes."""
    scenery: Scene = field(repr=False, default=SCENES["gyro"])


def kills(seed: int) -> tuple[Kill, ...]:
    """Every step of the journal, `REPEATS` times, at different occurrences; and some services that are killed twice."""
    planned: list[tuple[str, JournalStep, int, JournalStep | None]] = [
        (scene, step, _occurrence(step, repeat), None)
        for repeat in range(REPEATS)
        for scene, steps in _LEADS.items()
        for step in steps
    ]
    planned += [
        ("gyro", JournalStep.SEND, 6, JournalStep.UNDO),
        ("gyro", JournalStep.ECHO, 3, JournalStep.ROLL_BACK),
        ("gyro", JournalStep.READ_BACK, 1, JournalStep.VERIFIED),
        ("restart", JournalStep.REBOOT, 1, JournalStep.REBOOTED),
        ("not applied", JournalStep.UNDO, 2, JournalStep.UNDONE),
    ]
    return tuple(Kill(i, seed, s, step, n, again, SCENES[s]) for i, (s, step, n, again) in enumerate(planned))


def repetition(kill: Kill, number: int) -> Kill:
    """The same once more, for a step that was not struck often enough."""
    return replace(kill, index=kill.index % SERIES + number * SERIES, again=None)


def kill_of(seed: int, index: int) -> Kill:
    """The kill of that index, be it a repetition. Raises IndexError if there is none."""
    kill = kills(seed)[index % SERIES]
    return kill if index < SERIES else repetition(kill, index // SERIES)


def _occurrence(step: JournalStep, repeat: int) -> int:
    """The first, one in the middle, one near the end; the other steps come once."""
    many = {
        JournalStep.SEND: (1, 5, 12),
        JournalStep.ECHO: (1, 7, 12),
        JournalStep.UNDO: (1, 4, 9),
        JournalStep.UNDONE: (1, 5, 11),
    }
    return many.get(step, (1, 1, 1))[repeat]


Json = dict[str, Any]

REVIEWED_S = 90.0
KILLED_S = 60.0
RESOLVED_S = 120.0
POLL_S = 0.05
JOURNAL_S = 0.0001
DATABASE = "mavcal.sqlite3"
PROVE_S = 20.0
"""Nobody moves the vehicle in these runs: what lies still proves the gyro."""
ENDED = frozenset({"succeeded", "reverted", "review", "interrupted", "failed", "cancelled"})


def run_kill(kill: Kill) -> KillReport:
    """Carry out one run; never raises: what goes wrong is a complaint of the report."""
    began = time.monotonic()
    run = _KillRun(kill)
    try:
        ending, complaints = run.outcome()
    except Exception as error:  # noqa: BLE001 - a run that breaks is a failure to be shown, not the end of the campaign
        ending, complaints = Ending.FAILURE, (f"{type(error).__name__}: {error}",)
    aimed = f"{kill.step} {kill.occurrence}" + (f", {kill.again}" if kill.again else "")
    return KillReport(
        kill.index,
        kill.seed,
        kill.scene,
        aimed,
        tuple(run.struck),
        ending,
        complaints,
        run.says,
        time.monotonic() - began,
        tuple(run.steps),
    )


class _KillRun:
    def __init__(self, kill: Kill) -> None:
        self._kill = kill
        self.struck: list[str] = []
        self.steps: list[str] = []
        self.says = ""
        self._foreign: dict[str, float] = {}
        self._job_id = ""

    def outcome(self) -> tuple[Ending, tuple[str, ...]]:
        scene = self._kill.scenery
        config = {"thermal": False, "parameters": dict(scene.parameters), "highres": self._kill.index % 2 == 0}
        links = ["udpout"] * (2 if scene.moves else 1)
        seed = self._kill.seed * 10_000 + 5_000 + self._kill.index
        with (
            tempfile.TemporaryDirectory(prefix="mavcal-campaign-") as folder,
            SimulatedVehicle(scene.autopilot, link=links, seed=seed, speed=SPEED, config=config) as vehicle,
        ):
            data_dir = Path(folder)
            try:
                return self._carried(data_dir, vehicle)
            finally:
                with suppress(Exception):
                    self.steps = journal(data_dir, self._job_id)

    def _carried(self, data_dir: Path, vehicle: SimulatedVehicle) -> tuple[Ending, tuple[str, ...]]:
        before = self._first_life(data_dir, vehicle)
        if self._kill.again is not None:
            self._second_life(data_dir, vehicle)
        if vehicle.state()["armed"]:
            vehicle.call("disarm")
        service = RunningService(vehicle.urls[-1], data_dir)
        try:
            job = self._ended(service.client, RESOLVED_S)
        finally:
            service.kill()
        self.says = str(job["outcome"])
        evidence = Evidence(job, before, holding(vehicle), self._foreign)
        kind = self._kill.scenery.job
        fitted = [fit["instance"] for fit in job["results"] if fit["status"] != "refused"]
        left = residuals(vehicle.truth(), evidence.now.in_force, kind, OPTIONS[kind], fitted)
        return judge(evidence, left)

    # --- the first life of the service, up to its kill

    def _first_life(self, data_dir: Path, vehicle: SimulatedVehicle) -> Holding:
        service = RunningService(vehicle.url, data_dir)
        try:
            client = service.client
            vehicle_id = _found(client)
            kind = self._kill.scenery.job
            before = holding(vehicle)
            posted = _patiently(lambda: client.start_job(vehicle_id, kind=kind, options=OPTIONS[kind]))
            self._job_id = posted.id
            if self._kill.scene == "capture":
                self._killed(service, data_dir, self._kill.step, lambda steps: steps)
                return before
            job = self._reviewed(client, vehicle)
            self._let_loose(vehicle, job)
            accept = {"plan_sha256": job["plan"]["sha256"], "reboot": True, "prove_s": PROVE_S}
            applying = threading.Thread(target=self._applied, args=(client, accept))
            applying.start()
            self._killed(service, data_dir, self._kill.step, _after_accept)
            applying.join()
            return before
        finally:
            service.kill()

    def _reviewed(self, client: Client, vehicle: SimulatedVehicle) -> Json:
        operator = Operator(vehicle)
        asked = None
        deadline = time.monotonic() + REVIEWED_S
        while time.monotonic() < deadline:
            job = _document(client, self._job_id)
            if job["state"] == "review":
                operator.rest()
                vehicle.wait(4.0)
                return job
            if job["state"] in ENDED:
                raise RuntimeError(f"no plan came of the capture: {job['outcome']}")
            if job["prompt"] and job["prompt"] != asked:
                asked = job["prompt"]
                operator.follow(asked)
            time.sleep(POLL_S)
        raise TimeoutError("the capture did not end")

    def _let_loose(self, vehicle: SimulatedVehicle, job: Json) -> None:
        if self._kill.scenery.fault is None:
            return
        fault = dict(self._kill.scenery.fault)
        changes = job["plan"]["changes"]
        chosen = int(fault.pop("share") * len(changes))
        if fault["kind"] == "foreign_write":
            fault["name"] = changes[chosen]["name"]
            self._foreign[fault["name"]] = float(fault["value"])
        vehicle.call("fault", trigger={"nth_set": 1 + chosen}, **fault)

    def _applied(self, client: Client, accept: Json) -> None:
        with suppress(Unreachable):  # it is killed in the middle
            _patiently(lambda: client.apply_plan(self._job_id, **accept))

    # --- kills

    def _killed(
        self, service: RunningService, data_dir: Path, step: JournalStep, since: Callable[[list[str]], list[str]]
    ) -> None:
        """Kill the service when `step` has come as often as planned; note at which step it died."""
        wanted = self._kill.occurrence if step == self._kill.step else 1

        def reached(steps: list[str]) -> bool:
            return since(steps).count(step) >= wanted

        def over() -> bool:
            with suppress(Unreachable):
                return service.client.get_job(self._job_id).state in ENDED - {"review"}
            return not service.alive

        hit = wait_for_step(data_dir, self._job_id, reached, over, KILLED_S)
        service.kill()
        if hit:
            self.struck.append(journal(data_dir, self._job_id)[-1])

    def _second_life(self, data_dir: Path, vehicle: SimulatedVehicle) -> None:
        """The service that recovers is killed too."""
        known = len(journal(data_dir, self._job_id))
        assert self._kill.again is not None
        service = RunningService(vehicle.url, data_dir)
        self._killed(service, data_dir, self._kill.again, lambda steps: steps[known:])

    def _ended(self, client: Client, timeout_s: float) -> Json:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            job = _document(client, self._job_id)
            if job["state"] in ENDED:
                return job
            time.sleep(POLL_S)
        return job


def _after_accept(steps: list[str]) -> list[str]:
    return steps[steps.index(JournalStep.ACCEPTED) :] if JournalStep.ACCEPTED in steps else []


def _found(client: Client) -> str:
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        known = client.list_vehicles()
        if known and known[0].uid and known[0].writable:
            return known[0].id
        time.sleep(POLL_S)
    raise TimeoutError("the service did not find the simulated vehicle")


def _document(client: Client, job_id: str) -> Json:
    """The job as JSON, which is what a run is judged by."""
    return client.get_job(job_id).model_dump(mode="json")


def _patiently(ask: Callable[[], Any]) -> Any:
    """Repeat what is refused because the vehicle was not yet seen disarmed for 2 s."""
    deadline = time.monotonic() + 15.0
    while True:
        try:
            return ask()
        except ApiProblem as error:
            if error.status != 409 or time.monotonic() > deadline:
                raise
            time.sleep(0.3)


def journal(data_dir: Path, job_id: str) -> list[str]:
    """The steps of a job's journal, oldest first, through a connection that cannot write."""
    with closing(_read_only(data_dir)) as db:
        return _steps(db, job_id)


def wait_for_step(
    data_dir: Path, job_id: str, reached: Callable[[list[str]], bool], ended: Callable[[], bool], timeout_s: float
) -> bool:
    """Wait until the journal is as `reached` says; False if `ended` came first, or the time is up."""
    deadline = time.monotonic() + timeout_s
    with closing(_read_only(data_dir)) as db:
        while time.monotonic() < deadline:
            for _ in range(200):
                if reached(_steps(db, job_id)):
                    return True
                time.sleep(JOURNAL_S)
            if ended():
                return reached(_steps(db, job_id))
    return False


def _read_only(data_dir: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"file:{data_dir / DATABASE}?mode=ro", uri=True, isolation_level=None, timeout=5.0)


def _steps(db: sqlite3.Connection, job_id: str) -> list[str]:
    return [row[0] for row in db.execute("SELECT step FROM journal WHERE job_id = ? ORDER BY id", (job_id,))]
