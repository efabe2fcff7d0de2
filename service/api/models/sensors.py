"""The state of each calibration of a vehicle."""

from __future__ import annotations

from pydantic import BaseModel, Field

from mavcal.calib.preflight.check import Verdict
from mavcal.service.api.models.base import Number, Stamp


class SensorStateModel(BaseModel):
    """How one kind of calibration stands."""

    kind: str = Field(description="the procedure that would calibrate it")
    verdict: Verdict
    label: str = Field(description="the verdict in one or two words")
    text: str = Field(description="when it was calibrated, at what temperature, how good it is")
    advice: str = Field(description="what it needs; empty: nothing")
    at: Stamp | None = Field(description="when it was calibrated, wall-clock time, s since 1970; null: never here")
    job: str | None = Field(description="the job that did; null: never here")
    temperature: Number | None = Field(description="temperature of the calibration, degC; null: not known")


class VehicleSensorsModel(BaseModel):
    """The four kinds of calibration of a vehicle, and what it needs now."""

    verdict: Verdict
    summary: str
    sensors: list[SensorStateModel]
