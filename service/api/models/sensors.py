"""The state of each calibration of a vehicle."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel

from mavcal.calib.preflight.check import Verdict
from mavcal.calib.preflight.states import SensorState
from mavcal.service.api.models.wire import Wire

SensorStateModel = Annotated[SensorState, Wire("SensorStateModel")]


class VehicleSensorsModel(BaseModel):
    """The four kinds of calibration of a vehicle, and what it needs now."""

    verdict: Verdict
    summary: str
    sensors: list[SensorStateModel]
