"""What stands in the way of a job, of an accept, and which request is the same."""

from __future__ import annotations

import dataclasses

import pytest

from mavcal.service.errors import (
    IllegalTransition,
    PhysicalJobRunning,
    PlanBlocked,
    PlanChanged,
    PlanMissing,
    VehicleArmed,
    VehicleBusy,
    VehicleConflict,
    VehicleSilent,
)
from mavcal.service.jobs.core.admission import require_free, require_ready
from mavcal.service.jobs.core.model import Accept, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.write.accept import request_digest, require_acceptable
from tests.unit.jobs.conftest import OLD, make_plan
from tests.unit.jobs.fakes import FakeVehicle

PLAN = make_plan(FakeVehicle.with_floats(OLD))
JOB = Job("j1", "v1", "gyro", {}, JobState.REVIEW, 0.0, 0.0, plan=PLAN)


def vehicle(**state: object) -> FakeVehicle:
    found = FakeVehicle({})
    found.change_state(**state)
    return found


def test_a_vehicle_at_rest_is_ready() -> None:
    require_ready(vehicle())


@pytest.mark.parametrize(
    ("state", "error"),
    [
        ({"silent": True, "armed": True}, VehicleSilent),
        ({"armed": True}, VehicleArmed),
        ({"conflict": "two of them"}, VehicleConflict),
        ({"calibrating": True}, VehicleBusy),
    ],
)
def test_each_obstacle_is_told_by_its_own_error(state: dict[str, object], error: type[Exception]) -> None:
    with pytest.raises(error):
        require_ready(vehicle(**state))


def test_a_calibration_of_its_own_is_no_obstacle_where_it_is_waited_for() -> None:
    require_ready(vehicle(calibrating=True), busy=True)
    with pytest.raises(VehicleArmed):
        require_ready(vehicle(calibrating=True, armed=True), busy=True)


@pytest.mark.parametrize("state", [JobState.RUNNING, JobState.APPLYING, JobState.IN_DOUBT])
def test_one_physical_job_at_a_time(state: JobState) -> None:
    job = dataclasses.replace(JOB, state=state)
    with pytest.raises(PhysicalJobRunning, match="j1"):
        require_free("v1", [job])
    require_free("v2", [job])
    require_free("v1", [job], besides="j1")


def test_a_job_in_doubt_says_what_to_do_and_another_what_runs() -> None:
    with pytest.raises(PhysicalJobRunning, match="Disarm it and keep it on the ground"):
        require_free("v1", [dataclasses.replace(JOB, state=JobState.IN_DOUBT)])
    with pytest.raises(PhysicalJobRunning, match=r"Job j1 \(gyro\) is running on this vehicle"):
        require_free("v1", [dataclasses.replace(JOB, state=JobState.RUNNING)])


def test_jobs_that_claim_no_vehicle_do_not_hide_one_that_does() -> None:
    ended = [dataclasses.replace(JOB, id=f"e{k}", state=s) for k, s in enumerate((JobState.REVIEW, JobState.SUCCEEDED))]
    require_free("v1", ended)
    with pytest.raises(PhysicalJobRunning):
        require_free("v1", [*ended, dataclasses.replace(JOB, vehicle_id="v2"), _running()])


def _running() -> Job:
    return dataclasses.replace(JOB, state=JobState.RUNNING)


def test_only_the_plan_that_was_looked_at_may_be_accepted() -> None:
    require_acceptable(JOB, Accept(PLAN.sha256))
    with pytest.raises(PlanChanged):
        require_acceptable(JOB, Accept("0" * 64))
    with pytest.raises(PlanMissing):
        require_acceptable(dataclasses.replace(JOB, plan=None), Accept(PLAN.sha256))
    with pytest.raises(IllegalTransition, match="is running: only a job in review"):
        require_acceptable(_running(), Accept(PLAN.sha256))


def test_a_plan_that_is_blocked_or_empty_may_not() -> None:
    blocked = dataclasses.replace(PLAN, blockers=("too large",))
    with pytest.raises(PlanBlocked, match="too large"):
        require_acceptable(dataclasses.replace(JOB, plan=blocked), Accept(blocked.sha256))
    empty = dataclasses.replace(PLAN, changes=())
    with pytest.raises(PlanBlocked, match="nothing to write"):
        require_acceptable(dataclasses.replace(JOB, plan=empty), Accept(empty.sha256))


def test_a_request_is_the_same_only_if_everything_it_asks_is() -> None:
    asked = Accept("a", reboot=True, prove_s=5.0)
    assert request_digest("j1", asked) == request_digest("j1", dataclasses.replace(asked, actor="another"))
    others = [Accept("b", reboot=True, prove_s=5.0), Accept("a", prove_s=5.0), Accept("a", reboot=True, prove_s=6.0)]
    assert len({request_digest("j1", one) for one in (asked, *others)} | {request_digest("j2", asked)}) == 5
