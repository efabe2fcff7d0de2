from __future__ import annotations

import pytest

from mavcal.calib.firmware.plan import (
    ParameterVerdict,
    ProofVerdict,
    SensorCheck,
    SensorCheckId,
    SensorVerdict,
    Verification,
)
from mavcal.calib.recording import Sensor
from mavcal.service.api.views import job_model
from mavcal.service.commands.review import good as is_good
from mavcal.service.jobs.core.codec import job_from_row, row_from_job
from mavcal.service.jobs.core.model import Attempt, Failure, Job, Outcome, Result, WriteResult
from mavcal.service.jobs.core.proof import ProofLevel, Unproved, proof_of
from mavcal.service.jobs.core.states import JobState
from tests.unit.commands.doubles import of_service

P, C, N = ProofVerdict.PROVED, ProofVerdict.CONSISTENT, ProofVerdict.NOT_OBSERVABLE


def checked(*verdicts: ProofVerdict, silent: int = 0) -> Verification:
    acting = [ParameterVerdict(f"A{i}", v, 1.0, 0.1, "", f"because {v}") for i, v in enumerate(verdicts)]
    flags = [ParameterVerdict(f"F{i}", N, 0.0, 0.0, "", "a flag", acts_on_stream=False) for i in range(silent)]
    return Verification((*acting, *flags))


@pytest.mark.parametrize(
    ("verification", "level", "reason", "unproved"),
    [
        (None, "none", "No stream was checked after the write.", ""),
        (checked(silent=2), "none", "No stream can prove the written parameters; all were read back.", ""),
        (checked(P, P, silent=2), "full", "The stream proves all 2 parameters that act on it.", ""),
        (
            checked(P, C, N, N),
            "partial",
            "The stream proves 1 of the 4 parameters that act on it; 1 agree with it, as their old values would, "
            "2 could not be seen in it.",
            "A1 A2 A3",
        ),
        (
            checked(N, N),
            "none",
            "The stream proves none of the 2 parameters that act on it; 2 could not be seen in it.",
            "A0 A1",
        ),
    ],
)
def test_how_far_a_write_is_proved(verification: Verification | None, level: str, reason: str, unproved: str) -> None:
    proof = proof_of(verification)
    assert (proof.level, proof.reason) == (level, reason)
    assert " ".join(u.name for u in proof.unproved) == unproved
    assert all(u.why.startswith("because") for u in proof.unproved)


def test_a_sensor_that_was_not_seen_to_read_right_leaves_the_proof_open() -> None:
    def gyro(verdict: SensorVerdict) -> SensorCheck:
        return SensorCheck(
            SensorCheckId.GYRO_ZERO, Sensor.GYRO, 1, None, None, "rad/s", None, verdict, "it was never at rest"
        )

    right = Verification(checked(P).parameters, sensors=(gyro(SensorVerdict.RIGHT),))
    assert proof_of(right).level == ProofLevel.FULL
    unseen = proof_of(Verification(checked(P).parameters, sensors=(gyro(SensorVerdict.NOT_OBSERVABLE),)))
    assert unseen.level == ProofLevel.PARTIAL
    assert "1 sensor reading could not be checked" in unseen.reason
    assert unseen.unproved == (Unproved("gyro_zero 2", "not_observable", "it was never at rest"),)


def job(state: JobState, outcome: Outcome | None) -> Job:
    attempt = Attempt(WriteResult.SUCCEEDED, 2.0, "why", "what helps", 3)
    return Job("j1", "v1", "gyro", {}, state, 1.0, 2.0, outcome=outcome, last_write=attempt)


FULL = Result("Written.", ProofLevel.FULL, "All of it.")
PART = Result("Written.", ProofLevel.PARTIAL, "1 of 2.", (Unproved("A", "consistent", "both agree"),))


@pytest.mark.parametrize("outcome", [FULL, PART, Failure("reverted", "No effect.", "Plan again."), None])
def test_the_proof_survives_the_store_and_goes_over_http(outcome: Outcome | None) -> None:
    before = job(JobState.SUCCEEDED, outcome)
    assert job_from_row(row_from_job(before)) == before
    told = job_model(before).model_dump(mode="json")
    assert told["last_write"] == {"result": "succeeded", "at": 2.0, "cause": "why", "remedy": "what helps", "sent": 3}
    if outcome is None:
        assert told["outcome"] is None
    else:
        assert told["outcome"]["proof"] == (outcome.proof if isinstance(outcome, Result) else "none")
        assert told["outcome"]["unproved"] == [vars(u) for u in getattr(outcome, "unproved", ())]


@pytest.mark.parametrize(
    ("state", "outcome", "write", "require", "good"),
    [
        (JobState.SUCCEEDED, FULL, True, True, True),
        (JobState.SUCCEEDED, PART, True, True, False),
        (JobState.SUCCEEDED, PART, True, False, True),
        (JobState.REVERTED, Result("Back.", ProofLevel.FULL), True, True, False),
        (JobState.REVIEW, None, False, False, True),
        (JobState.REVIEW, None, True, False, False),
    ],
)
def test_what_the_command_line_calls_good(
    state: JobState, outcome: Outcome | None, write: bool, require: bool, good: bool
) -> None:
    assert is_good(of_service(job(state, outcome)), write, require) == good
