"""SIGKILL at the instants that matter, against a simulated vehicle; every instant is covered by the unit tests."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .jobs_bench import GYRO_OFFSETS, SPEED, session, stored, zero_gyro_offsets

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle("ardupilot", speed=SPEED, seed=12, config={"thermal": False}) as vehicle:
        vehicle.call("still")
        yield vehicle


def killed(folder: Path, url: str, action: str, point: At, occurrence: int = 1) -> None:
    """Run the service until it is killed there."""
    arguments = [str(folder), url, action, point.value, str(occurrence)]
    command = [sys.executable, "-W", "error", "-m", "tests.service.jobs_process", *arguments]
    done = subprocess.run(command, cwd=ROOT, timeout=scaled(90), capture_output=True, text=True, check=False)
    assert done.returncode == -9, f"it was not killed at {point}: {done.stderr[-2000:]}"


async def resumed(folder: Path, url: str) -> tuple[JobState, list[str]]:
    """The service after the kill: where the job ends, and its journal."""
    async with session(folder, url) as bench:
        job = bench.engine.list()[-1]
        job = await bench.until(job.id, *ENDED, JobState.REVIEW)
        return job.state, [row.step for row in bench.store.journal(job.id)]


@pytest.mark.long
async def test_killed_in_the_capture_and_in_the_write(tmp_path: Path, sim: SimulatedVehicle) -> None:
    zero_gyro_offsets(sim)
    before = stored(sim)
    killed(tmp_path, sim.url, "capture", At.CAPTURE_RUNNING)
    state, _ = await resumed(tmp_path, sim.url)  # replays what was recorded and goes on with the same vehicle
    assert state == JobState.REVIEW
    assert stored(sim) == before

    # In the middle of the parameters: taken back.
    killed(tmp_path, sim.url, "apply", At.AFTER_ECHO, 4)
    assert stored(sim) != before
    state, steps = await resumed(tmp_path, sim.url)
    assert state == JobState.REVERTED
    assert stored(sim) == before
    assert steps[-1] == JournalStep.CLOSED

    async with session(tmp_path, sim.url) as bench:
        assert bench.engine.book.handle(bench.engine.list()[-1].id).write_record().intervals == {}


@pytest.mark.long
async def test_killed_after_the_last_echo_and_then_after_the_proof(tmp_path: Path, sim: SimulatedVehicle) -> None:
    zero_gyro_offsets(sim)
    killed(tmp_path, sim.url, "capture", At.FITTED)
    state, _ = await resumed(tmp_path, sim.url)  # the closed segment is fitted again
    assert state == JobState.REVIEW
    killed(tmp_path, sim.url, "apply", At.READ_BACK)
    killed(tmp_path, sim.url, "resume", At.VERIFIED)
    state, _ = await resumed(tmp_path, sim.url)
    assert state == JobState.SUCCEEDED
    assert all(stored(sim)[name] != 0.0 for name in GYRO_OFFSETS)
