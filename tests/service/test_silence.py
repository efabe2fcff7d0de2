"""A vehicle that dies in the middle of a job, as the operator sees it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from mavcal.service.jobs.core.states import JobState
from mavcal.service.simvehicle import SimulatedVehicle

from .jobs_bench import eventually, session

pytestmark = pytest.mark.timeout(120)

SAID_S = 8.0


@pytest.mark.long
async def test_silence_is_said_within_8_s_and_so_is_the_return(tmp_path: Path) -> None:
    with SimulatedVehicle("ardupilot", speed=5, seed=21, config={"thermal": False}) as sim:
        sim.call("still")
        async with session(tmp_path, sim.url) as bench:
            await bench.writable()
            job = await bench.engine.submit(bench.vehicle.id, "gyro", {"uncertainty": 0.0011})

            def step() -> str:
                prompt = bench.engine.get(job.id).prompt
                return "" if prompt is None else prompt.step

            await eventually(lambda: step() == "hold_still", 30.0)
            await asyncio.to_thread(sim.call, "fault", kind="silence", duration_s=5 * 12.0)
            await eventually(lambda: step() == "silent", SAID_S)
            prompt = bench.engine.get(job.id).prompt
            assert prompt is not None
            assert prompt.text.endswith("The job gives up after 63 s of silence.")
            await eventually(lambda: step() == "hold_still", 30.0)
            # The capture's own prompt may come before the watch has looked again.
            await eventually(
                lambda: any("is heard again" in said for said in bench.engine.get(job.id).warnings), SAID_S
            )
            assert (await bench.engine.cancel(job.id)).state is JobState.CANCELLED
