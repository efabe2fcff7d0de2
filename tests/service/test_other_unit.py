"""Two vehicles with one system id: one after the other is another vehicle, both at once stay a conflict."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from mavcal.service.jobs.core.journal import JournalStep
from mavcal.service.jobs.core.states import JobState
from mavcal.service.simvehicle import SimulatedVehicle, free_udp_port
from tests.patience import scaled

from .jobs_bench import eventually, session, stored

pytestmark = pytest.mark.timeout(240)

YIELD_S = 12.0


def unit(port: int, seed: int) -> SimulatedVehicle:
    """Units of different seeds have different unique ids, and the same system id."""
    config = {"thermal": False, "parameters": {"INS_GYR_CAL": 0}}
    sim = SimulatedVehicle("ardupilot", link=f"udpout:127.0.0.1:{port}", speed=10, seed=seed, config=config)
    sim.call("still")
    return sim


@pytest.mark.long
async def test_the_write_of_a_unit_that_was_swapped_is_never_finished_on_the_other(tmp_path: Path) -> None:
    port = free_udp_port()
    with unit(port, 31) as first:
        async with session(tmp_path, first.url, yield_s=YIELD_S) as bench:
            own = bench.vehicle.id
            await bench.writable()
            job = await bench.engine.submit(own, "gyro", {"uncertainty": 0.03})
            job = await bench.until(job.id, JobState.REVIEW, JobState.FAILED)
            assert job.state is JobState.REVIEW, job.outcome
            first.call("fault", kind="silence", duration_s=1e6, trigger={"nth_set": 4})
            await bench.accepted(job)
            await bench.until(job.id, JobState.IN_DOUBT)
            await asyncio.to_thread(first.stop)
            with await asyncio.to_thread(unit, port, 32) as second:
                before = stored(second)
                await eventually(lambda: [v.id for v in bench.registry.all()] not in ([own], []), 60.0)
                (other,) = bench.registry.all()
                assert other.id.startswith("uid-")
                await eventually(lambda: other.identity.known and other.writable().ok, 60.0)
                capture = await bench.engine.submit(other.id, "gyro", {"uncertainty": 0.03})
                capture = await bench.until(capture.id, JobState.REVIEW, JobState.FAILED)
                assert capture.state is JobState.REVIEW, capture.outcome
                assert bench.engine.get(job.id).state is JobState.IN_DOUBT
                assert stored(second) == before
                assert second.state()["param_sets"] == 0
            assert bench.store.journal(job.id)[-1].step == JournalStep.STOPPED


@pytest.mark.long
async def test_two_units_at_once_are_a_conflict_for_as_long_as_both_are_there(tmp_path: Path) -> None:
    port = free_udp_port()
    yield_s = 2.0 * scaled(YIELD_S)  # two answers lost in a row look like silence
    with unit(port, 33) as first:
        async with session(tmp_path, first.url, yield_s=yield_s) as bench:
            with await asyncio.to_thread(unit, port, 34):
                await eventually(lambda: bool(bench.vehicle.conflicts), 60.0)
                await asyncio.sleep(1.5 * yield_s)
                assert bench.registry.all() == (bench.vehicle,)
                assert bench.vehicle.conflicts
