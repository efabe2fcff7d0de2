"""mavcal as its users start it: a service on loopback, jobs through its client, commands through its command line."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field
from typing import Any

from mavcal.client import ApiProblem, Client, Unreachable
from mavcal.client.enums import JobState
from mavcal.client.events import PromptEvent, StateEvent
from mavcal.client.jobs import JobModel, PromptModel, ResultModel
from mavcal.service.demo.run import ENDED
from mavcal.service.lifetime import ending_with_us
from mavcal.service.simvehicle import Operator

START_S, READY_S = 120.0, 60.0
PROVE_S = 180.0
COMMAND_S = 600.0


class MavcalError(Exception):
    """The service or a job did not do what the round needs."""


@dataclass
class Done:
    """One job as it ended."""

    job: JobModel
    seconds: float
    sentences: list[str] = field(default_factory=list)
    """What it said while it went on: notes, warnings, its end."""

    @property
    def said(self) -> str:
        """Its last sentence."""
        outcome = self.job.outcome
        if outcome is None:
            return ""
        return outcome.text if isinstance(outcome, ResultModel) else f"{outcome.cause} {outcome.remedy}".strip()


def vehicle_of(client: Client) -> str:
    """The vehicle, as soon as it is heard and known. Raises MavcalError."""
    until = time.monotonic() + START_S
    while time.monotonic() < until:
        vehicles = [v for v in client.list_vehicles() if not v.silent and v.autopilot is not None]
        if len(vehicles) > 1:
            raise MavcalError(f"one vehicle is listed {len(vehicles)} times: {[v.id for v in vehicles]}")
        if vehicles:
            return vehicles[0].id
        time.sleep(0.2)
    raise MavcalError(f"no vehicle was heard within {START_S:g} s")


def calibrated(client: Client, operator: Operator, kind: str, options: Mapping[str, Any], **decisions: Any) -> Done:
    """One job to its end: captured with a willing operator, accepted, written and proved."""
    began = time.monotonic()
    vehicle = vehicle_of(client)
    decided = decisions or None
    job = _patiently(lambda: client.start_job(vehicle, kind=kind, options=dict(options), plan_options=decided))
    done = Done(job, 0.0)
    state = _followed(client, operator, job.id, {JobState.REVIEW} | ENDED, done, from_review=False)
    job = client.get_job(job.id)
    operator.rest()
    if state is JobState.REVIEW and job.plan is not None and job.plan.changes and not job.plan.blockers:
        digest = job.plan.sha256
        _patiently(lambda: client.apply_plan(job.id, plan_sha256=digest, reboot=True, prove_s=PROVE_S))
        _followed(client, operator, job.id, ENDED, done, from_review=True)
        operator.rest()
    done.job, done.seconds = client.get_job(job.id), time.monotonic() - began
    return done


def command(*arguments: str) -> tuple[int, dict[str, Any], str]:
    """Exit code, JSON and messages of one command."""
    run = subprocess.run(
        [sys.executable, "-m", "mavcal", *arguments, "--json"],
        capture_output=True,
        text=True,
        timeout=COMMAND_S,
        env=ending_with_us(),
        check=False,
    )
    try:
        document = json.loads(run.stdout)
    except ValueError:
        document = {}
    return run.returncode, document, run.stderr


def _followed(
    client: Client, operator: Operator, job_id: str, until: Set[JobState], done: Done, *, from_review: bool
) -> JobState:
    left_review = not from_review
    try:
        for message in client.follow_job(job_id):
            event = message.data
            if isinstance(event, PromptEvent) and isinstance(event.data, PromptModel) and left_review:
                done.sentences.append(event.data.text)
                operator.follow(event.data.model_dump(mode="json"))
            elif isinstance(event, StateEvent):
                left_review = left_review or event.data.state is JobState.APPLYING
                if left_review and event.data.state in until:
                    return event.data.state
                if left_review and from_review and event.data.state is JobState.REVIEW:
                    return event.data.state
            elif (text := getattr(event.data, "text", None)) is not None:
                done.sentences.append(text)
    except Unreachable as error:
        raise MavcalError(f"the events of job {job_id} ended early: {error}") from error
    raise MavcalError(f"the events of job {job_id} ended early")


def _patiently(ask: Callable[[], JobModel]) -> JobModel:
    """The answer; asked again for a minute while the vehicle is not ready for it."""
    until = time.monotonic() + READY_S
    while True:
        try:
            return ask()
        except ApiProblem:
            if time.monotonic() > until:
                raise
        time.sleep(1.0)
