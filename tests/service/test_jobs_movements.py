"""Jobs that need an operator's movement, end to end: the prompts alone tell the operator what to do."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.firmware.plan import Verdict
from calib.fit import FitResult
from calib.report import step_to_json
from service.jobs.digest import FitRequest, fit_segments
from service.jobs.model import Job
from service.jobs.states import ENDED, JobState
from service.simvehicle.client import SimulatedVehicle
from service.simvehicle.operator import Operator

from .jobs_bench import Session, session

SPEED = 20.0
BARE = {"thermal": False, "imu_count": 1, "mag_count": 1}


async def captured(bench: Session, kind: str, operator: Operator, **options: Any) -> Job:
    """The job in review, led there by an operator who sees nothing but its prompts."""
    job = await bench.engine.submit(bench.vehicle.id, kind, options)
    answered = None
    async with asyncio.timeout(90):
        while (job := bench.engine.get(job.id)).state not in {JobState.REVIEW, *ENDED}:
            if job.prompt is not None:
                asked = step_to_json(job.prompt)
                await asyncio.to_thread(operator.follow, asked)
                value = operator.answer(asked)
                if value is not None and answered != asked:
                    answered = asked
                    await bench.engine.answer(job.id, value)
            await asyncio.sleep(0.03)
    assert job.state == JobState.REVIEW, job.outcome
    return job


def again(bench: Session, job: Job) -> list[list[float]]:
    """The numbers of the closed segments, fitted once more."""
    answers = tuple((float(t), str(v)) for t, v in job.context.get("answers", ()))
    request = FitRequest(job.kind, job.options, job.segments, bench.vehicle.system, job.created_at, answers)
    return [list(fit.values) for fit in fit_segments(request).outcome.results]  # type: ignore[union-attr]


def within(fit: FitResult, truth: dict[str, Any], *, sd: float = 4.5) -> None:
    """Offset and matrix are the simulator's truth within their stated uncertainty."""
    correction = np.linalg.inv(np.array(truth["matrix"]))
    error = fit.values - np.concatenate([truth["offset"], correction.ravel()])
    known = fit.sd > 0.0
    assert known[:3].all()
    assert (np.abs(error[known]) < sd * fit.sd[known]).all(), (error / np.where(known, fit.sd, np.inf)).round(1)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_accelerometer_on_one_axis(tmp_path: Path, autopilot: str) -> None:
    with SimulatedVehicle(autopilot, speed=SPEED, seed=41, config=BARE) as sim:
        async with session(tmp_path, sim.url) as bench:
            await bench.writable()
            job = await captured(bench, "accel-one-axis", Operator(sim), fixture_sd=0.0)
            (fit,) = job.results
            truth = sim.truth()["accels"][0]
            read = np.array(truth["offset"]) + np.array(truth["matrix"]) @ [0.0, 0.0, -9.80665]
            assert (np.abs(fit.model.apply(read) - [0.0, 0.0, -9.80665]) < 4.5 * fit.sd[:3]).all()
            assert again(bench, job) == [list(fit.values)]
            assert job.plan is not None
            assert not job.plan.blockers
            job = await bench.accepted(job)
            job = await bench.until(job.id, *ENDED)
            assert job.state == JobState.SUCCEEDED, job.outcome


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
async def test_accelerometer_on_six_faces_of_a_fixture(tmp_path: Path, autopilot: str) -> None:
    with SimulatedVehicle(autopilot, speed=SPEED, seed=42, config=BARE) as sim:
        operator = Operator(sim)
        async with session(tmp_path, sim.url) as bench:
            await bench.writable()
            job = await captured(bench, "accel-six-face", operator, fixture_sd=0.0)
            (fit,) = job.results
            within(fit, sim.truth()["accels"][0])
            assert again(bench, job) == [list(fit.values)]
            assert job.plan is not None
            lost = {loss.what: loss for loss in job.plan.losses}
            assert any("cross terms" in what for what in lost)
            assert all(loss.cost > 0.0 for loss in lost.values())
            operator.rest()
            await asyncio.sleep(0.2)
            job = await bench.accepted(job)
            job = await bench.until(job.id, *ENDED)
            assert job.state == JobState.SUCCEEDED, job.outcome
            assert job.verification is not None
            assert Verdict.CONTRADICTED not in {p.verdict for p in job.verification.parameters}
