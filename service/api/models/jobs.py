"""Jobs: requests, states and outcomes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field
from typing_extensions import TypeAliasType

from mavcal.calib.preflight.check import Readiness
from mavcal.service.api.models.fits import FitModel
from mavcal.service.api.models.plans import LeftOutModel, PlanModel, PlanOptions, VerificationModel
from mavcal.service.api.models.steps import ProgressModel, PromptModel
from mavcal.service.api.models.wire import Json, Request, Stamp, Wire
from mavcal.service.jobs.core.model import Attempt, Standing
from mavcal.service.jobs.core.proof import ProofLevel
from mavcal.service.jobs.core.states import JobState


class JobRequest(Request):
    """Start a calibration."""

    kind: str = Field(description="a kind of `/procedures`, such as gyro, accel or mag-rings", examples=["gyro"])
    options: dict[str, float | bool] = Field(default_factory=dict, description="options of that procedure")
    plan_options: PlanOptions = Field(default_factory=PlanOptions, description="options of the plan")


class AnswerRequest(Request):
    """Answer the prompt of a job."""

    value: str = Field(description="one of the answers that the prompt offers", examples=["finish"])


class UnprovedModel(BaseModel):
    """A parameter that no stream has proved, or a sensor that could not be seen to read right with the new values."""

    # An Unproved whose verdicts are listed.
    name: str
    verdict: Literal["consistent", "not_observable", "contradicted", "wrong"]
    why: str


class _Proof(BaseModel):
    proof: ProofLevel = Field(description="how much of what shows on a stream the stream has proved after the write")
    proof_reason: str
    unproved: list[UnprovedModel]


class ResultModel(_Proof):
    """The job reached its goal."""

    # A Result with its kind.
    kind: Literal["result"]
    text: str


class FailureModel(_Proof):
    """The job did not reach its goal."""

    # A Failure with its kind and its proof, which is none.
    kind: Literal["failure"]
    code: str
    cause: str
    remedy: str


class WriteFailedModel(_Proof):
    """The plan that was accepted could not be written. Nothing was sent, and the job is in review again."""

    # An Unwritten with its kind and its proof, which is none.
    kind: Literal["write_failed"]
    code: str
    cause: str
    remedy: str


OutcomeModel = TypeAliasType(
    "OutcomeModel", Annotated[ResultModel | FailureModel | WriteFailedModel, Field(discriminator="kind")]
)
StandingModel = Annotated[Standing, Wire("StandingModel", not_finite=("new",))]
WriteModel = Annotated[Attempt, Wire("WriteModel")]
VehicleReadinessModel = Annotated[Readiness, Wire("VehicleReadinessModel")]


class SegmentModel(BaseModel):
    """A span of a telemetry log."""

    # A LogSpan without the folder of its log.
    path: str = Field(description="name of the log")
    start_byte: int = Field(description="first byte in the log, from 0")
    end_byte: int = Field(description="the byte behind the last one")
    sha256: str = Field(description="digest of these bytes")


class DocumentModel(BaseModel):
    """A file that a job has made."""

    name: str = Field(examples=["report.json", "report.html"])
    href: str = Field(description="its address, relative to the root of the service")


class JobSummary(BaseModel):
    """A job in a list."""

    # A Job without its results, with its address.
    id: str
    href: str = Field(description="its address, relative to the root of the service")
    vehicle_id: str | None = Field(description="null: the job computes something of uploads and needs no vehicle")
    kind: str
    state: JobState
    created_at: Stamp
    updated_at: Stamp
    progress: ProgressModel | None
    prompt: PromptModel | None = Field(description="what the operator is asked to do; null: nothing now")
    outcome: OutcomeModel | None = Field(
        description="null while the job goes on, and while a plan waits that was not tried yet"
    )
    left_out: list[LeftOutModel] = Field(
        description="sensors that were asked for and get no new calibration, or only a part of it; not empty: the job "
        "is done in part"
    )
    broken: list[LeftOutModel] = Field(
        description="sensors that fell out and that this kind of job does not calibrate; its own result is whole"
    )
    last_write: WriteModel | None = Field(description="null: nothing was accepted yet")
    options: Json = Field(description="options of the procedure or method, and what an upload adds")


class JobModel(JobSummary):
    """A job with its results."""

    plan_options: Json = Field(description="what the operator decided about the plan: given fields of PlanOptions")
    warnings: list[str]
    results: list[FitModel] = Field(description="one fit a sensor instance, as in `mavcal fit --json`")
    plan: PlanModel | None
    verification: VerificationModel | None
    readiness: VehicleReadinessModel | None = Field(
        description="would the vehicle arm now; null until it was looked at after a write that succeeded"
    )
    standing: list[StandingModel] = Field(
        description="parameters in doubt (all that were sent, or may have been), or left to a third party"
    )
    documents: list[DocumentModel] = Field(description="what the job has made beside its results")
    segments: list[SegmentModel] = Field(description="what the fit was made of")


class UnfinishedModel(BaseModel):
    """A job that claims its vehicle, and what is known of the parameters that it has sent."""

    job: JobSummary
    at: Stamp = Field(description="when this state was read; earlier events belong to the run that is over")
    writing: bool = Field(description="parameters of the vehicle may be this job's")
    ended: bool = Field(description="nothing of it is in doubt any more")
    sent: list[str] = Field(description="parameters for which a PARAM_SET may have left")
    standing: list[StandingModel] = Field(description="what is known of each of them")
    beginning: str = Field(description="what is going to happen to it")
    ending: list[str] = Field(description="how it ended, or what is in doubt, a sentence each")
