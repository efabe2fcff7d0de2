from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.calib.firmware.plan import ProofVerdict
from mavcal.service.errors import PhysicalJobRunning, PlanChanged, VehicleArmed
from mavcal.service.jobs.calibrate.digest import JobFitRequest, fit_segments
from mavcal.service.jobs.core.model import Accept, Failure, Result
from mavcal.service.jobs.core.states import JobState
from mavcal.service.simvehicle import SimulatedVehicle

from .jobs_bench import GYRO_OFFSETS, SPEED, Session, eventually, session, stored, zero_gyro_offsets


@pytest.fixture(scope="module")
def sim() -> Iterator[SimulatedVehicle]:
    with SimulatedVehicle("ardupilot", speed=SPEED, seed=11, config={"thermal": False}) as vehicle:
        yield vehicle


@pytest.fixture(autouse=True)
def rested(sim: SimulatedVehicle) -> None:
    sim.call("clear_faults")
    sim.call("disarm")
    sim.call("still")
    zero_gyro_offsets(sim)


async def reviewed(bench: Session) -> str:
    job = await bench.engine.submit(bench.vehicle.id, "gyro", {"uncertainty": 0.02})
    job = await bench.until(job.id, JobState.REVIEW, JobState.FAILED)
    assert job.state == JobState.REVIEW, job.outcome
    return job.id


async def test_gyro_from_start_to_proof_and_back(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with session(tmp_path, sim.url) as bench:
        await bench.writable()
        before = stored(sim)
        job = bench.engine.get(await reviewed(bench))
        assert job.plan is not None
        assert {c.name for c in job.plan.changes} >= set(GYRO_OFFSETS)

        # The result is that of the closed segment: fitted again, the same digits.
        request = JobFitRequest(job.kind, job.options, job.segments, bench.vehicle.system, job.created_at)
        again = fit_segments(request).outcome
        assert [list(fit.values) for fit in again.results] == [list(fit.values) for fit in job.results]  # type: ignore[union-attr]

        truth = sim.truth()["gyros"]
        assert [fit.instance for fit in job.results] == [0, 1, 2]
        for fit in job.results:
            error = fit.model.offset - truth[fit.instance]["offset"]
            assert (abs(error) < 4.5 * fit.sd[:3]).all()

        await bench.accepted(job)
        job = await bench.until(job.id, JobState.SUCCEEDED, JobState.REVERTED)
        assert isinstance(job.outcome, Result), job.outcome
        assert job.verification is not None
        verdicts = {p.name: p.verdict for p in job.verification.parameters}
        assert all(verdicts[name] == ProofVerdict.PROVED for name in GYRO_OFFSETS), verdicts
        now = stored(sim)
        assert all(now[c.name] == c.new for c in job.plan.changes)

        await bench.engine.revert(job.id)
        job = await bench.until(job.id, JobState.REVERTED)
        assert stored(sim) == before

        # Nothing is left switched on that was off before.
        await eventually(lambda: not bench.engine._rates.tasks)
        assert bench.engine.book.handle(job.id).write_record().intervals == {}


async def test_accepted_but_not_applied_is_caught_and_taken_back(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with session(tmp_path, sim.url) as bench:
        await bench.writable()
        before = stored(sim)
        job_id = await reviewed(bench)
        sim.call("fault", kind="not_applied", name="INS_GYR2OFFS_Y")
        await bench.accepted(bench.engine.get(job_id))
        job = await bench.until(job_id, JobState.SUCCEEDED, JobState.REVERTED)
        assert job.state == JobState.REVERTED
        assert isinstance(job.outcome, Failure)
        assert "INS_GYR2OFFS_Y" in job.outcome.cause
        assert stored(sim) == before


async def test_armed_in_the_middle_stops_and_is_taken_back_after_disarming(
    tmp_path: Path, sim: SimulatedVehicle
) -> None:
    async with session(tmp_path, sim.url) as bench:
        await bench.writable()
        before = stored(sim)
        job_id = await reviewed(bench)
        sim.call("fault", kind="arm", trigger={"nth_set": 5})
        await bench.accepted(bench.engine.get(job_id))
        job = await bench.until(job_id, JobState.IN_DOUBT)
        sent = sim.state()["param_sets"]
        holds = stored(sim)
        for known in job.standing:
            assert holds[known.name] == known.value if known.certain else holds[known.name] in (known.old, known.new)
        with pytest.raises((PhysicalJobRunning, VehicleArmed)):
            await bench.engine.submit(bench.vehicle.id, "gyro")
        await eventually(lambda: bool(bench.vehicle.state.armed))
        assert sim.state()["param_sets"] == sent
        sim.call("disarm")
        job = await bench.until(job_id, JobState.REVERTED)
        assert stored(sim) == before


async def test_a_change_by_somebody_else_before_the_accept_is_plan_again(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with session(tmp_path, sim.url) as bench:
        await bench.writable()
        job = bench.engine.get(await reviewed(bench))
        sim.call("fault", kind="foreign_write", name="INS_ACCOFFS_X", value=0.25)
        assert job.plan is not None
        with pytest.raises(PlanChanged, match="INS_ACCOFFS_X"):
            await bench.engine.apply(job.id, Accept(job.plan.sha256))
        assert bench.engine.get(job.id).state == JobState.REVIEW
        again = await bench.engine.plan_again(job.id)
        assert again.plan is not None
        assert again.plan.sha256 != job.plan.sha256
        await bench.accepted(again)
        assert (await bench.until(job.id, JobState.SUCCEEDED, JobState.REVERTED)).state == JobState.SUCCEEDED


async def test_another_calibration_during_the_capture_ends_it_with_the_name(
    tmp_path: Path, sim: SimulatedVehicle
) -> None:
    async with session(tmp_path, sim.url) as bench:
        await bench.writable()
        job = await bench.engine.submit(bench.vehicle.id, "gyro", {"uncertainty": 0.001})
        await eventually(lambda: bench.engine.get(job.id).prompt is not None)
        before = stored(sim)["INS_ACCOFFS_Z"]
        sim.call("fault", kind="foreign_write", name="INS_ACCOFFS_Z", value=0.125)
        job = await bench.until(job.id, JobState.REVIEW, JobState.FAILED)
        sim.call("fault", kind="foreign_write", name="INS_ACCOFFS_Z", value=before)
        assert isinstance(job.outcome, Failure)
        assert "INS_ACCOFFS_Z changed from" in job.outcome.cause
        assert job.segments  # what was recorded is kept


async def test_a_gyro_offset_that_changes_during_the_capture_is_told_and_the_rest_begins_again(
    tmp_path: Path, sim: SimulatedVehicle
) -> None:
    async with session(tmp_path, sim.url) as bench:
        await bench.writable()
        job = await bench.engine.submit(bench.vehicle.id, "gyro", {"uncertainty": 0.001})
        await eventually(lambda: bench.engine.get(job.id).prompt is not None)
        sim.call("fault", kind="foreign_write", name="INS_GYROFFS_Z", value=0.125)
        job = await bench.until(job.id, JobState.REVIEW, JobState.FAILED)
        assert job.state == JobState.REVIEW
        (told,) = [text for text in job.warnings if "begins again" in text]
        assert told.startswith("INS_GYROFFS_Z changed from 0 to 0.125 during the capture, set by")
        assert job.plan is not None
        (change,) = [change for change in job.plan.changes if change.name == "INS_GYROFFS_Z"]
        assert change.old == 0.125
        assert abs(change.new - sim.truth()["gyros"][0]["offset"][2]) < 4.5 * 0.001 / 57.3


async def cancelled(bench: Session) -> float:
    """Begin a job and cancel it in its capture: how long that takes until the streams are as before, s."""
    job = await bench.engine.submit(bench.vehicle.id, "gyro", {"uncertainty": 0.001})
    with pytest.raises(PhysicalJobRunning):
        await bench.engine.submit(bench.vehicle.id, "gyro")
    await eventually(lambda: bench.engine.get(job.id).prompt is not None)
    changed = set(bench.engine.book.handle(job.id).write_record().intervals)
    assert changed
    loop_time = bench.vehicle.clock()
    job = await bench.engine.cancel(job.id)
    assert job.state == JobState.CANCELLED
    await eventually(lambda: not bench.engine.book.handle(job.id).write_record().intervals)
    took = bench.vehicle.clock() - loop_time
    await eventually(lambda: bool(bench.engine.get(job.id).segments))
    return took


async def test_cancel_is_quick_and_puts_the_streams_back(tmp_path: Path, sim: SimulatedVehicle) -> None:
    """A machine that stands still spoils one try of three."""
    async with session(tmp_path, sim.url) as bench:
        await bench.writable()
        took = [await cancelled(bench)]
        while took[-1] >= 1.0 and len(took) < 3:
            took.append(await cancelled(bench))
        assert took[-1] < 1.0, took
