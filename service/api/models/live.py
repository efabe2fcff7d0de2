"""Live sensor samples."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from mavcal.calib.firmware.stream.rates import INERTIAL_HZ, LIVE_MOST_HZ
from mavcal.calib.recording import Sensor
from mavcal.service.api.models.wire import Attitude, Number, Request, Wire
from mavcal.service.rates.watching import LiveStatus


class WatchRequest(Request):
    """A wish to watch a vehicle."""

    rate_hz: float = Field(
        default=INERTIAL_HZ, gt=0, le=LIVE_MOST_HZ, description="how often each inertial unit is to be sent, Hz"
    )


class WatchModel(BaseModel):
    """A watch. It is over 3 s after its stream has ended, or 10 s after nothing was taken from it."""

    id: str = Field(description="for `follow_samples`")
    rate_hz: float = Field(description="the requested rate, Hz")


WatchStatusModel = Annotated[LiveStatus, Wire("WatchStatusModel")]


class SamplesModel(BaseModel):
    """New samples of one sensor."""

    # A Channel with fewer digits, its arrays as lists.
    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    unit: str
    source: str = Field(description="the message that carries it")
    t: list[Number] = Field(description="the vehicle's clock, s")
    values: list[list[Number | None]] = Field(description="a column an axis, in `unit`; null: not a finite number")


class LiveModel(BaseModel):
    """Samples since the last message."""

    # A LiveBatch with the status of the watch.
    channels: list[SamplesModel] = Field(description="as they are streamed; one a sensor and instance")
    bare: list[SamplesModel] = Field(description="compasses without the calibration in force, where that is known")
    attitude: Attitude | None = Field(
        description="quaternion w x y z, body (front right down) to north-east-down; null: none has come"
    )
    model_field_ut: Number | None = Field(
        description="strength of the Earth's field by the World Magnetic Model, uT; null: the position is not known"
    )
    loss: Number | None = Field(
        description="share of the vehicle's messages that were lost in the last 10 s, 0..1; null: none has come"
    )
    watch: WatchStatusModel | None = Field(description="null: the stream is of no watch")


class LiveMessage(BaseModel):
    """What came from the sensors of a vehicle, ten times a second."""

    event: Literal["samples"]
    data: LiveModel
