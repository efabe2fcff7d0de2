"""Write plans, the check of the stream that follows a write, and a plan as a person reads it."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from mavcal.calib.firmware.plan import (
    AfterWrite,
    Agreement,
    Change,
    Fingerprint,
    LeftOut,
    Loss,
    Movement,
    ParameterVerdict,
    SensorCheck,
)
from mavcal.calib.recording import Sensor
from mavcal.calib.review.criteria import Criterion
from mavcal.calib.review.mountings import StatedMounting
from mavcal.service.api.models.wire import Json, Number, Request, Wire


class PlanOptions(Request):
    """What the operator decides about a plan; sensors are named gyro0 (the first gyro), accel1, mag0."""

    only: list[str] = Field(default=[], description="plan for these sensors alone; empty: for all that were fitted")
    keep_gyro_at_boot: bool = Field(default=False, description="ArduPilot: keep the gyro offsets (INS_GYR_CAL = 0)")
    mark_calibrated: bool = Field(default=True, description="ArduPilot: mark the sensors as calibrated")
    adjust_level: bool = Field(default=True, description="carry the level trim over to a new accelerometer calibration")
    confirm_mounting: bool = Field(default=False, description="a compass really is mounted as the job found it")
    mountings: dict[str, int] = Field(
        default={}, description="mounting of a compass that its movement did not show, by the firmware's number"
    )
    confirm_other_unit: bool = Field(
        default=False, description="a recording without a board id is of this vehicle; the audit keeps it"
    )
    device_ids: dict[str, int] = Field(default={}, description="PX4: device id that no stream says, by sensor")
    accel_temperature: dict[str, float] = Field(
        default={}, description="PX4: degC at which CAL_ACC in force was taken, by sensor"
    )

    def given(self) -> Json:
        """Only the options that were given."""
        return self.model_dump(exclude_unset=True)


class PlanRequest(Request):
    """Plan again."""

    plan_options: PlanOptions | None = Field(default=None, description="replaces the earlier options; null: as before")


class ApplyRequest(Request):
    """Accept a plan."""

    plan_sha256: str = Field(pattern="^[0-9a-f]{64}$", description="digest of the plan that is accepted")
    reboot: bool = Field(default=False, description="restart the vehicle if the plan needs it")
    prove_s: float = Field(
        default=120.0, ge=0.0, le=3600.0, description="how long to wait for movements that prove the rest, s"
    )
    preflight: bool = Field(
        default=True, description="look at the vehicle for some seconds afterwards and say whether it would arm now"
    )


FingerprintModel = Annotated[Fingerprint, Wire("FingerprintModel")]
ChangeModel = Annotated[Change, Wire("ChangeModel")]
LossModel = Annotated[Loss, Wire("LossModel")]
AfterWriteModel = Annotated[AfterWrite, Wire("AfterWriteModel")]
AgreementModel = Annotated[Agreement, Wire("AgreementModel")]
LeftOutModel = Annotated[LeftOut, Wire("LeftOutModel")]


class PlanModel(BaseModel):
    """What would be written, in this order, why, and what it costs."""

    # A WritePlan with its digest and whether it needs a restart.
    fingerprint: FingerprintModel
    snapshot_sha256: str = Field(description="digest of the parameters that the plan rests on")
    changes: list[ChangeModel]
    losses: list[LossModel]
    after: list[AfterWriteModel]
    warnings: list[str]
    blockers: list[str] = Field(description="why nothing of it may be written; empty: it may be")
    agreements: list[AgreementModel]
    left_out: list[LeftOutModel] = Field(description="sensors that were fitted and are not written, or in part only")
    needs_reboot: bool
    sha256: str = Field(description="digest of the plan; whoever accepts it quotes this")


ParameterVerdictModel = Annotated[ParameterVerdict, Wire("ParameterVerdictModel", not_finite=("effect", "sd"))]
MovementModel = Annotated[Movement, Wire("MovementModel")]
SensorCheckModel = Annotated[SensorCheck, Wire("SensorCheckModel")]


class VerificationModel(BaseModel):
    """The physical check of a plan: do the parameters act, and do the sensors read right with them."""

    # A Verification with its summary; `refuted` names the sensors.
    parameters: list[ParameterVerdictModel]
    movement: MovementModel | None = Field(description="what would prove the rest; null: nothing would")
    sensors: list[SensorCheckModel]
    unseen: list[str] = Field(description="parameters whose sensor was not streamed or never at rest")
    proved: bool = Field(description="every parameter that acts on a stream is proved, and no sensor reads wrong")
    contradicted: list[str] = Field(description="parameters that were accepted and did not take effect")
    refuted: list[str] = Field(description="sensors that read wrong although their parameters act")


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
