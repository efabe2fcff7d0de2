"""What goes over HTTP. These are neither database rows nor domain objects; `views` makes them from those."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

Json = dict[str, Any]


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LinkRequest(_Request):
    """Open a link."""

    url: str = Field(description="an endpoint such as udpin:0.0.0.0:14550", examples=["udpin:0.0.0.0:14550"])


class PlanOptions(_Request):
    """What the operator decides about a plan; sensors are named gyro0 (the first gyro), accel1, mag0."""

    only: list[str] = Field(default=[], description="plan for these sensors alone; empty: for all that were fitted")
    keep_gyro_at_boot: bool = Field(default=False, description="ArduPilot: keep the gyro offsets (INS_GYR_CAL = 0)")
    mark_calibrated: bool = Field(default=True, description="ArduPilot: mark the sensors as calibrated")
    adjust_level: bool = Field(default=True, description="carry the level trim over to a new accelerometer calibration")
    confirm_mounting: bool = Field(default=False, description="a compass really is mounted as the job found it")
    confirm_other_unit: bool = Field(
        default=False, description="a recording without a board id is of this vehicle; the audit keeps it"
    )
    device_ids: dict[str, int] = Field(default={}, description="PX4: device id of a sensor without a row, by sensor")
    accel_temperature: dict[str, float] = Field(
        default={}, description="PX4: degC at which CAL_ACC in force was taken, by sensor"
    )

    def given(self) -> Json:
        """What was said, and nothing else."""
        return self.model_dump(exclude_unset=True)


class PlanRequest(_Request):
    """Plan again."""

    plan_options: PlanOptions | None = Field(default=None, description="in place of those of before; null: as before")


class JobRequest(_Request):
    """Start a calibration."""

    kind: str = Field(description="a kind of `/procedures`, such as gyro, accel or mag-rings", examples=["gyro"])
    options: dict[str, float | bool] = Field(default_factory=dict, description="options of that procedure")
    plan_options: PlanOptions = Field(default_factory=PlanOptions, description="options of the plan")


class AnswerRequest(_Request):
    """Answer the prompt of a job."""

    value: str = Field(description="one of the answers that the prompt offers", examples=["finish"])


class ApplyRequest(_Request):
    """Accept a plan."""

    plan_sha256: str = Field(pattern="^[0-9a-f]{64}$", description="digest of the plan that is accepted")
    reboot: bool = Field(default=False, description="restart the vehicle if the plan needs it")
    prove_s: float = Field(
        default=120.0, ge=0.0, le=3600.0, description="how long to wait for movements that prove the rest, s"
    )


class FitRequest(_Request):
    """Fit an uploaded recording."""

    method: str = Field(description="a method of `mavcal fit --help`", examples=["mag-ellipsoid"])
    options: Json = Field(default_factory=dict, description="options of that method")


class RecordingJobRequest(FitRequest):
    """Plan the fits of an uploaded recording for a connected vehicle."""

    vehicle_id: str = Field(description="the vehicle that the recording is of")
    plan_options: PlanOptions = Field(default_factory=PlanOptions, description="options of the plan")


def _column(value: object) -> object:
    return str(value) if type(value) is int else value  # a 0-based number names a column, too


class ReadingOptions(_Request):
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
    system: int | None = Field(default=None, ge=1, le=255, description="of a telemetry log: which vehicle")


class LinkModel(BaseModel):
    """A link."""

    id: str
    url: str
    state: str = Field(description="connecting, up, down or closed")
    reason: str = Field(description="why it is in that state")
    vehicles: list[str] = Field(description="ids of the vehicles heard on it")
    crc_errors: int = Field(description="damaged frames, which cannot be attributed to a sender")


class VehicleModel(BaseModel):
    """A vehicle in one page."""

    id: str
    link: str
    system: int
    component: int
    autopilot: str
    firmware: str
    uid: str | None
    armed: bool
    landed: str
    silent: bool = Field(description="no heartbeat for 3 s")
    writable: bool = Field(description="whether parameters may be written now")
    obstacles: list[str] = Field(description="why nothing may be written now")
    evidence: list[str] = Field(description="what the state rests on")
    texts: list[str] = Field(description="the last things that the vehicle said")
    received: int
    lost: int
    loss: float = Field(description="lost share of everything sent, 0..1")
    bytes_per_s: float
    parameters_known: int


class ParameterModel(BaseModel):
    """A parameter as the vehicle states it."""

    name: str
    value: float | int | None
    kind: str


class ProcedureModel(BaseModel):
    """A procedure: what it needs, ends on, writes and cannot represent."""

    kind: str
    title: str
    sensors: list[str]
    helpful: list[str]
    options: list[Json]
    needs: str
    ends_on: str
    autopilots: Json
    duration_s: float


class UnprovedModel(BaseModel):
    """A parameter that no stream has proved, or a sensor that could not be seen to read right with the new values."""

    name: str
    verdict: str = Field(description="consistent, not_observable or contradicted")
    why: str


class _Proof(BaseModel):
    proof: Literal["full", "partial", "none"] = Field(
        description="how much of what shows on a stream the stream has proved after the write"
    )
    proof_reason: str
    unproved: list[UnprovedModel]


class ResultModel(_Proof):
    """The job reached its goal."""

    kind: Literal["result"]
    text: str


class FailureModel(_Proof):
    """The job did not reach its goal."""

    kind: Literal["failure"]
    code: str
    cause: str
    remedy: str


OutcomeModel = Annotated[ResultModel | FailureModel, Field(discriminator="kind")]


class StandingModel(BaseModel):
    """What is known of one parameter that a job has written, or may have."""

    name: str
    old: float | int | None
    new: float | int | None
    value: float | int | None = Field(description="the last value heard; null: none since the last PARAM_SET left")
    certain: bool = Field(description="false: it may have changed since")
    note: str
    holds: Literal["old", "new", "other", "unknown"]


class WriteModel(BaseModel):
    """The last attempt to write a job's plan; the event `write` carries the same when it ends."""

    result: Literal["running", "failed", "in_doubt", "reverted", "succeeded"] = Field(
        description="failed: nothing was sent, and the job is in review again"
    )
    at: float
    cause: str
    remedy: str
    sent: int = Field(description="parameters for which a PARAM_SET may have left")


class JobSummary(BaseModel):
    """A job in a list."""

    id: str
    href: str = Field(description="its address, relative to the root of the service")
    vehicle_id: str
    kind: str
    state: str
    created_at: float
    updated_at: float
    progress: Json | None
    prompt: Json | None
    outcome: OutcomeModel | None
    last_write: WriteModel | None


class JobModel(JobSummary):
    """A job with its results."""

    options: Json
    plan_options: Json = Field(description="what the operator decided about the plan")
    warnings: list[str]
    results: list[Json] = Field(description="one fit a sensor instance, as in `mavcal fit --json`")
    plan: Json | None
    verification: Json | None
    standing: list[StandingModel] = Field(
        description="parameters in doubt (all that were sent, or may have been), or left to a third party"
    )
    segments: list[Json] = Field(description="what the fit was made of: name, byte range and digest of the recording")


class RecordingModel(BaseModel):
    """An uploaded recording."""

    id: str
    href: str = Field(description="its address, relative to the root of the service")
    name: str
    size: int
    sha256: str
    uploaded_at: float
    inspection: Json


class FitsModel(BaseModel):
    """Fits of an uploaded recording."""

    method: str
    fits: list[Json]


class GapRequest(_Request):
    """Diagnose the sim-to-real gap of uploaded recordings."""

    real: str = Field(description="id of the recording whose gap is asked for")
    sim: str | None = Field(default=None, description="id of a simulator's recording, of the same flight or such a one")
    nominal: list[str] = Field(
        default_factory=list, max_length=8, description="ids of recordings without an effect, for noise and field"
    )


class GapSummary(BaseModel):
    """A diagnosis in a list."""

    id: str
    href: str = Field(description="its address, relative to the root of the service")
    state: str = Field(description="queued, running, done or failed")
    error: str | None = Field(description="why it failed")
    created_at: float
    real: str
    sim: str | None
    nominal: list[str]


class GapModel(GapSummary):
    """A diagnosis with its report."""

    report: Json | None = Field(description="as `mavcal gap --json`; null until it is done")
    page: str | None = Field(description="address of the report as a page, relative to the root of the service")


class TicketModel(BaseModel):
    """A ticket for one event stream."""

    ticket: str
    valid_s: float


class AuditModel(BaseModel):
    """Who asked for what."""

    id: int
    at: float
    actor: str
    action: str
    subject: str
    detail: Json
    sha256: str | None = Field(description="covers this row and all before it; null: from before there was a chain")


class AuditPage(BaseModel):
    """Rows of the audit trail, oldest first."""

    rows: list[AuditModel]
    next: int | None = Field(description="`after` of the next page; null: this is the last one")


class AuditCheck(BaseModel):
    """Whether the audit trail is as it was written."""

    intact: bool
    rows: int
    head: str = Field(description="digest of the newest row; kept elsewhere it vouches for all rows up to it")
    broken_at: int | None = Field(description="first row that does not fit")
