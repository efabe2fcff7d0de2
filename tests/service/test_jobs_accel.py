from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from mavcal.calib.firmware.plan import ProofVerdict
from mavcal.calib.report import to_json
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.simvehicle import Operator, SimulatedVehicle
from tests.patience import scaled

from .jobs_bench import SPEED, Session, session


async def followed(bench: Session, job_id: str, operator: Operator, *states: JobState) -> None:
    """An operator who does what the prompts say until the job is in one of the states."""
    async with asyncio.timeout(scaled(90)):
        while bench.engine.get(job_id).state not in states:
            prompt = bench.engine.get(job_id).prompt
            if prompt is not None:
                await asyncio.to_thread(operator.follow, to_json(prompt))
            await asyncio.sleep(0.05)


@pytest.mark.long
async def test_accelerometers_are_calibrated_and_every_parameter_is_proved(tmp_path: Path) -> None:
    with SimulatedVehicle("ardupilot", speed=SPEED, seed=21, config={"thermal": False}) as sim:
        operator = Operator(sim)
        async with session(tmp_path, sim.url) as bench:
            await bench.writable()
            job = await bench.engine.submit(bench.vehicle.id, "accel")
            await followed(bench, job.id, operator, JobState.REVIEW, *ENDED)
            job = bench.engine.get(job.id)
            assert job.state == JobState.REVIEW, job.outcome
            for fit, truth in zip(job.results, sim.truth()["accels"], strict=True):
                error = fit.model.offset - np.array(truth["offset"])
                assert (np.abs(error) < 4.5 * fit.sd[:3]).all()

            operator.rest()
            await asyncio.to_thread(sim.wait, 5.0)
            await bench.accepted(job, prove_s=200.0)
            await followed(bench, job.id, operator, *ENDED)
            job = bench.engine.get(job.id)
            assert job.state == JobState.SUCCEEDED, job.outcome
            assert job.verification is not None
            scales = {p.name: p.verdict for p in job.verification.parameters if "SCAL" in p.name or "OFFS" in p.name}
            assert len(scales) == 18
            assert set(scales.values()) == {ProofVerdict.PROVED}, scales
