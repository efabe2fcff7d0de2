"""A job on its way through the store: nothing of it is lost, and what is missing has a value of its own."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib.firmware.plan import (
    Change,
    Fingerprint,
    LeftOut,
    Movement,
    ParameterKind,
    ParameterVerdict,
    ProofVerdict,
    SensorCheck,
    SensorCheckId,
    SensorVerdict,
    Verification,
    WritePlan,
)
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.protocol import Number, Pose, Progress, Prompt, PromptStep
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import TriadModel
from mavcal.service.jobs.core.codec import job_from_row, row_from_job, to_json
from mavcal.service.jobs.core.model import (
    Accept,
    Attempt,
    Failure,
    Holds,
    Job,
    LogSpan,
    Outcome,
    Result,
    Standing,
    Unwritten,
    WriteResult,
)
from mavcal.service.jobs.core.proof import ProofLevel, Unproved
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store.rows import JobRow

FINGERPRINT = Fingerprint("px4", "0002aa", "1.17.0", (("CAL_GYRO0_ID", 7), ("CAL_ACC0_ID", 8)))
PROMPT = Prompt(
    PromptStep.POSE, "Put it on its left side.",
    pose=Pose.LEFT, remaining=(Pose.LEFT, Pose.BACK), hold_s=2.0, rotate=True,
    direction=(0.0, 1.0, 0.0), temperature=25.0, detected=Pose.LEVEL, stable=True, answers=("finish",),
    axis=(0.0, 0.0, 1.0), turns=3.0, number=Number("rate", "deg/s", 1.0, 90.0),
)  # fmt: skip
PROGRESS = Progress(1.0, 6.0, "poses", "recording", eta=12.5, detail={"mask": 3})
RESULT = Result("It is written.", ProofLevel.PARTIAL, "Not all.", (Unproved("X", "consistent", "turn it"),))
UNWRITTEN = Unwritten("vehicle-armed", "the vehicle is armed", "Nothing was written.")
FAILURE = Failure("in-doubt", "the vehicle fell silent", "switch it on")
VERIFICATION = Verification(
    (ParameterVerdict("X", ProofVerdict.CONSISTENT, 0.5, 0.1, "rad/s", "says so", acts_on_stream=False),),
    Movement("Turn it.", ("left",), turn=True, temperature=20.0),
    (SensorCheck(SensorCheckId.GYRO_ZERO, Sensor.GYRO, 1, 0.1, 0.2, "rad/s", 0.01, SensorVerdict.RIGHT, "at rest"),),
    ("X",),
)


def fit() -> FitResult:
    model = TriadModel(offset=np.array([0.1, 0.2, 0.3]))
    return FitResult(
        "gyro-rest", Sensor.GYRO, 1, FitStatus.OK, "", model, np.eye(12), "rad/s", 5, 4, 1e-3, 1.0, temperature=30.0
    )


def full() -> Job:
    """A job with every field set to something that is not its default."""
    change = Change("X", 0.0, 0.5, ParameterKind.REAL32, "offset", sd=0.1, unit="rad/s", sensor=Sensor.GYRO)
    return Job(
        id="j1",
        vehicle_id="v1",
        kind="gyro",
        options={"uncertainty": 0.1},
        state=JobState.IN_DOUBT,
        created_at=1.5,
        updated_at=2.5,
        fingerprint=FINGERPRINT,
        progress=PROGRESS,
        prompt=PROMPT,
        outcome=FAILURE,
        results=(fit(),),
        plan=WritePlan(FINGERPRINT, "0" * 64, (change,), warnings=("careful",)),
        accept=Accept("1" * 64, reboot=True, prove_s=7.0, actor="somebody"),
        verification=VERIFICATION,
        segments=(LogSpan(Path("a.tlog"), 3, 9, "2" * 64),),
        standing=(Standing("X", 0.0, 0.5, 0.25, certain=True, note="set by hand", holds=Holds.OTHER),),
        last_write=Attempt(WriteResult.IN_DOUBT, 3.5, "it fell silent", "switch it on", 1),
        warnings=("a", "b"),
        missed=(LeftOut(Sensor.GYRO, 2, "it does not stream"),),
        context={"answers": [[1.5, "finish"]]},
    )


def through_json(job: Job) -> JobRow:
    row = row_from_job(job)
    return dataclasses.replace(row, body=json.loads(json.dumps(row.body)))


def test_every_field_of_a_job_comes_back_from_the_store() -> None:
    job = full()
    empty = Job("j1", "v1", "gyro", {}, JobState.QUEUED, 1.5, 2.5)
    for field in dataclasses.fields(Job):
        if field.name not in ("id", "vehicle_id", "kind", "created_at", "updated_at"):
            assert getattr(job, field.name) != getattr(empty, field.name), f"{field.name} proves nothing"
    back = job_from_row(through_json(job))
    (old,), (new,) = job.results, back.results
    assert (new.sensor, new.instance, new.temperature) == (Sensor.GYRO, 1, 30.0)
    assert np.array_equal(new.model.offset, old.model.offset)
    assert dataclasses.replace(back, results=()) == dataclasses.replace(job, results=())


def test_a_job_of_which_nothing_is_known_yet_comes_back_so() -> None:
    job = Job("j1", "v1", "gyro", {}, JobState.QUEUED, 1.5, 2.5)
    assert job_from_row(through_json(job)) == job


@pytest.mark.parametrize("outcome", [RESULT, FAILURE, UNWRITTEN, Result("Nothing to write."), None])
def test_an_outcome_comes_back_with_what_the_stream_proves(outcome: Outcome | None) -> None:
    assert job_from_row(through_json(dataclasses.replace(full(), outcome=outcome))).outcome == outcome


@pytest.mark.parametrize(("field", "wrong"), [("progress", "prompt"), ("prompt", "progress")])
def test_a_step_of_another_kind_is_no_prompt_and_no_progress(field: str, wrong: str) -> None:
    row = through_json(full())
    body = {**row.body, field: row.body[wrong]}
    assert getattr(job_from_row(dataclasses.replace(row, body=body)), field) is None


def test_an_outcome_is_told_with_its_kind_and_its_proof() -> None:
    assert to_json(None) is None
    assert to_json(RESULT) == {
        "kind": "result",
        "text": "It is written.",
        "proof": "partial",
        "proof_reason": "Not all.",
        "unproved": [{"name": "X", "verdict": "consistent", "why": "turn it"}],
    }
    assert to_json(FAILURE) == {
        "kind": "failure",
        "code": "in-doubt",
        "cause": "the vehicle fell silent.",
        "remedy": "Switch it on.",
        "proof": "none",
        "proof_reason": "the vehicle fell silent.",
        "unproved": [],
    }
    told = to_json(UNWRITTEN)
    assert told is not None
    assert (told["kind"], told["cause"], told["remedy"]) == (
        "write_failed",
        "the vehicle is armed.",
        "Nothing was written.",
    )


def test_an_attempt_is_told_as_plain_data() -> None:
    assert to_json(None) is None
    told = to_json(full().last_write)
    assert told == {
        "result": "in_doubt", "at": 3.5, "cause": "it fell silent", "remedy": "switch it on", "sent": 1
    }  # fmt: skip


def old_row(drop: dict[str, tuple[str, ...]]) -> JobRow:
    """The row of an older version, which did not know some fields."""
    row = through_json(dataclasses.replace(full(), outcome=RESULT))
    body: dict[str, Any] = {**row.body}
    for part, names in drop.items():
        known = body[part]
        items = known if isinstance(known, list) else [known]
        kept = [{key: value for key, value in item.items() if key not in names} for item in items]
        body[part] = kept if isinstance(known, list) else kept[0]
    return dataclasses.replace(row, body=body)


def test_what_an_older_version_did_not_keep_is_unknown() -> None:
    row = old_row({"standing": ("holds",), "outcome": ("proof", "proof_reason", "unproved")})
    row = dataclasses.replace(row, body={key: value for key, value in row.body.items() if key != "last_write"})
    job = job_from_row(row)
    assert job.standing[0].holds == Holds.UNKNOWN
    assert job.outcome == Result("It is written.", ProofLevel.NONE, "", ())
    assert job.last_write is None
