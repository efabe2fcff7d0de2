"""The fleet: units, their sensors, drifts, and why they should be calibrated again."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field, model_validator

from mavcal.calib.fleet.record import ObservationSource
from mavcal.calib.fleet.standing import FailedCheck, Reason
from mavcal.calib.fleet.trend import Leaving, Open, Slope
from mavcal.calib.preflight.check import Verdict
from mavcal.calib.preflight.history import Covered
from mavcal.calib.recording import Sensor
from mavcal.service.api.models.wire import Request, Stamp, Vector, Wire
from mavcal.service.settings import TAG

Name = Annotated[str, Field(max_length=80, pattern=r"^[^\x00-\x1f\x7f]*$")]
Tag = Annotated[str, Field(pattern=TAG)]


class UnitRequest(Request):
    """A name, tags, or both; what is left out stays as it is."""

    name: Name | None = Field(default=None, description="what people call it; empty: nothing any more")
    tags: Annotated[list[Tag], Field(max_length=32)] | None = Field(
        default=None, description="all of its tags; a key that is bound to tags may not change them"
    )

    @model_validator(mode="after")
    def _something(self) -> UnitRequest:
        if self.name is None and self.tags is None:
            raise ValueError("give a name, tags, or both")
        return self


SlopeModel = Annotated[Slope, Wire("SlopeModel")]
LeavingModel = Annotated[Leaving, Wire("LeavingModel")]
OpenModel = Annotated[Open, Wire("OpenModel")]


class DriftModel(BaseModel):
    """How a bias drifts. Slopes are along the sensor's axes; null: not determined, `open` says why."""

    # A Trend in the unit of the limit, and that limit.
    n: int = Field(description="measurements that it rests on")
    unit: str
    limit: float = Field(description="how far the bias may be from what corrects it, in `unit`")
    per_year: list[SlopeModel] | None
    per_degc: list[SlopeModel] | None
    leaving: LeavingModel | None
    open: list[OpenModel]


class OddnessModel(BaseModel):
    """How far a sensor is from the middle of its type, in robust standard deviations of its worst axis."""

    # An Oddness with its verdict.
    distance: float = Field(description="robust standard deviations")
    limit: float = Field(description="a healthy group has one sensor beyond it in 1 of 100 groups")
    axis: int = Field(description="0, 1 or 2")
    group: int = Field(description="sensors of this type that are known")
    odd: bool


CoveredModel = Annotated[Covered, Wire("CoveredModel")]


class FleetSensorModel(BaseModel):
    """One sensor of a unit as it is known now."""

    # A SensorStanding with times as ages, and biases in the unit of their limit.
    sensor: Sensor
    instance: int = Field(description="0 for the first of its kind")
    device_id: int = Field(description="0: not known")
    type: str = Field(description="name of the part; empty: not known")
    bus: str = Field(description="bus and address of the part; empty: not known")
    calibrated_at: float | None = Field(
        description="time of the last verified calibration, s since 1970; null: none known"
    )
    age_days: float | None = Field(description="days since then; null: none known")
    job_id: str | None = Field(description="the job that calibrated it last")
    covered: CoveredModel | None
    bias: Vector | None = Field(description="as it was measured last, in the unit of `drift`; null: never absolutely")
    temperature: float | None = Field(description="at which that was, degC")
    drift: DriftModel
    oddness: OddnessModel | None = Field(description="null: fewer than six sensors of its type are known")


FailedCheckModel = Annotated[FailedCheck, Wire("FailedCheckModel")]


class UnitPreflightModel(BaseModel):
    """The last preflight of a unit."""

    # A LastPreflight with its age and summary.
    at: Stamp
    age_s: float = Field(description="s since then")
    verdict: Verdict
    summary: str
    failed: list[FailedCheckModel]


ReasonModel = Annotated[Reason, Wire("ReasonModel")]


class FleetUnitModel(BaseModel):
    """A unit in one row."""

    unit: str = Field(description="`uid-` and its hardware id, or where it was heard")
    href: str
    name: str = Field(description="what people call it; empty: nothing")
    tags: list[str]
    autopilot: str
    firmware: str
    connected: bool = Field(description="on a link of this service now")
    silent: bool | None = Field(description="no heartbeat for 3 s; null: not connected")
    seen_at: float | None = Field(description="when it was identified last, s since 1970; null: not known")
    preflight: UnitPreflightModel | None
    age_days: float | None = Field(description="age of its oldest calibration, days; null: a sensor has none")
    ages: dict[str, float | None] = Field(description="the same by kind of sensor")
    leaving: LeavingModel | None = Field(description="for the sensor that leaves its limit first")
    needs_recalibration: bool
    reasons: list[ReasonModel]
    sensors: list[FleetSensorModel]


class SensorRecordModel(BaseModel):
    """One sensor as a job or a preflight measured it once."""

    # A SensorRecord in the unit of the limit, its device id decoded.
    sensor: Sensor
    instance: int = Field(description="0 for the first of its kind")
    device_id: int = Field(description="as the firmware numbers it; 0: not known")
    type: str
    at: Stamp
    source: ObservationSource
    source_id: str = Field(description="the job, whose calibration can be compared and restored")
    what: str = Field(description="kind of the job; `rest`: a preflight")
    applied: bool = Field(description="the sensor was corrected by this from then on")
    proved: bool
    unit: str
    bias: Vector | None = Field(description="raw, in `unit`")
    sd: Vector | None
    norm: float | None = Field(description="from a preflight: rate or specific force as the vehicle used it, in `unit`")
    temperature: float | None = Field(description="degC")
    covered: CoveredModel | None


class UnitHistoryModel(BaseModel):
    """Everything that was measured of a unit's sensors, oldest first, with their drifts."""

    unit: FleetUnitModel
    records: list[SensorRecordModel]
