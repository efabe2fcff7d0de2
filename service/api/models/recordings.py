"""Uploaded recordings."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, Field

from mavcal.calib.recording import Sensor
from mavcal.service.api.models.fits import FitRequest
from mavcal.service.api.models.plans import PlanOptions
from mavcal.service.api.models.wire import Json, Number, Request, Stamp


class RecordingJobRequest(FitRequest):
    """Plan the fits of an uploaded recording for a connected vehicle."""

    vehicle_id: str = Field(description="the vehicle that the recording is of")
    plan_options: PlanOptions = Field(default_factory=PlanOptions, description="options of the plan")


def _column(value: object) -> object:
    return str(value) if type(value) is int else value  # a 0-based number names a column, too


class ReadingOptions(Request):
    """How an uploaded file is to be read; as the options of `mavcal fit`."""

    mapping: dict[str, Annotated[str, BeforeValidator(_column)]] = Field(
        default_factory=dict, description="canonical column: header name or 0-based number, with an optional *factor"
    )
    world: Literal["ned", "enu"] = "ned"
    body: Literal["frd", "flu"] = "frd"
    rate: float | None = Field(default=None, gt=0.0, allow_inf_nan=False, description="makes `t`, Hz")
    unit_accel: str = "si"
    unit_gyro: str = "si"
    unit_mag: str = "uT"
    system: int | None = Field(default=None, ge=1, le=255, description="which vehicle of a telemetry log")


class RecordingModel(BaseModel):
    """An uploaded recording."""

    # A RecordingRow without its path, with its address.
    id: str
    href: str = Field(description="its address, relative to the root of the service")
    name: str
    size: int = Field(description="bytes")
    sha256: str
    uploaded_at: Stamp
    inspection: Json = Field(description="what is in it, as `mavcal inspect --json`")


class SeriesModel(BaseModel):
    """One sensor over a recording; thinned, so that its extremes stay."""

    # A Series: its arrays as lists.
    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    unit: str
    source: str = Field(description="the message or column that carries it")
    t: list[Number] = Field(description="s since the recording began")
    values: list[list[Number | None]] = Field(description="a row an axis, in `unit`; null: not a finite number")


class MethodModel(BaseModel):
    """A method that fits a recording."""

    name: str
    summary: str = Field(description="what it finds, of what")
