"""Calibrations without hands: run, written, and what stays out because nobody is there."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from mavcal.calib.firmware.plan import Change, ParameterKind, WritePlan
from mavcal.calib.recording import Sensor
from mavcal.service import fixing
from mavcal.service.fixing import Fixable, fixed, wait_for_job
from mavcal.service.jobs.core.model import Accept, Failure, Job, Result
from mavcal.service.jobs.core.states import JobState
from tests.unit.api.samples import FINGERPRINT

FIRST = Change("A", 0.0, 1.0, ParameterKind.REAL32, "", sensor=Sensor.GYRO, instance=0)
SECOND = replace(FIRST, name="B", instance=1)
LATE = replace(SECOND, needs_reboot=True)


def plan(*changes: Change, **more: Any) -> WritePlan:
    return WritePlan(FINGERPRINT, "0" * 64, changes, **more)


@dataclass
class Engine:
    """Each job ends its capture as `came` says, by kind; its write ends as `writes` say."""

    came: dict[str, Job]
    writes: JobState = JobState.SUCCEEDED
    jobs: dict[str, Job] = field(default_factory=dict)
    done: list[tuple[Any, ...]] = field(default_factory=list)

    async def submit(self, vehicle_id: str, kind: str) -> Job:
        self.done.append(("submit", vehicle_id, kind))
        self.jobs[kind] = replace(self.came[kind], id=kind)
        return self.jobs[kind]

    def get(self, job_id: str) -> Job:
        return self.jobs[job_id]

    async def plan_again(self, job_id: str, options: Mapping[str, Any]) -> Job:
        self.done.append(("plan_again", job_id, dict(options)))
        old = self.jobs[job_id]
        assert old.plan is not None
        kept = tuple(c for c in old.plan.changes if f"{c.sensor}{c.instance}" in options["only"])
        self.jobs[job_id] = replace(old, plan=replace(old.plan, changes=kept))
        return self.jobs[job_id]

    async def apply(self, job_id: str, accept: Accept) -> None:
        self.done.append(("apply", job_id, accept))
        failure = Failure("in-doubt", "It fell silent", "switch it on")
        outcome = Result("It is written.") if self.writes is JobState.SUCCEEDED else failure
        self.jobs[job_id] = replace(self.jobs[job_id], state=self.writes, outcome=outcome)

    async def wait_for_cleanup(self) -> None:
        self.done.append(("wait_for_cleanup",))


def job(state: JobState = JobState.REVIEW, **more: Any) -> Job:
    return Job("", "v1", "gyro", {}, state, 0.0, 0.0, **more)


async def fix(engine: Engine, *kinds: str, **more: Any) -> tuple[Any, ...]:
    return await fixed(engine, "v1", [Fixable(kind) for kind in kinds], actor="me", **more)  # type: ignore[arg-type]


def names(engine: Engine) -> list[str]:
    return [what for what, *_ in engine.done]


async def test_a_plan_is_written_for_whom_asked_and_no_movement_is_waited_for() -> None:
    engine = Engine({"gyro": job(plan=plan(FIRST))})
    [done] = await fix(engine, "gyro")
    assert (done.kind, done.job_id, done.state, done.text) == (
        Fixable.GYRO,
        "gyro",
        JobState.SUCCEEDED,
        "It is written.",
    )
    accept = Accept(plan(FIRST).sha256, prove_s=0.0, actor="me")
    assert engine.done == [("submit", "v1", "gyro"), ("apply", "gyro", accept), ("wait_for_cleanup",)]


async def test_each_kind_is_done_once_and_the_first_that_fails_is_the_last() -> None:
    good = job(plan=plan(FIRST))
    engine = Engine({"gyro": good, "level": good})
    assert [f.kind for f in await fix(engine, "level", "gyro", "level")] == [Fixable.LEVEL, Fixable.GYRO]
    failed = job(JobState.FAILED, outcome=Failure("x", "It moved", "hold it still"))
    engine = Engine({"gyro": failed, "level": good})
    [only] = await fix(engine, "gyro", "level")
    assert (only.state, only.text) == (JobState.FAILED, "It moved. Hold it still.")
    assert names(engine) == ["submit", "wait_for_cleanup"]


async def test_a_write_that_goes_wrong_is_told() -> None:
    engine = Engine({"gyro": job(plan=plan(FIRST))}, writes=JobState.IN_DOUBT)
    [only] = await fix(engine, "gyro")
    failure = engine.get("gyro").outcome
    assert isinstance(failure, Failure)
    assert only.state == JobState.IN_DOUBT
    assert failure.cause in only.text
    assert failure.remedy in only.text


async def test_a_plan_that_is_blocked_is_not_written() -> None:
    engine = Engine({"gyro": job(plan=plan(FIRST, blockers=("It is armed.", "It flies.")))})
    [only] = await fix(engine, "gyro")
    assert (only.state, only.text) == (JobState.REVIEW, "not written: It is armed.; It flies.")
    assert "apply" not in names(engine)


async def test_a_sensor_whose_change_acts_after_a_restart_alone_is_left_out_and_named() -> None:
    engine = Engine({"gyro": job(plan=plan(FIRST, LATE), context={"plan_options": {"adjust_level": True}})})
    [done] = await fix(engine, "gyro")
    assert engine.done[1] == ("plan_again", "gyro", {"adjust_level": True, "only": ["gyro0"]})
    assert done.text == "It is written. gyro1 stays as it is: its change would act only after a restart."


async def test_where_every_change_needs_a_restart_nothing_is_written() -> None:
    engine = Engine({"gyro": job(plan=plan(replace(FIRST, needs_reboot=True), LATE))})
    [done] = await fix(engine, "gyro")
    assert names(engine) == ["submit", "wait_for_cleanup"]
    assert done.text == (
        "Nothing was written. gyro0, gyro1 stay as they are: their change would act only after a restart."
    )


async def test_a_plan_without_a_restart_is_not_made_again() -> None:
    engine = Engine({"gyro": job(plan=plan(FIRST, SECOND))})
    await fix(engine, "gyro")
    assert names(engine) == ["submit", "apply", "wait_for_cleanup"]


@pytest.mark.parametrize(
    "state", [JobState.REVIEW, JobState.IN_DOUBT, JobState.WAITING_FOR_REBOOT, JobState.FAILED, JobState.SUCCEEDED]
)
async def test_a_job_has_settled_when_it_does_not_go_on_by_itself(
    monkeypatch: pytest.MonkeyPatch, state: JobState
) -> None:
    monkeypatch.setattr(fixing, "_LOOK_S", 0.0)
    engine = Engine({}, jobs={"j": job(JobState.RUNNING)})
    waiting = asyncio.ensure_future(wait_for_job(engine, "j"))  # type: ignore[arg-type]
    for running in (JobState.RUNNING, JobState.FITTING, JobState.APPLYING, JobState.VERIFYING):
        engine.jobs["j"] = job(running)
        for _ in range(3):
            await asyncio.sleep(0)
        assert not waiting.done()
    engine.jobs["j"] = job(state)
    assert (await waiting).state is state


async def test_a_job_that_never_settles_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fixing, "WAIT_S", 0.0)
    with pytest.raises(TimeoutError):
        await wait_for_job(Engine({}, jobs={"j": job(JobState.RUNNING)}), "j")  # type: ignore[arg-type]
