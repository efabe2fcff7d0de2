"""Jobs that need an operator's movement, end to end: the prompts alone tell the operator what to do.

A bias wanders, and at this speed a second of waiting is most of a minute to it: the truth is asked as a capture begins.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.firmware.plan import ProofVerdict
from mavcal.calib.fit import FitResult
from mavcal.calib.report import to_json
from mavcal.service.jobs.calibrate.digest import JobFitRequest, fit_segments
from mavcal.service.jobs.core.model import Job
from mavcal.service.jobs.core.states import ENDED, JobState
from mavcal.service.simvehicle import Operator, SimulatedVehicle
from tests.patience import scaled

from .jobs_bench import Session, session

SPEED = 40.0
BARE = {"thermal": False, "imu_count": 1, "mag_count": 1}
LEVEL = np.array([0.0, 0.0, -9.80665])
QUIET = {"ardupilot": {}, "px4": {"IMU_GYRO_CAL_EN": 0, "SENS_BOARD_X_OFF": 0.0, "SENS_BOARD_Y_OFF": 0.0}}
"""PX4 would change its gyro offsets in the middle of a capture, which is refused then. A fixture holds the board of the
simulated vehicle itself, so a trim that turned the body against it would be untrue."""


@pytest.fixture(scope="module", params=["ardupilot", "px4"])
def sim(request: pytest.FixtureRequest) -> Iterator[SimulatedVehicle]:
    config = {**BARE, "parameters": QUIET[request.param]}
    with SimulatedVehicle(request.param, speed=SPEED, seed=41, config=config) as vehicle:
        yield vehicle


async def captured(bench: Session, kind: str, operator: Operator, **options: Any) -> Job:
    """The job with its plan, led there by an operator who sees nothing but its prompts.

    It is in review, or has ended because the vehicle holds these values already: its gyro since it started, its
    accelerometer since a test before this one wrote it.
    """
    operator.rest()  # a test before this one may have left it turning
    job = await bench.engine.submit(bench.vehicle.id, kind, options)
    answered = None
    async with asyncio.timeout(scaled(90)):
        while (job := bench.engine.get(job.id)).state not in {JobState.REVIEW, *ENDED}:
            if job.prompt is not None:
                asked = to_json(job.prompt)
                await asyncio.to_thread(operator.follow, asked)
                value = operator.answer(asked)
                if value is not None and answered != asked:
                    answered = asked
                    await bench.engine.answer(job.id, value)
            await asyncio.sleep(0.03)
    assert job.state == JobState.REVIEW or (job.plan is not None and job.plan.nothing_to_write), job.outcome
    return job


def again(bench: Session, job: Job) -> list[list[float]]:
    """The numbers of the closed segments, fitted once more."""
    answers = tuple((float(t), str(v)) for t, v in job.context.get("answers", ()))
    request = JobFitRequest(job.kind, job.options, job.segments, bench.vehicle.system, job.created_at, answers)
    return [list(fit.values) for fit in fit_segments(request).outcome.results]  # type: ignore[union-attr]


def within(fit: FitResult, truth: dict[str, Any], *, sd: float = 4.5) -> None:
    """Offset and matrix are the simulator's truth within their stated uncertainty."""
    correction = np.linalg.inv(np.array(truth["matrix"]))
    error = fit.values - np.concatenate([truth["offset"], correction.ravel()])
    known = fit.sd > 0.0
    assert known[:3].all()
    assert (np.abs(error[known]) < sd * fit.sd[known]).all(), (error / np.where(known, fit.sd, np.inf)).round(1)


@pytest.mark.long
async def test_accelerometer_on_one_axis(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with session(tmp_path, sim.url) as bench:
        truth = sim.truth()["accels"][0]
        job = await captured(bench, "accel-one-axis", Operator(sim), fixture_sd=0.0)
        (fit,) = job.results
        read = np.array(truth["offset"]) + np.array(truth["matrix"]) @ LEVEL
        assert (np.abs(fit.model.apply(read) - LEVEL) < 4.5 * fit.sd[:3]).all()
        assert again(bench, job) == [list(fit.values)]
        assert job.plan is not None
        assert not job.plan.blockers


@pytest.mark.sampled
async def test_accelerometer_on_six_faces_is_written_and_checked(tmp_path: Path, sim: SimulatedVehicle) -> None:
    operator = Operator(sim)
    async with session(tmp_path, sim.url) as bench:
        truth = sim.truth()["accels"][0]
        job = await captured(bench, "accel-six-face", operator, fixture_sd=0.0)
        (fit,) = job.results
        within(fit, truth)
        assert again(bench, job) == [list(fit.values)]
        assert job.plan is not None
        assert {"cross terms", "mounting"} <= {loss.what for loss in job.plan.losses}
        operator.rest()
        await bench.writable()
        job = await bench.accepted(job)
        job = await bench.until(job.id, *ENDED)
        assert job.state == JobState.SUCCEEDED, job.outcome
        assert job.verification is not None
        assert ProofVerdict.CONTRADICTED not in {p.verdict for p in job.verification.parameters}


@pytest.mark.long
async def test_compasses_by_six_rings(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with session(tmp_path, sim.url) as bench:
        job = await captured(bench, "mag-rings", Operator(sim, turntable_dps=60.0), fixture_sd=0.0)
        (fit,) = job.results
        within(fit, sim.truth()["mags"][0])
        assert again(bench, job) == [list(fit.values)]
        assert fit.quality["orientation"]["verdict"] == "as_stated"
        assert job.plan is not None
        assert not job.plan.blockers
        assert {"COMPASS_OFS_X", "CAL_MAG0_XOFF"} & {c.name for c in job.plan.changes}


@pytest.mark.long
async def test_gyro_on_a_turntable_whose_rate_is_answered(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with session(tmp_path, sim.url) as bench:
        truth = sim.truth()["gyros"][0]
        job = await captured(bench, "gyro-turntable", Operator(sim, turntable_dps=90.0))
        assert [value for _, value in job.context["answers"]] == ["90.0"]
        (fit,) = job.results
        within(fit, truth)
        assert again(bench, job) == [list(fit.values)]
        assert job.plan is not None
        (loss,) = (x for x in job.plan.losses if x.what == "scale and misalignment")
        assert loss.cost == pytest.approx(np.linalg.norm(np.linalg.inv(fit.model.matrix) - np.eye(3), 2), rel=0.01)


@pytest.mark.long
async def test_gyro_on_a_thread_counted_by_the_compass(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with session(tmp_path, sim.url) as bench:
        truth = sim.truth()["gyros"][0]
        job = await captured(bench, "gyro-thread", Operator(sim, turntable_dps=90.0), turns=3)
        (fit,) = job.results
        assert (np.abs(fit.model.offset - truth["offset"]) < 4.5 * fit.sd[:3]).all()
        scale = np.linalg.inv(np.array(truth["matrix"]))[2, 2]
        assert abs(fit.model.matrix[2, 2] - scale) < 4.5 * fit.sd[11]
        assert not fit.determined("matrix_xx")
        assert again(bench, job) == [list(fit.values)]
        assert job.plan is not None
        assert "scale and misalignment" in {loss.what for loss in job.plan.losses}


@pytest.mark.long
async def test_accelerometer_and_gyro_from_poses_and_movements(tmp_path: Path, sim: SimulatedVehicle) -> None:
    async with session(tmp_path, sim.url) as bench:
        truth = sim.truth()
        job = await captured(bench, "imu-multi", Operator(sim))
        accel, gyro = job.results
        assert (np.abs(accel.model.offset - truth["accels"][0]["offset"]) < 4.5 * accel.sd[:3]).all()
        assert (np.abs(gyro.model.offset - truth["gyros"][0]["offset"]) < 4.5 * gyro.sd[:3]).all()
        scale = np.diag(np.linalg.inv(np.array(truth["gyros"][0]["matrix"])))
        assert (np.abs(np.diag(gyro.model.matrix) - scale) < 4.5 * gyro.sd[[3, 7, 11]]).all()
        assert again(bench, job) == [list(accel.values), list(gyro.values)]
        assert job.plan is not None
        assert {"scale and misalignment", "cross terms"} <= {loss.what for loss in job.plan.losses}


@pytest.mark.long
async def test_without_a_compass_the_turns_are_asked_for(tmp_path: Path) -> None:
    config = {**BARE, "mag_count": 0, "parameters": QUIET["px4"]}
    with SimulatedVehicle("px4", speed=SPEED, seed=46, config=config) as sim:
        async with session(tmp_path, sim.url) as bench:
            operator = Operator(sim, turntable_dps=90.0)
            job = await captured(bench, "gyro-thread", operator, turns=4, angle_sd=0.5)
            assert [value for _, value in job.context["answers"]] == ["4.0"]
            (fit,) = job.results
            scale = np.linalg.inv(np.array(sim.truth()["gyros"][0]["matrix"]))[2, 2]
            assert abs(fit.model.matrix[2, 2] - scale) < 4.5 * fit.sd[11]
            assert again(bench, job) == [list(fit.values)]


@pytest.mark.long
async def test_a_compass_at_one_heading_is_written(tmp_path: Path, sim: SimulatedVehicle) -> None:
    """A vehicle that cannot be turned: where it stands, the corrected compass reads the field of the place."""
    operator = Operator(sim)
    operator.rest()
    async with session(tmp_path, sim.url) as bench:
        body_from_ned = Rotation.from_quat(sim.call("state")["quaternion"], scalar_first=True).inv()
        heading = float(np.degrees(body_from_ned.inv().as_euler("ZYX")[0])) % 360.0
        job = await captured(bench, "mag-fixed-yaw", operator, heading=heading, heading_sd=0.5)
        (fit,) = job.results
        truth = sim.truth()["mags"][0]
        field = body_from_ned.apply(sim.truth()["field_ned_ut"])
        read = np.array(truth["offset"]) + np.array(truth["matrix"]) @ field
        assert np.linalg.norm(fit.model.apply(read) - field) < 2.0
        assert again(bench, job) == [list(fit.values)]
        await bench.writable()
        job = await bench.until((await bench.accepted(job)).id, *ENDED)
        assert job.state == JobState.SUCCEEDED, job.outcome
