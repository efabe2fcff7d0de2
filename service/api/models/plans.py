"""Write plans, and the check of the stream that follows a write."""

from __future__ import annotations

from pydantic import BaseModel, Field

from mavcal.calib.firmware.plan import ParameterKind, ProofVerdict, SensorCheckId, SensorVerdict
from mavcal.calib.recording import Sensor
from mavcal.service.api.models.base import Json, Number, Request


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
        """What was said, and nothing else."""
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


class FingerprintModel(BaseModel):
    """Whose plan it is: any difference means that it has to be made again."""

    autopilot: str
    uid: str = Field(description="hardware id, hexadecimal")
    firmware: str
    device_ids: list[tuple[str, int]] = Field(description="device ids of the sensors, by parameter")


class ChangeModel(BaseModel):
    """One parameter to be set."""

    name: str
    old: Number | None = Field(description="in `unit`; null: hidden, the vehicle did not list it")
    new: Number = Field(description="in `unit`")
    kind: ParameterKind
    why: str
    sd: Number | None = Field(description="standard deviation of `new`, in `unit`; null: not an estimate")
    unit: str = Field(description="unit of the parameter; empty: a pure number")
    sensor: Sensor | None
    instance: int = Field(description="which sensor of its kind, from 0")
    needs_reboot: bool
    session: bool = Field(description="a setting of this session, put back when the job ends")


class LossModel(BaseModel):
    """A part of the fit that this firmware cannot hold."""

    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    what: str
    cost: Number = Field(description="largest effect of leaving it out, over all directions, in `unit`")
    unit: str
    text: str


class AfterWriteModel(BaseModel):
    """A MAVLink command that is sent when every parameter was read back."""

    command: int = Field(description="MAV_CMD")
    params: list[Number] = Field(description="its seven parameters", min_length=7, max_length=7)
    why: str


class AgreementModel(BaseModel):
    """A sensor that is left as it is: the fit agrees with what is in force."""

    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    deviation: Number = Field(description="root mean square of the change, in standard deviations")
    text: str


class LeftOutModel(BaseModel):
    """A sensor that was asked for and gets no new calibration, or only a part of it."""

    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    reason: str


class PlanModel(BaseModel):
    """What would be written, in this order, why, and what it costs."""

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


class ParameterVerdictModel(BaseModel):
    """What the stream says of one written parameter."""

    name: str
    verdict: ProofVerdict
    effect: Number | None = Field(
        description="how far the stream would be off without this parameter, in `unit`; null: not finite"
    )
    sd: Number | None = Field(description="standard deviation of the check, in `unit`; null: not finite")
    unit: str
    text: str
    acts_on_stream: bool = Field(description="false: no stream depends on it; it is judged by read-back alone")


class MovementModel(BaseModel):
    """What would prove the parameters that are still open."""

    text: str
    faces: list[str] = Field(description="poses to be held still")
    turn: bool = Field(description="turn the vehicle through all directions")
    temperature: Number | None = Field(description="bring the sensors to about this, degC; null: any")


class SensorCheckModel(BaseModel):
    """What a sensor reads after the write beside what it should."""

    id: SensorCheckId
    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    value: Number | None = Field(description="how far it is off, in `unit`; null: not observed")
    limit: Number | None = Field(description="the most that noise, drift and the fit explain, in `unit`")
    unit: str
    sd: Number | None = Field(description="standard deviation of `value`, in `unit`")
    verdict: SensorVerdict
    text: str


class VerificationModel(BaseModel):
    """The physical check of a plan: do the parameters act, and do the sensors read right with them."""

    parameters: list[ParameterVerdictModel]
    movement: MovementModel | None = Field(description="what would prove the rest; null: nothing would")
    sensors: list[SensorCheckModel]
    unseen: list[str] = Field(description="parameters whose sensor was not streamed or never at rest")
    proved: bool = Field(description="every parameter that acts on a stream is proved, and no sensor reads wrong")
    contradicted: list[str] = Field(description="parameters that were accepted and did not take effect")
    refuted: list[str] = Field(description="sensors that read wrong although their parameters act")
