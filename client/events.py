"""What the event streams carry."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from mavcal.client.base import Answer, Number
from mavcal.client.enums import ItemOutcome, JobState, LiveState, ProofLevel, Sensor
from mavcal.client.jobs import OutcomeModel, ProgressModel, PromptModel, VehicleReadinessModel, WriteModel
from mavcal.client.models import LinkModel, VehicleModel


class AnswerData(Answer):
    """What was answered."""

    value: str


class AnyJobEvent(Answer):
    """What every JobEvent has."""

    job_id: str
    sequence: int
    """Number among the events of this job, from 1."""
    at: Number
    """Wall-clock time, s since 1970."""


class AnswerEvent(AnyJobEvent):
    """The operator answered a prompt."""

    kind: Literal["answer"]
    data: AnswerData


class ItemData(Answer):
    """What became of an item."""

    number: int
    """Its place in the campaign, from 1."""
    subject: str
    """Id of the vehicle or upload, or the file."""
    outcome: ItemOutcome
    code: str
    text: str
    job_id: str | None
    """The job that was begun for it."""


class ItemEvent(AnyJobEvent):
    """An item of the campaign has ended."""

    kind: Literal["item"]
    data: ItemData


class StateData(Answer):
    """The state that a job has come to."""

    state: JobState
    outcome: OutcomeModel | None


class StateEvent(AnyJobEvent):
    """The job has come to another state."""

    kind: Literal["state"]
    data: StateData


class Nothing(Answer):
    """An empty object."""


class PromptEvent(AnyJobEvent):
    """The operator is asked to do something else, or nothing more."""

    kind: Literal["prompt"]
    data: PromptModel | Nothing
    """An empty object: nothing is asked any more."""


class ProgressEvent(AnyJobEvent):
    """How far the job is."""

    kind: Literal["progress"]
    data: ProgressModel


class WarningData(Answer):
    """A warning."""

    text: str


class WarningEvent(AnyJobEvent):
    """The job has one warning more."""

    kind: Literal["warning"]
    data: WarningData


class SegmentsEvent(AnyJobEvent):
    """The recording of the job is closed."""

    kind: Literal["segments"]
    data: Nothing


class SetAsideData(Answer):
    """What was set aside."""

    segments: int
    """Spans of the recording."""


class SetAsideEvent(AnyJobEvent):
    """What was recorded so far is not used: the vehicle was disturbed, and the capture begins again."""

    kind: Literal["set_aside"]
    data: SetAsideData


class VehicleData(Answer):
    """Whose job it is."""

    id: str


class JobVehicleEvent(AnyJobEvent):
    """The vehicle of an interrupted write, which has no unique id, is heard on another link and named by that."""

    kind: Literal["vehicle"]
    data: VehicleData


class PlanData(Answer):
    """The new plan."""

    sha256: str


class PlanEvent(AnyJobEvent):
    """The job was planned again."""

    kind: Literal["plan"]
    data: PlanData


class WriteEvent(AnyJobEvent):
    """A write has ended."""

    kind: Literal["write"]
    data: WriteModel


class VerificationData(Answer):
    """What the stream has proved."""

    proved: bool
    proof: ProofLevel


class VerificationEvent(AnyJobEvent):
    """The stream was checked after the write."""

    kind: Literal["verification"]
    data: VerificationData


class StandingData(Answer):
    """Why it is not certain."""

    note: str


class StandingEvent(AnyJobEvent):
    """What was known of the parameters of an interrupted write is not certain any more."""

    kind: Literal["standing"]
    data: StandingData


class ReadinessEvent(AnyJobEvent):
    """The vehicle was looked at after a write."""

    kind: Literal["readiness"]
    data: VehicleReadinessModel


JobEvent = Annotated[
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
]
"""One of JobEvent."""


class JobMessage(Answer):
    """Something happened to a job. `id` continues the stream: it is sent again as `Last-Event-ID`."""

    event: Literal["job"]
    id: str
    data: JobEvent


class LinkMessage(Answer):
    """The present state of a link."""

    event: Literal["link"]
    data: LinkModel


class SamplesModel(Answer):
    """New samples of one sensor."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    unit: str
    source: str
    """The message that carries it."""
    t: list[Number]
    """The vehicle's clock, s."""
    values: list[list[Number | None]]
    """A column an axis, in `unit`; null: not a finite number."""


class WatchStatusModel(Answer):
    """How it stands with the rates that a watch wishes for."""

    state: LiveState
    text: str
    """Why samples wait, or come slower than requested; empty: they come as requested."""
    rate_hz: Number
    """The fastest rate that anybody who watches this vehicle has requested, Hz."""


class LiveModel(Answer):
    """Samples since the last message."""

    channels: list[SamplesModel]
    """As they are streamed; one a sensor and instance."""
    bare: list[SamplesModel]
    """Compasses without the calibration in force, where that is known."""
    attitude: list[Number] | None
    """Quaternion w x y z, body (front right down) to north-east-down; null: none has come."""
    model_field_ut: Number | None
    """Strength of the Earth's field by the World Magnetic Model, uT; null: the position is not known."""
    loss: Number | None
    """Share of the vehicle's messages that were lost in the last 10 s, 0..1; null: none has come."""
    watch: WatchStatusModel | None
    """Null: the stream is of no watch."""


class LiveMessage(Answer):
    """What came from the sensors of a vehicle, ten times a second."""

    event: Literal["samples"]
    data: LiveModel


class VehicleMessage(Answer):
    """The present state of a vehicle."""

    event: Literal["vehicle"]
    data: VehicleModel


Message = Annotated[JobMessage | VehicleMessage | LinkMessage, Field(discriminator="event")]
"""One of Message."""
