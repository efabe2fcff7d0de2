"""What a sentence of a job tells somebody to do is possible: each is done in every state that prints it."""

from __future__ import annotations

import ast
import re
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from mavcal.service.jobs.core.model import Accept, Failure, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.jobs.engine import JobEngine
from mavcal.service.jobs.write.outcome import reverted
from tests.unit.jobs.conftest import OLD
from tests.unit.jobs.fakes import FakeVehicle
from tests.unit.jobs.test_engine import reviewed, running

ROOT = Path(__file__).resolve().parents[3]
ADVICE = re.compile(
    r"plan again|apply the plan again|start (?:the job|a new job|again)|can be fitted later|`mavcal \w+",
    re.IGNORECASE,
)
Do = Callable[[JobEngine, Job], Awaitable[object]]


async def start(engine: JobEngine, job: Job) -> object:
    assert job.vehicle_id is not None
    return await engine.submit(job.vehicle_id, job.kind)


async def plan(engine: JobEngine, job: Job) -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mavcal.service.jobs.calibrate.without_capture.compose_plan", _same_plan(job))
        return await engine.plan_again(job.id)


def _same_plan(job: Job) -> Callable[..., Awaitable[object]]:
    from mavcal.calib.recording import Identity
    from mavcal.service.jobs.calibrate.planning import Planned

    async def composed(*_: object) -> object:
        assert job.plan is not None
        return Identity("ardupilot"), Planned(job.plan, dict(OLD))

    return composed


async def apply(engine: JobEngine, job: Job) -> object:
    assert job.plan is not None
    return await engine.apply(job.id, Accept(job.plan.sha256))


async def refit(engine: JobEngine, job: Job) -> object:
    return await engine.refit(job.id)


R, F, N, V = JobState.REVIEW, JobState.FAILED, JobState.INTERRUPTED, JobState.REVERTED
PLACES: dict[str, tuple[tuple[Do, tuple[JobState, ...]], ...]] = {
    # file: what its sentences advise, and the states in which they are read
    "service/jobs/write/outcome.py": ((start, (V,)), (apply, (R,))),
    "service/jobs/write/accept.py": ((apply, (R,)),),
    "service/jobs/calibrate/digest.py": ((start, (F,)),),
    "service/jobs/core/parameters.py": ((start, (R,)),),
    "service/jobs/calibrate/planning.py": ((start, (F,)),),
    "service/jobs/core/codec.py": ((start, (F,)),),
    "service/jobs/calibrate/runner.py": ((start, (F, N)), (refit, (N,))),
    "service/jobs/write/transaction.py": ((apply, (R,)),),
    "service/jobs/calibrate/watch.py": ((start, (F, N)),),
    "service/jobs/write/steps.py": ((plan, (R,)),),
    "service/errors/jobs.py": ((plan, (R,)),),
    "calib/procedures/intake.py": ((start, (F,)),),
}
NAMES_A_COMMAND = {"service/campaigns/campaigns.py"}
"""Tried on the command line (tests/service/test_campaigns_killed.py)."""


def texts(tree: ast.AST) -> Iterator[str]:
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


def test_every_place_that_advises_is_tried_here() -> None:
    found = set()
    for folder in ("service/jobs", "service/campaigns", "service/errors", "calib/procedures"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if any(ADVICE.search(text) for text in texts(ast.parse(path.read_text(encoding="utf-8")))):
                found.add(str(path.relative_to(ROOT)))
    procedures = {name for name in found if name.startswith("calib/procedures/")}  # a job that gave up has failed
    assert found - procedures <= set(PLACES) | NAMES_A_COMMAND


CASES = sorted({(do.__name__, state) for tries in PLACES.values() for do, states in tries for state in states})


@pytest.mark.parametrize(("name", "state"), CASES)
async def test_what_is_advised_is_accepted(name: str, state: JobState) -> None:
    do: Do = {"start": start, "plan": plan, "apply": apply, "refit": refit}[name]
    vehicle = FakeVehicle.with_floats(OLD)
    outcome = None if state == JobState.REVIEW else Failure("x", "why", "what helps")
    job = replace(reviewed(vehicle), state=state, outcome=outcome)
    async with running(vehicle, job) as engine:
        await do(engine, engine.get(job.id))  # raises where it is refused


def test_a_write_that_was_taken_back_advises_what_its_job_can_do() -> None:
    """Its plan cannot be made again: only a job in review is planned again."""
    told = reverted((), "the read-back differs", "somebody else", 3).outcome
    assert isinstance(told, Failure)
    assert told.remedy.endswith("Start a new job.")
    assert "lan again" not in told.remedy
