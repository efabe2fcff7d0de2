"""A plan as a person reads it."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from mavcal.calib.recording import Sensor
from mavcal.calib.review.criteria import Criterion
from mavcal.calib.review.mountings import StatedMounting
from mavcal.service.api.models.base import Number
from mavcal.service.api.models.wire import Wire


class SensorEffectModel(BaseModel):
    """What a plan does for one sensor."""

    # A SensorEffect without its curve, with a sentence that knows the state of the job.
    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    quantity: str = Field(description="what is off: heading, rate at rest, acceleration, level or drift")
    unit: str
    before: Number | None = Field(
        description="largest error with the calibration in force, in `unit`; null: what is in force is not known"
    )
    after: Number = Field(description="one standard deviation of what is left, with what cannot be stored, in `unit`")
    text: str


CriterionModel = Annotated[Criterion, Wire("CriterionModel")]
MountingModel = Annotated[StatedMounting, Wire("MountingModel")]


class MountingChoiceModel(BaseModel):
    """A rotation that the firmware has by number."""

    # A MountingChoice: its array as rows.
    number: int = Field(description="for the plan option `mountings`")
    text: str
    matrix: list[list[Number]] = Field(description="takes the sensor to the body")


class ReviewModel(BaseModel):
    """What a plan does, and what speaks for and against it."""

    # A Review with the address of its picture.
    headline: str
    sensors: list[SensorEffectModel]
    criteria: list[CriterionModel]
    picture: str | None = Field(
        description="address of the picture of before and after, relative to the root of the service; null: none"
    )
    mountings: list[MountingModel] = Field(description="compasses whose mounting can be chosen")
    mounting_choices: list[MountingChoiceModel] = Field(description="what can be chosen")
