"""Procedures, and their steps while they run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from mavcal.calib.firmware.storable import Storable
from mavcal.calib.procedures import protocol
from mavcal.calib.procedures.protocol import Pose, PromptStep, Silence, Tilt
from mavcal.calib.recording import Sensor
from mavcal.service.api.models.wire import Json, Number, Vector, Wire


class OptionModel(BaseModel):
    """A number or a switch that may be set when a job is started."""

    # An Option without its type, which `default` and `unit` show; no limit is null, not infinite.
    name: str
    default: bool | Number | None = Field(description="in `unit`; null: it has to be given")
    help: str
    unit: str = Field(description="empty: a switch, or a pure number")
    low: Number | None = Field(description="least value, in `unit`; null: without a limit")
    high: Number | None = Field(description="greatest value, in `unit`; null: without a limit")


HoldsModel = Annotated[Storable, Wire("HoldsModel")]


class ProcedureModel(BaseModel):
    """A procedure: what it needs, ends on, writes and cannot represent."""

    # A ProcedureSpec without what only this service asks of it.
    kind: str
    title: str
    sensors: list[Sensor] = Field(description="these must stream")
    helpful: list[Sensor] = Field(description="used where they stream")
    options: list[OptionModel]
    needs: str
    ends_on: str
    autopilots: dict[str, HoldsModel]
    duration_s: float = Field(description="typical length with the default options, s of the vehicle's clock")


NumberModel = Annotated[protocol.Number, Wire("NumberModel")]
TiltModel = Annotated[Tilt, Wire("TiltModel")]
SilenceModel = Annotated[Silence, Wire("SilenceModel")]


class PromptModel(BaseModel):
    """What the operator is asked to do now."""

    # A Prompt with its type: events carry steps of several.
    type: Literal["prompt"]
    step: PromptStep
    text: str
    pose: Pose | None = Field(description="the pose that is asked for; null: any, or none")
    remaining: list[Pose] = Field(description="poses still missing; their order is free")
    hold_s: Number | None = Field(description="how long to hold still, s")
    rotate: bool
    direction: Vector | None = Field(
        description="body direction (front, right, down) that should point down; a unit vector"
    )
    temperature: Number | None = Field(description="bring the sensors to about this, degC; null: any")
    detected: Pose | None = Field(description="the pose that the vehicle is in")
    stable: bool = Field(description="whether it is at rest there")
    answers: list[str] = Field(description="answers that are accepted; empty: the data answer")
    axis: Vector | None = Field(
        description="turn about this body axis (front, right, down), right-handed; a unit vector"
    )
    turns: Number | None = Field(description="how many turns to make; null: until the prompt changes")
    number: NumberModel | None = Field(description="a number that is asked for beside `answers`")
    taken: bool = Field(description="the detected pose is done already: the next one is waited for")
    tilts: list[TiltModel] = Field(description="oblique poses: those that were taken, then those that are asked for")
    unfinished: str = Field(description="what stays open after the answer `finish` now; empty: nothing")
    silence: SilenceModel | None = Field(description="null: the vehicle is heard")


class ProgressModel(BaseModel):
    """The field list of a progress bar."""

    # A Progress with its type: events carry steps of several.
    type: Literal["progress"]
    current: Number = Field(description="in `unit`")
    target: Number = Field(description="in `unit`")
    unit: str
    text: str
    eta: Number | None = Field(description="s of the vehicle's clock; null: cannot be said yet")
    detail: Json | None = Field(description="numbers for a panel")
