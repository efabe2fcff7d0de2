"""Contents of event streams: a message has the name of its event, and an event of a job has a kind."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field
from typing_extensions import TypeAliasType

from mavcal.service.api.models.jobs import OutcomeModel, VehicleReadinessModel, WriteModel
from mavcal.service.api.models.steps import ProgressModel, PromptModel
from mavcal.service.api.models.vehicles import LinkModel, VehicleModel
from mavcal.service.api.models.wire import Stamp
from mavcal.service.campaigns.items import ItemOutcome
from mavcal.service.jobs.core.proof import ProofLevel
from mavcal.service.jobs.core.states import JobState


class _Event(BaseModel):
    job_id: str
    sequence: int = Field(description="number among the events of this job, from 1")
    at: Stamp


class Nothing(BaseModel):
    """An empty object."""

    model_config = ConfigDict(extra="forbid")


class StateData(BaseModel):
    """The state that a job has come to."""

    state: JobState
    outcome: OutcomeModel | None


class StateEvent(_Event):
    """The job has come to another state."""

    kind: Literal["state"]
    data: StateData


class PromptEvent(_Event):
    """The operator is asked to do something else, or nothing more."""

    kind: Literal["prompt"]
    data: PromptModel | Nothing = Field(description="an empty object: nothing is asked any more")


class ProgressEvent(_Event):
    """How far the job is."""

    kind: Literal["progress"]
    data: ProgressModel


class AnswerData(BaseModel):
    """What was answered."""

    value: str


class AnswerEvent(_Event):
    """The operator answered a prompt."""

    kind: Literal["answer"]
    data: AnswerData


class WarningData(BaseModel):
    """A warning."""

    text: str


class WarningEvent(_Event):
    """The job has one warning more."""

    kind: Literal["warning"]
    data: WarningData


class SegmentsEvent(_Event):
    """The recording of the job is closed."""

    kind: Literal["segments"]
    data: Nothing


class SetAsideData(BaseModel):
    """What was set aside."""

    segments: int = Field(description="spans of the recording")


class SetAsideEvent(_Event):
    """What was recorded so far is not used: the vehicle was disturbed, and the capture begins again."""

    kind: Literal["set_aside"]
    data: SetAsideData


class VehicleData(BaseModel):
    """Whose job it is."""

    id: str


class JobVehicleEvent(_Event):
    """The vehicle of an interrupted write, which has no unique id, is heard on another link and named by that."""

    kind: Literal["vehicle"]
    data: VehicleData


class PlanData(BaseModel):
    """The new plan."""

    sha256: str


class PlanEvent(_Event):
    """The job was planned again."""

    kind: Literal["plan"]
    data: PlanData


class WriteEvent(_Event):
    """A write has ended."""

    kind: Literal["write"]
    data: WriteModel


class VerificationData(BaseModel):
    """What the stream has proved."""

    proved: bool
    proof: ProofLevel


class VerificationEvent(_Event):
    """The stream was checked after the write."""

    kind: Literal["verification"]
    data: VerificationData


class StandingData(BaseModel):
    """Why it is not certain."""

    note: str


class StandingEvent(_Event):
    """What was known of the parameters of an interrupted write is not certain any more."""

    kind: Literal["standing"]
    data: StandingData


class ReadinessEvent(_Event):
    """The vehicle was looked at after a write."""

    kind: Literal["readiness"]
    data: VehicleReadinessModel


class ItemData(BaseModel):
    """What became of an item."""

    number: int = Field(description="its place in the campaign, from 1")
    subject: str = Field(description="id of the vehicle or upload, or the file")
    outcome: ItemOutcome
    code: str
    text: str
    job_id: str | None = Field(description="the job that was begun for it")


class ItemEvent(_Event):
    """An item of the campaign has ended."""

    kind: Literal["item"]
    data: ItemData


JobEvent = TypeAliasType(
    "JobEvent",
    Annotated[
        StateEvent
        | PromptEvent
        | ProgressEvent
        | AnswerEvent
        | WarningEvent
        | SegmentsEvent
        | SetAsideEvent
        | JobVehicleEvent
        | PlanEvent
        | WriteEvent
        | VerificationEvent
        | StandingEvent
        | ReadinessEvent
        | ItemEvent,
        Field(discriminator="kind"),
    ],
)
"""An event of a job."""


class JobMessage(BaseModel):
    """Something happened to a job. `id` continues the stream: it is sent again as `Last-Event-ID`."""

    event: Literal["job"]
    id: str
    data: JobEvent


class VehicleMessage(BaseModel):
    """The present state of a vehicle."""

    event: Literal["vehicle"]
    data: VehicleModel


class LinkMessage(BaseModel):
    """The present state of a link."""

    event: Literal["link"]
    data: LinkModel


Message = TypeAliasType("Message", Annotated[JobMessage | VehicleMessage | LinkMessage, Field(discriminator="event")])
"""A message of the stream of everything."""
