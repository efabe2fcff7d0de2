"""A plan as a person reads it."""

from __future__ import annotations

from pydantic import BaseModel, Field

from mavcal.calib.preflight.check import Verdict
from mavcal.calib.recording import Sensor
from mavcal.service.api.models.base import Number


class SensorEffectModel(BaseModel):
    """What a plan does for one sensor."""

    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    quantity: str = Field(description="what is off: heading, rate at rest, acceleration, level or drift")
    unit: str
    before: Number | None = Field(
        description="largest error with the calibration in force, in `unit`; null: what is in force is not known"
    )
    after: Number = Field(description="one standard deviation of what is left, with what cannot be stored, in `unit`")
    text: str


class CriterionModel(BaseModel):
    """What speaks for or against a plan."""

    id: str
    verdict: Verdict
    value: Number | None = Field(description="in `unit`; null: it has none")
    limit: Number | None = Field(description="in `unit`; null: it has none")
    unit: str
    text: str
    remedy: str = Field(description="what helps; empty: nothing has to be done")


class MountingModel(BaseModel):
    """The mounting of a compass; numbers are the firmware's."""

    instance: int = Field(description="which compass, from 0")
    stated: int = Field(description="what the vehicle is told now")
    stated_text: str
    chosen: int | None = Field(description="what the plan takes instead; null: as it was found")


class MountingChoiceModel(BaseModel):
    """A rotation that the firmware has by number."""

    number: int = Field(description="for the plan option `mountings`")
    text: str
    matrix: list[list[Number]] = Field(description="takes the sensor to the body")


class ReviewModel(BaseModel):
    """What a plan does, and what speaks for and against it."""

    headline: str
    sensors: list[SensorEffectModel]
    criteria: list[CriterionModel]
    picture: str | None = Field(
        description="address of the picture of before and after, relative to the root of the service; null: none"
    )
    mountings: list[MountingModel] = Field(description="compasses whose mounting can be chosen")
    mounting_choices: list[MountingChoiceModel] = Field(description="what can be chosen")
