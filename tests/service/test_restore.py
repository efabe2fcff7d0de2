"""What a firmware change has taken away is put back over a real link, and the vehicle would arm again."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavcal.calib.preflight.check import CheckId, Verdict
from mavcal.service.errors import NothingVerified
from mavcal.service.jobs.core.model import Accept
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.readiness import readiness_of
from mavcal.service.simvehicle import SimulatedVehicle
from tests.patience import scaled

from .jobs_bench import eventually, stored
from .test_preflight import failed, looked_at, remember, reset, vehicle

ENDS = (JobState.SUCCEEDED, JobState.REVERTED, JobState.REVIEW, JobState.IN_DOUBT, JobState.FAILED)


@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_a_calibration_that_was_reset_is_put_back(autopilot: str, tmp_path: Path) -> None:
    with vehicle(autopilot) as sim:
        async with looked_at(tmp_path, sim) as life:
            with pytest.raises(NothingVerified):
                await life.engine.restore(life.vehicle.id)
            await remember(life)
            await eventually(lambda: (life.vehicle.state.boot_time or 0.0) > 12.0)
            before = stored(sim)
            reset(sim)
            for name in before:
                if name.startswith("CAL_") and name.endswith("_ID"):
                    sim.call("fault", kind="foreign_write", name=name, value=0.0)
            report = (await life.engine.preflight(life.vehicle.id)).report
            assert failed(report) == [CheckId.PARAMETERS_CHANGED]
            await life.writable()
            job = await life.engine.restore(life.vehicle.id)
            job = await life.until(job.id, *ENDS)
            assert job.state == JobState.REVIEW, job.outcome
            assert job.plan is not None
            await life.engine.apply(job.id, Accept(job.plan.sha256, prove_s=0.0, reboot=True), look=True)
            job = await life.until(job.id, *ENDS)
            assert job.state == JobState.SUCCEEDED, job.outcome
            await life.engine.wait_for_cleanup()
            found = readiness_of(life.engine.get(job.id))
            assert found is not None
            assert (found.verdict, found.text) == (Verdict.PASS, "All 16 checks pass: this vehicle would arm now."), (
                found.against
            )
            assert stored(sim) == before
            again = await life.until((await life.engine.restore(life.vehicle.id)).id, *ENDS)
            assert again.state == JobState.SUCCEEDED
            assert again.accept is None  # nothing to write


async def test_it_is_never_for_another_unit(tmp_path: Path) -> None:
    with vehicle("ardupilot") as sim:
        async with looked_at(tmp_path, sim) as life:
            await remember(life)
    with SimulatedVehicle("ardupilot", seed=6, speed=2.0, config={"calibration": "fresh"}) as other:
        before = stored(other)
        async with looked_at(tmp_path, other) as life:
            with pytest.raises(NothingVerified, match="never restored to another unit"):
                await life.engine.restore(life.vehicle.id)
        assert stored(other) == before


@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_a_verdict_within_ten_seconds_on_a_link_that_loses_every_third_message(
    autopilot: str, tmp_path: Path
) -> None:
    with vehicle(autopilot) as sim:
        async with looked_at(tmp_path, sim) as life:
            await remember(life)
            await eventually(lambda: (life.vehicle.state.boot_time or 0.0) > 8.0)
            sim.call("fault", kind="loss", p=0.3)
            found = await life.engine.preflight(life.vehicle.id)
            sim.call("clear_faults")
            assert failed(found.report) == []
            assert found.seconds < scaled(10.0), found.notes
            assert found.report.check(CheckId.GYRO_REST).verdict == Verdict.PASS
