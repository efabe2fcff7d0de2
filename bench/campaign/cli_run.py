"""SIGKILL runs of the command line: ``mavcal calibrate`` dies at a named instant, the next run has to put it right.

Every instant of :class:`service.jobs.core.crashpoints.At` that a gyro job leads through is struck, followed by ``mavcal
recover`` and, elsewhere, by the next ``mavcal calibrate``. The simulator judges, as in the runs of the service.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.campaign.judge import Ending, Evidence, judge
from bench.campaign.kill_run import SCENES
from bench.campaign.report import KillReport
from bench.campaign.scenario import OPTIONS, SPEED
from bench.campaign.truth import Holding, holding, residuals, true_px4_gyro
from mavcal.service.api.views import job_model
from mavcal.service.jobs.core.codec import job_of
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.simvehicle import SimulatedVehicle
from mavcal.service.store import SqliteStore

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 240.0
RECOVER, CALIBRATE = "recover", "calibrate"

_LEADS: Mapping[str, tuple[tuple[At, int], ...]] = {
    "gyro": (
        (At.CAPTURE_STARTED, 1),
        (At.CAPTURE_RUNNING, 1),
        (At.CAPTURE_CLOSED, 1),
        (At.FITTED, 1),
        (At.ACCEPTED, 1),
        (At.SNAPSHOT_KEPT, 1),
        (At.BEFORE_SEND, 1),
        (At.BEFORE_SEND, 6),
        (At.AFTER_ECHO, 1),
        (At.AFTER_ECHO, 7),
        (At.ECHO_KEPT, 12),
        (At.READ_BACK, 1),
        (At.VERIFIED, 1),
        (At.CLOSED, 1),
    ),
    "restart": ((At.BEFORE_SEND, 2), (At.REBOOT_SENT, 1), (At.REBOOTED, 1), (At.BEFORE_RESTORE, 1)),
    "not applied": ((At.ROLLBACK_BEGUN, 1), (At.BEFORE_UNDO, 2), (At.AFTER_UNDO, 2)),
}
"""Which scene leads through which instants, and the how-many-th of them is fatal."""


@dataclass(frozen=True)
class CliKill:
    """One run."""

    index: int
    seed: int
    scene: str
    at: At
    occurrence: int
    then: str


def cli_kills(seed: int) -> tuple[CliKill, ...]:
    """Every instant, followed by ``recover`` and, in the second half, by the next calibration."""
    planned = [(s, at, n) for s, leads in _LEADS.items() for at, n in leads]
    runs = [(s, at, n, then) for then in (RECOVER, CALIBRATE) for s, at, n in planned]
    return tuple(CliKill(i, seed, s, at, n, then) for i, (s, at, n, then) in enumerate(runs))


def run_cli_kill(kill: CliKill) -> KillReport:
    """Carry out one run; never raises: what goes wrong is a complaint of the report."""
    began = time.monotonic()
    says = ""
    try:
        ending, complaints, says = _outcome(kill)
    except Exception as error:  # noqa: BLE001 - a run that breaks is a failure to be shown, not the end of the campaign
        ending, complaints = Ending.FAILURE, (f"{type(error).__name__}: {error}",)
    aimed = f"{kill.at} {kill.occurrence}, then {kill.then}"
    struck = (kill.at.value,) if ending != Ending.FAILURE else ()
    seconds = time.monotonic() - began
    return KillReport(kill.index, kill.seed, kill.scene, aimed, struck, ending, complaints, says, seconds, part="cli")


def _outcome(kill: CliKill) -> tuple[Ending, tuple[str, ...], str]:
    scene = SCENES[kill.scene]
    config = {"thermal": False, "parameters": dict(scene.parameters), "highres": kill.index % 2 == 0}
    with (
        tempfile.TemporaryDirectory(prefix="mavcal-campaign-") as folder,
        SimulatedVehicle(
            scene.autopilot, seed=kill.seed * 10_000 + 8_000 + kill.index, speed=SPEED, config=config
        ) as sim,
    ):
        sim.call("still")
        sim.wait(30.0)
        if scene.gyro_off_by:
            for name, true in true_px4_gyro(sim.truth(), holding(sim).stored).items():
                off = scene.gyro_off_by if name.endswith("XOFF") else 0.0
                sim.call("fault", kind="foreign_write", name=name, value=true + off)
            sim.wait(5.0)
            sim.call("reboot")  # PX4 loads so small a change only then
            sim.wait(30.0)
        before = holding(sim)
        if scene.fault is not None:
            sim.call("fault", kind=scene.fault["kind"], trigger={"nth_set": 6})
        place = ["--connect", sim.url, "--data-dir", folder]
        options = [word for name, value in OPTIONS["gyro"].items() for word in ("--option", f"{name}={value}")]
        job = ["calibrate", "gyro", "--apply", "--reboot", *options, *place]
        killer = ["-m", "bench.campaign.cli_process", kill.at.value, str(kill.occurrence)]
        died = _ran([*killer, *job])
        if died.returncode != -signal.SIGKILL:
            return Ending.FAILURE, (f"it was not killed: exit code {died.returncode}",), died.stderr[-500:]
        sim.call("clear_faults")
        after = _ran(["-m", "mavcal", *(["recover", *place] if kill.then == RECOVER else job)])
        jobs = _jobs(Path(folder))
        complaints = [] if after.returncode == 0 else [f"{kill.then} ended with exit code {after.returncode}"]
        if "Traceback" in after.stderr:
            complaints.append(f"{kill.then} ended with a traceback")
        ending = Ending.FAILURE
        for told in jobs:
            last = told is jobs[-1]
            ending, wrong = _judged(told, before, holding(sim), sim, whole=last)
            complaints += wrong
            before = _written(before, told)
        return (Ending.FAILURE if complaints else ending), tuple(complaints), after.stderr[-1500:]


def _judged(
    job: Mapping[str, Any], before: Holding, now: Holding, sim: SimulatedVehicle, *, whole: bool
) -> tuple[Ending, tuple[str, ...]]:
    """The newest job is compared with the vehicle; of an earlier one it counts that it has ended."""
    if not whole:
        over = job["state"] in {"succeeded", "reverted", "review", "cancelled", "failed", "interrupted"}
        return Ending.AS_BEFORE, () if over else (f"the first job is {job['state']}",)
    fitted = [fit["instance"] for fit in job["results"] if fit["status"] != "refused"]
    left = residuals(sim.truth(), now.in_force, "gyro", OPTIONS["gyro"], fitted)
    return judge(Evidence(job, before, now, {}), left)


def _written(before: Holding, job: Mapping[str, Any]) -> Holding:
    """The expected parameters after an earlier run of the command wrote its whole plan."""
    if job["state"] != "succeeded":
        return before
    new = {c["name"]: c["new"] for c in (job["plan"] or {"changes": []})["changes"] if not c["session"]}
    return Holding({**before.stored, **new}, before.in_force)


def _jobs(folder: Path) -> list[dict[str, Any]]:
    store = SqliteStore(folder)
    try:
        return [job_model(job_of(row, store)).model_dump(mode="json") for row in store.jobs()]
    finally:
        store.close()


def _ran(arguments: list[str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=ROOT, timeout=LIMIT_S, capture_output=True, text=True, check=False)
