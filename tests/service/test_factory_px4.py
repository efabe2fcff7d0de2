"""Jobs on a PX4 as it comes from the factory: it gives its gyro a row and rewrites its offsets by itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.simvehicle import SimulatedVehicle

from .jobs_bench import SPEED, session

FACTORY = {"CAL_GYRO0_ID": 0, "CAL_GYRO0_PRIO": -1, "IMU_GYRO_CAL_EN": 1}
HELD = {"CAL_GYRO0_PRIO": -1, "IMU_GYRO_CAL_EN": 1}


@pytest.mark.long
@pytest.mark.parametrize("parameters", [FACTORY, HELD], ids=["no row", "no priority"])
async def test_the_gyro_job_begins_again_when_px4_fills_the_row_late(
    tmp_path: Path, parameters: dict[str, int]
) -> None:
    """The vehicle is moved until the job runs, so that PX4's own estimate comes in the middle of the capture."""
    config = {"imu_count": 1, "parameters": parameters, "boot_s": 0.1}
    with SimulatedVehicle("px4", speed=SPEED, seed=4, config=config) as sim:
        sim.call("turn", axis=[0, 1, 0], rate_dps=40.0)
        async with session(tmp_path, sim.url) as bench:
            await bench.writable()
            job = await bench.engine.submit(bench.vehicle.id, "gyro", {"uncertainty": 0.003})
            sim.call("still")
            found: Job = await bench.until(job.id, JobState.REVIEW, JobState.SUCCEEDED, JobState.FAILED)
            assert found.state != JobState.FAILED, found.outcome
            truth = sim.truth()["gyros"]
            (fit,) = found.results
            assert np.all(np.abs(fit.model.offset - truth[0]["offset"]) < 4.5 * fit.sd[:3])
