"""A calibration without hands, over a client that tells what a script says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavcal.calib.recording import Sensor
from mavcal.service.commands.hands_free import mended, outcome_text, wait_for_job
from mavcal.service.jobs.core.model import Failure, Result
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import of_service, plain
from tests.unit.commands.test_review import BLOCKED, CHANGE, LEFT, PLAN

NOW = replace(CHANGE, sensor=Sensor.GYRO, instance=0)
LATER = replace(CHANGE, sensor=Sensor.GYRO, instance=1, needs_reboot=True)
WRITTEN = Result("It is written.")


@pytest.fixture
def calibrate(make_service, screen):
    """Calibrates a gyro whose plan is this; what was asked of the service, and what came of it."""

    async def run(planned, written=WRITTEN, **more):
        service = make_service(plain("j", JobState.REVIEW, plan=planned, **more))
        service.jobs.planned = plain("j", JobState.REVIEW, plan=replace(planned, changes=(NOW,)))

        async def start_job(vehicle_id, *, kind):
            service.jobs.ask("start", vehicle_id, kind)
            return await service.get_job("j")

        async def apply_plan(job_id, **how):
            service.jobs.ask("apply", how)
            service.jobs.jobs[job_id] = plain("j", JobState.SUCCEEDED, outcome=written, **more)

        service.start_job, service.apply_plan = start_job, apply_plan
        return service.jobs.done, await mended(service, "v1", "gyro", screen, look=True)

    return run


async def test_a_plan_is_written_and_no_movement_is_waited_for(calibrate):
    done, came = await calibrate(PLAN)
    how = {"plan_sha256": PLAN.sha256, "prove_s": 0.0, "preflight": True}
    assert done == [("start", "v1", "gyro"), ("apply", how), ("wait_for_cleanup",)]
    assert (came.job.state, came.text, came.in_part) == (JobState.SUCCEEDED, "It is written.", False)


async def test_a_sensor_that_needs_a_restart_is_left_out_and_named(calibrate):
    done, came = await calibrate(replace(PLAN, changes=(NOW, LATER)), context={"plan_options": {"adjust_level": True}})
    assert done[1] == ("plan_again", "j", {"adjust_level": True, "only": ["gyro0"]})
    assert came.text == "It is written. gyro1 stays as it is: its change would act only after a restart."
    assert came.in_part


async def test_where_every_change_needs_a_restart_nothing_is_written(calibrate):
    done, came = await calibrate(replace(PLAN, changes=(LATER,)))
    assert [what for what, *_ in done] == ["start", "wait_for_cleanup"]
    assert came.text == "Nothing was written. gyro1 stays as it is: its change would act only after a restart."


async def test_a_plan_that_is_blocked_is_not_written(calibrate):
    done, came = await calibrate(BLOCKED)
    assert [what for what, *_ in done] == ["start", "wait_for_cleanup"]
    assert came.text == "not written: The offset is too large."


async def test_a_sensor_that_fell_out_makes_it_a_part(calibrate):
    _, came = await calibrate(PLAN, missed=LEFT)
    assert came.in_part


@pytest.mark.parametrize(
    ("job", "text"),
    [
        (plain("j", JobState.FAILED, outcome=Failure("x", "It moved", "hold it still")), "It moved. Hold it still."),
        (plain("j", JobState.IN_DOUBT), "the job is in_doubt"),
    ],
)
def test_what_came_of_it_is_said(job, text):
    assert outcome_text(of_service(job)) == text


@pytest.mark.parametrize(
    "state", [JobState.REVIEW, JobState.IN_DOUBT, JobState.WAITING_FOR_REBOOT, JobState.FAILED, JobState.SUCCEEDED]
)
async def test_a_job_is_settled_where_nothing_goes_on_by_itself(make_service, state):
    assert (await wait_for_job(make_service(plain("j", state)), "j")).state == state
