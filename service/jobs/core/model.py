"""A job as a frozen value, and the only function that changes its state."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

from mavcal.calib.firmware.plan import Fingerprint, LeftOut, Value, Verification, WritePlan
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.protocol import Progress, Prompt
from mavcal.calib.procedures.registry import specification
from mavcal.service.errors import IllegalTransition
from mavcal.service.jobs.core.proof import ProofLevel, Unproved
from mavcal.service.jobs.core.states import JobState, may_follow

FROM_RECORDING = "recording"
"""Kind of a job that fits an uploaded recording and plans for a vehicle."""
RESTORE = "restore"
"""Kind of a job that plans to put the last verified calibration back; it has no fits."""


@dataclass(frozen=True)
class Result:
    """The job reached its goal; `text` says what was reached, `proof` how far the stream shows it."""

    text: str
    proof: ProofLevel = ProofLevel.NONE
    proof_reason: str = ""
    unproved: tuple[Unproved, ...] = ()
    """Parameters that no stream has proved, and sensors that could not be seen to read right."""


@dataclass(frozen=True)
class Failure:
    """The job did not reach its goal: why, and what helps."""

    code: str
    cause: str
    remedy: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "cause", _stopped(self.cause))  # mostly follows a colon, and may begin lower-case
        object.__setattr__(self, "remedy", _stopped(self.remedy[:1].upper() + self.remedy[1:]))

    @classmethod
    def of(cls, error: Exception, remedy: str) -> Self:
        """The failure that an error of the service or of a calculation stands for."""
        return cls(str(getattr(error, "code", "calibration-error")), str(error), remedy)


@dataclass(frozen=True)
class Unwritten(Failure):
    """An accepted plan could not be written: nothing was sent, and the job is in review again."""


def _stopped(text: str) -> str:
    """`text` with a full stop, so that another sentence can follow."""
    return text if not text or text[-1] in ".!?" else f"{text}."


Outcome = Result | Failure


@dataclass(frozen=True)
class LogSpan:
    """A closed span of a telemetry log."""

    path: Path
    start_byte: int
    end_byte: int
    sha256: str


class Holds(StrEnum):
    """Which value a parameter holds."""

    OLD = "old"
    NEW = "new"
    OTHER = "other"  # neither: somebody else's, or the vehicle's own
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Standing:
    """What is known of one parameter that a job has written or may have written."""

    name: str
    old: Value | None
    """The value before the write, in the unit of the parameter; None: not known."""
    new: Value
    """The value that was to be written, in the same unit."""
    value: Value | None
    """The last value heard, in the same unit; None: none since the last PARAM_SET left."""
    certain: bool  # if not, `note` says why; without a note it holds `old` or `new`
    """False: it may have changed since."""
    note: str = ""
    holds: Holds = Holds.UNKNOWN


class WriteResult(StrEnum):
    """Result of the last attempt to write."""

    RUNNING = "running"
    FAILED = "failed"  # before anything was sent: the job is in review again
    IN_DOUBT = "in_doubt"
    REVERTED = "reverted"
    SUCCEEDED = "succeeded"


@dataclass(frozen=True)
class Attempt:
    """The last attempt to write a job's plan; the event `write` carries the same when it ends."""

    result: WriteResult
    """Failed: nothing was sent, and the job is in review again."""
    at: float
    """Wall-clock time, s since 1970."""
    cause: str = ""
    remedy: str = ""
    sent: int = 0
    """Parameters for which a PARAM_SET may have left."""


@dataclass(frozen=True)
class Accept:
    """What the operator agreed to."""

    plan_sha256: str
    reboot: bool = False
    """Restart the vehicle where the plan needs it; otherwise the operator is asked to."""
    prove_s: float = 120.0
    """How long to wait for the movements that prove the rest, in seconds of the vehicle's clock; 0: not at all."""
    actor: str = "operator"


@dataclass(frozen=True)
class Job:
    """One calibration of one vehicle, or one computation on uploads. Times are wall-clock seconds since 1970.

    `results` and `plan` exist from ``review`` on; `verification` from the end of ``verifying`` on; `standing` lists
    parameters whose state is in doubt or was left to a third party; `last_write` is the last attempt to write, also of
    a job that is in review again because nothing could be sent.
    """

    id: str
    vehicle_id: str | None
    """None: the job needs no vehicle."""
    kind: str
    options: Mapping[str, Any]
    state: JobState
    created_at: float
    updated_at: float
    fingerprint: Fingerprint | None = None
    progress: Progress | None = None
    prompt: Prompt | None = None
    outcome: Outcome | None = None
    results: tuple[FitResult, ...] = ()
    plan: WritePlan | None = None
    accept: Accept | None = None
    verification: Verification | None = None
    segments: tuple[LogSpan, ...] = ()
    standing: tuple[Standing, ...] = ()
    last_write: Attempt | None = None
    warnings: tuple[str, ...] = ()
    missed: tuple[LeftOut, ...] = ()
    """Sensors that could not take part in the capture, also those that only help; what the plan leaves out is in the
    plan."""
    context: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    """What a re-fit needs besides the segment: instances, answers with their times; what else was found (JSON-able)."""

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Every sensor that was asked for and gets no new calibration, or only a part of it; each once."""
        planned = () if self.plan is None else self.plan.left_out
        once = {(out.sensor, out.instance): out for out in (*planned, *self._missed(asked=True))}
        return tuple(once[key] for key in sorted(once))

    @property
    def broken(self) -> tuple[LeftOut, ...]:
        """Sensors that fell out though this kind of job only needs their help: the result is whole without them."""
        return tuple(sorted(self._missed(asked=False), key=lambda out: (out.sensor, out.instance)))

    def _missed(self, *, asked: bool) -> tuple[LeftOut, ...]:
        calibrated = specification(self.kind).calibrated if self.missed else frozenset()
        return tuple(out for out in self.missed if (out.sensor in calibrated) == asked)


def fit_messages(fits: Iterable[FitResult]) -> tuple[str, ...]:
    """Messages of refused fits, then warnings of all fits, each once."""
    fits = tuple(fits)
    refused = [fit.message for fit in fits if fit.status == FitStatus.REFUSED]
    return tuple(dict.fromkeys((*refused, *(warning for fit in fits for warning in fit.warnings))))


def cancelled(job: Job) -> Failure:
    """The outcome of a job that the operator cancelled before any write."""
    kept = " Nothing was written: the parameters of the vehicle are as they were." if job.vehicle_id else ""
    return Failure("cancelled", f"The operator cancelled it.{kept}", "")


def advance(job: Job, to: JobState, at: float, **changes: Any) -> Job:
    """The job in state `to`; the only function that changes a state.

    Raises
    ------
    IllegalTransition
        If the table has no such step.
    """
    if not may_follow(job.state, to):
        raise IllegalTransition(f"job {job.id} is {job.state}: it cannot become {to}")
    return dataclasses.replace(job, state=to, updated_at=max(at, job.updated_at), **changes)
