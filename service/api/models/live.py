"""What sensors read now."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, WithJsonSchema

from mavcal.calib.recording import Sensor
from mavcal.service.api.models.base import Number

Attitude = Annotated[
    tuple[float, float, float, float],
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 4, "maxItems": 4}),
]


class SamplesModel(BaseModel):
    """New samples of one sensor."""

    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    unit: str
    source: str = Field(description="the message that carries it")
    t: list[Number] = Field(description="the vehicle's clock, s")
    values: list[list[Number | None]] = Field(description="a column an axis, in `unit`; null: not a finite number")


class LiveModel(BaseModel):
    """Samples since the last message."""

    channels: list[SamplesModel] = Field(description="as they are streamed; one a sensor and instance")
    bare: list[SamplesModel] = Field(description="compasses without the calibration in force, where that is known")
    attitude: Attitude | None = Field(
        description="quaternion w x y z, body (front right down) to north-east-down; null: none has come"
    )
    model_field_ut: Number | None = Field(
        description="strength of the Earth's field by the World Magnetic Model, uT; null: the position is not known"
    )


class LiveMessage(BaseModel):
    """What came from the sensors of a vehicle, ten times a second."""

    event: Literal["samples"]
    data: LiveModel
