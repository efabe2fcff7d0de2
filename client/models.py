"""What the service answers with besides jobs."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from mavcal.client.base import Answer, Number
from mavcal.client.enums import (
    Airframe,
    Autopilot,
    CheckId,
    Fixable,
    Hand,
    ItemOutcome,
    JobState,
    Landed,
    LinkState,
    ObservationSource,
    ParameterKind,
    Quantity,
    ReasonCode,
    Sensor,
    Verdict,
)
from mavcal.client.jobs import (
    DocumentModel,
    FitModel,
    LeftOutModel,
    OutcomeModel,
    ProgressModel,
    PromptModel,
    StandingModel,
    WriteModel,
)


class AuditCheck(Answer):
    """Whether the audit trail is as it was written."""

    intact: bool
    rows: int
    """How many there are."""
    head: str
    """Digest of the newest row; kept elsewhere it vouches for all rows up to it."""
    broken_at: int | None
    """First row that does not fit; null: all do."""


class AuditModel(Answer):
    """Who asked for what."""

    id: int
    """Rows are numbered in the order of their arrival."""
    at: Number
    """Wall-clock time, s since 1970."""
    actor: str
    action: str
    subject: str
    detail: dict[str, Any]
    sha256: str | None
    """Covers this row and all before it; null: from before there was a chain."""


class AuditPage(Answer):
    """Rows of the audit trail, oldest first."""

    rows: list[AuditModel]
    next: int | None
    """`after` of the next page; null: this is the last one."""


class CheckModel(Answer):
    """One check; value, sd and limit are those of its worst number, null where it has none."""

    id: CheckId
    verdict: Verdict
    value: Number | None
    """In `unit`."""
    sd: Number | None
    """Standard deviation of `value`, in `unit`: noise and whatever else limits it."""
    limit: Number | None
    """In `unit`."""
    unit: str
    """Empty: a pure number, or none."""
    reason: str
    remedy: str
    """What helps; empty where nothing has to be done."""
    evidence: list[str]
    """Every number and fact that the check rests on."""
    suspects: list[str] = Field(default_factory=list)
    """What is off; several: all of them, or one of them and nothing tells which, as the reason says."""


class CoveredModel(Answer):
    """The temperatures that a calibration covers, degC."""

    low: Number
    """degC."""
    high: Number
    """degC."""
    how: str


class CriterionModel(Answer):
    """What speaks for or against a plan."""

    id: str
    verdict: Verdict
    value: Number | None
    """In `unit`; null: it has none."""
    limit: Number | None
    """In `unit`; null: it has none."""
    unit: str
    text: str
    remedy: str
    """What helps; empty: nothing has to be done."""


class SlopeModel(Answer):
    """A slope along one axis, with the interval that holds it with 90 %."""

    value: Number
    """Per year or per degC, in the unit of the drift."""
    low: Number
    """End of the interval, same unit."""
    high: Number
    """End of the interval, same unit."""


class LeavingModel(Answer):
    """When a bias leaves its limit; null: not within ten years from the last measurement."""

    earliest: Number | None
    """With 90 % it leaves between here and `latest`, s since 1970."""
    middle: Number | None
    """As likely before as after, s since 1970."""
    latest: Number | None
    """End of that interval, s since 1970."""


class OpenModel(Answer):
    """What the measurements do not determine."""

    quantity: Quantity
    why: str


class DriftModel(Answer):
    """How a bias drifts. Slopes are along the sensor's axes; null: not determined, `open` says why."""

    n: int
    """Measurements that it rests on."""
    unit: str
    limit: Number
    """How far the bias may be from what corrects it, in `unit`."""
    per_year: list[SlopeModel] | None
    per_degc: list[SlopeModel] | None
    leaving: LeavingModel | None
    open: list[OpenModel]


class FailedCheckModel(Answer):
    """A check of the last preflight that did not pass."""

    id: CheckId
    verdict: Verdict
    reason: str


class FitsModel(Answer):
    """Fits of an uploaded recording."""

    method: str
    fits: list[FitModel]
    """One a sensor, as in `mavcal fit --json`."""


class FixModel(Answer):
    """A calibration that was run before the checks."""

    kind: Fixable
    job_id: str
    state: JobState
    text: str
    """What came of it."""


class OddnessModel(Answer):
    """How far a sensor is from the middle of its type, in robust standard deviations of its worst axis."""

    distance: Number
    """Robust standard deviations."""
    limit: Number
    """A healthy group has one sensor beyond it in 1 of 100 groups."""
    axis: int
    """0, 1 or 2."""
    group: int
    """Sensors of this type that are known."""
    odd: bool


class FleetSensorModel(Answer):
    """One sensor of a unit as it is known now."""

    sensor: Sensor
    instance: int
    """0 for the first of its kind."""
    device_id: int
    """0: not known."""
    type: str
    """Name of the part; empty: not known."""
    bus: str
    """Bus and address of the part; empty: not known."""
    calibrated_at: Number | None
    """Time of the last verified calibration, s since 1970; null: none known."""
    age_days: Number | None
    """Days since then; null: none known."""
    job_id: str | None
    """The job that calibrated it last."""
    covered: CoveredModel | None
    bias: list[Number] | None
    """As it was measured last, in the unit of `drift`; null: never absolutely."""
    temperature: Number | None
    """At which that was, degC."""
    drift: DriftModel
    oddness: OddnessModel | None
    """Null: fewer than six sensors of its type are known."""


class UnitPreflightModel(Answer):
    """The last preflight of a unit."""

    at: Number
    """Wall-clock time, s since 1970."""
    age_s: Number
    """s since then."""
    verdict: Verdict
    summary: str
    failed: list[FailedCheckModel]


class ReasonModel(Answer):
    """Why a unit should be calibrated again."""

    code: ReasonCode
    sensor: Sensor | None
    """Null: the unit as a whole."""
    instance: int | None
    """0 for the first of its kind; null: all of them."""
    text: str


class FleetUnitModel(Answer):
    """A unit in one row."""

    unit: str
    """`uid-` and its hardware id, or where it was heard."""
    href: str
    name: str
    """What people call it; empty: nothing."""
    tags: list[str]
    autopilot: str
    firmware: str
    connected: bool
    """On a link of this service now."""
    silent: bool | None
    """No heartbeat for 3 s; null: not connected."""
    seen_at: Number | None
    """When it was identified last, s since 1970; null: not known."""
    preflight: UnitPreflightModel | None
    age_days: Number | None
    """Age of its oldest calibration, days; null: a sensor has none."""
    ages: dict[str, Number | None]
    """The same by kind of sensor."""
    leaving: LeavingModel | None
    """For the sensor that leaves its limit first."""
    needs_recalibration: bool
    reasons: list[ReasonModel]
    sensors: list[FleetSensorModel]


class GapModel(Answer):
    """A diagnosis with its report."""

    id: str
    href: str
    """Its address, relative to the root of the service."""
    state: JobState
    """That of the job, whose id is the same."""
    error: str | None
    """Why it failed."""
    created_at: Number
    """Wall-clock time, s since 1970."""
    real: str
    sim: str | None
    nominal: list[str]
    report: dict[str, Any] | None
    """As `mavcal gap --json`; null until it has succeeded."""
    page: str | None
    """Address of the report as a page, relative to the root of the service."""


class GapSummary(Answer):
    """A diagnosis in a list."""

    id: str
    href: str
    """Its address, relative to the root of the service."""
    state: JobState
    """That of the job, whose id is the same."""
    error: str | None
    """Why it failed."""
    created_at: Number
    """Wall-clock time, s since 1970."""
    real: str
    sim: str | None
    nominal: list[str]


class HealthModel(Answer):
    """The process answers."""

    status: Literal["ok"]


class HoldsModel(Answer):
    """What one autopilot keeps of a procedure's result."""

    writes: list[str]
    """Parameters."""
    cannot_represent: list[str]


class InfoModel(Answer):
    """Name and versions."""

    name: str
    version: str
    python: str


class PreflightModel(Answer):
    """Whether a vehicle is fit to fly, as far as its sensors and their calibration go."""

    vehicle_id: str
    at: Number
    """Wall-clock time, s since 1970."""
    seconds: Number
    """How long it took, s."""
    verdict: Verdict
    """Any failure fails the whole; then warnings count, then what is unknown."""
    summary: str
    checks: list[CheckModel]
    notes: list[str]
    """What stood in the way of looking."""
    fixed: list[FixModel]


class ItemModel(Answer):
    """One vehicle or upload of a campaign."""

    number: int
    """Its place in the campaign, from 1."""
    subject: str
    """Id of the vehicle or upload; for a campaign of a command, the file."""
    name: str
    """File name of an upload; empty otherwise."""
    outcome: ItemOutcome
    code: str
    """The outcome in one word: a problem code, the verdict of a preflight or a diagnosis, or the state of the job
    when the item ended.
    """
    text: str
    job_id: str | None
    """The job that was begun for it; null: it needed none."""
    job_state: JobState | None
    """The present state of that job; null: there is none, or not any more."""
    began_at: Number | None
    """s since 1970; null: not yet."""
    ended_at: Number | None
    """s since 1970; null: not yet."""
    preflight: PreflightModel | None
    """Report, if the campaign runs preflights."""
    fits: list[FitModel]
    """One fit for each sensor instance, if the campaign fits."""
    documents: list[DocumentModel]
    """Each report, if the campaign diagnoses."""


class JobSummary(Answer):
    """A job in a list."""

    id: str
    href: str
    """Its address, relative to the root of the service."""
    vehicle_id: str | None
    """Null: the job computes something of uploads and needs no vehicle."""
    kind: str
    state: JobState
    created_at: Number
    """Wall-clock time, s since 1970."""
    updated_at: Number
    """Wall-clock time, s since 1970."""
    progress: ProgressModel | None
    prompt: PromptModel | None
    """What the operator is asked to do; null: nothing now."""
    outcome: OutcomeModel | None
    """Null while the job goes on, and while a plan waits that was not tried yet."""
    left_out: list[LeftOutModel]
    """Sensors that were asked for and get no new calibration, or only a part of it; not empty: the job is done in
    part.
    """
    broken: list[LeftOutModel]
    """Sensors that fell out and that this kind of job does not calibrate; its own result is whole."""
    last_write: WriteModel | None
    """Null: nothing was accepted yet."""
    options: dict[str, Any]
    """Options of the procedure or method, and what an upload adds."""


class LinkModel(Answer):
    """A link."""

    id: str
    url: str
    state: LinkState
    reason: str
    """Why it is in that state."""
    signing_key: str | None
    """Name of the key that signs it; null: it is not signed."""
    vehicles: list[str]
    """Ids of the vehicles heard on it."""
    crc_errors: int
    """Damaged frames, which cannot be attributed to a sender."""


class MethodModel(Answer):
    """A method that fits a recording."""

    name: str
    summary: str
    """What it finds, of what."""


class MountingChoiceModel(Answer):
    """A rotation that the firmware has by number."""

    number: int
    """For the plan option `mountings`."""
    text: str
    matrix: list[list[Number]]
    """Takes the sensor to the body."""


class MountingModel(Answer):
    """The mounting of a compass; numbers are the firmware's."""

    instance: int
    """Which compass, from 0."""
    stated: int
    """What the vehicle is told now."""
    stated_text: str
    chosen: int | None
    """What the plan takes instead; null: as it was found."""


class OptionModel(Answer):
    """A number or a switch that may be set when a job is started."""

    name: str
    default: bool | Number | None
    """In `unit`; null: it has to be given."""
    help: str
    unit: str
    """Empty: a switch, or a pure number."""
    low: Number | None
    """Least value, in `unit`; null: without a limit."""
    high: Number | None
    """Greatest value, in `unit`; null: without a limit."""


class ParameterModel(Answer):
    """A parameter as the vehicle states it."""

    name: str
    value: Number | None
    """In the unit that the firmware documents; null: not a finite number."""
    kind: ParameterKind


class ProcedureModel(Answer):
    """A procedure: what it needs, ends on, writes and cannot represent."""

    kind: str
    title: str
    sensors: list[Sensor]
    """These must stream."""
    helpful: list[Sensor]
    """Used where they stream."""
    options: list[OptionModel]
    needs: str
    ends_on: str
    autopilots: dict[str, HoldsModel]
    duration_s: Number
    """Typical length with the default options, s of the vehicle's clock."""


class ReadinessModel(Answer):
    """Whether jobs can be run."""

    status: Literal["ready", "not ready"]
    reason: str = ""
    """What keeps jobs from being run."""


class RecordingModel(Answer):
    """An uploaded recording."""

    id: str
    href: str
    """Its address, relative to the root of the service."""
    name: str
    size: int
    """Bytes."""
    sha256: str
    uploaded_at: Number
    """Wall-clock time, s since 1970."""
    inspection: dict[str, Any]
    """What is in it, as `mavcal inspect --json`."""


class RegistrationModel(Answer):
    """How BlueOS lists a service; it drops the whole if one of the first seven is missing."""

    name: str
    description: str
    icon: str
    """Name of an icon of Material Design Icons."""
    company: str
    version: str
    webpage: str
    api: str
    """Address of the API's page, relative to the root of the service."""
    route: str
    """Address of the panel below the root; empty: the root itself."""
    new_page: bool
    """Whether it opens in a page of its own."""
    extra_query: str
    avoid_iframes: bool
    works_in_relative_paths: bool
    extras: dict[str, str]
    """Addresses of manifests for other hosts, by host."""


class SensorEffectModel(Answer):
    """What a plan does for one sensor."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    quantity: str
    """What is off: heading, rate at rest, acceleration, level or drift."""
    unit: str
    before: Number | None
    """Largest error with the calibration in force, in `unit`; null: what is in force is not known."""
    after: Number
    """One standard deviation of what is left, with what cannot be stored, in `unit`."""
    text: str


class ReviewModel(Answer):
    """What a plan does, and what speaks for and against it."""

    headline: str
    sensors: list[SensorEffectModel]
    criteria: list[CriterionModel]
    picture: str | None
    """Address of the picture of before and after, relative to the root of the service; null: none."""
    mountings: list[MountingModel]
    """Compasses whose mounting can be chosen."""
    mounting_choices: list[MountingChoiceModel]
    """What can be chosen."""


class SensorRecordModel(Answer):
    """One sensor as a job or a preflight measured it once."""

    sensor: Sensor
    instance: int
    """0 for the first of its kind."""
    device_id: int
    """As the firmware numbers it; 0: not known."""
    type: str
    at: Number
    """Wall-clock time, s since 1970."""
    source: ObservationSource
    source_id: str
    """The job, whose calibration can be compared and restored."""
    what: str
    """Kind of the job; `rest`: a preflight."""
    applied: bool
    """The sensor was corrected by this from then on."""
    proved: bool
    unit: str
    bias: list[Number] | None
    """Raw, in `unit`."""
    sd: list[Number] | None
    norm: Number | None
    """From a preflight: rate or specific force as the vehicle used it, in `unit`."""
    temperature: Number | None
    """degC."""
    covered: CoveredModel | None


class SensorStateModel(Answer):
    """State of one kind of calibration."""

    kind: str
    """The procedure that would calibrate it."""
    verdict: Verdict
    label: str
    """The verdict in one or two words."""
    text: str
    """When it was calibrated, at what temperature, how good it is."""
    advice: str
    """What it needs; empty: nothing."""
    at: Number | None
    """When it was calibrated, wall-clock time, s since 1970; null: never here."""
    job: str | None
    """The job that did; null: never here."""
    temperature: Number | None
    """Temperature of the calibration, degC; null: not known."""


class SeriesModel(Answer):
    """One sensor over a recording; thinned, so that its extremes stay."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    unit: str
    source: str
    """The message or column that carries it."""
    t: list[Number]
    """s since the recording began."""
    values: list[list[Number | None]]
    """A row an axis, in `unit`; null: not a finite number."""


class SigningKeyModel(Answer):
    """A signing key without the key."""

    name: str
    fingerprint: str
    """The first 12 digits of the SHA-256 of the key's 32 bytes."""
    source: Literal["settings", "file"]
    """Where it is kept."""


class TicketModel(Answer):
    """A ticket for one event stream."""

    ticket: str
    """Empty: the service runs without keys, and asks for none."""
    valid_s: Number
    """How long it is good, s."""


class UnfinishedModel(Answer):
    """A job that claims its vehicle, and what is known of the parameters that it has sent."""

    job: JobSummary
    at: Number
    """When this state was read; earlier events belong to the run that is over."""
    writing: bool
    """Parameters of the vehicle may be this job's."""
    ended: bool
    """Nothing of it is in doubt any more."""
    sent: list[str]
    """Parameters for which a PARAM_SET may have left."""
    standing: list[StandingModel]
    """What is known of each of them."""
    beginning: str
    """What is going to happen to it."""
    ending: list[str]
    """How it ended, or what is in doubt, a sentence each."""


class UnitHistoryModel(Answer):
    """Everything that was measured of a unit's sensors, oldest first, with their drifts."""

    unit: FleetUnitModel
    records: list[SensorRecordModel]


class VehicleModel(Answer):
    """A vehicle in one page."""

    id: str
    link: str
    """Id of the link in use: everything is sent over it."""
    links: list[str]
    """Ids of all links over which it was heard, the one in use first."""
    system: int
    """MAVLink system id."""
    component: int
    """MAVLink component id."""
    autopilot: Autopilot
    airframe: Airframe
    """The shape that a picture of it should have, from its MAV_TYPE."""
    firmware: str
    """Version of the firmware; empty: not known yet."""
    uid: str | None
    """Hardware id, hexadecimal; null: not known."""
    armed: bool
    landed: Landed
    silent: bool
    """No heartbeat for 3 s."""
    writable: bool
    """Whether parameters may be written now."""
    obstacles: list[str]
    """Why nothing may be written now."""
    evidence: list[str]
    """What the state rests on."""
    texts: list[str]
    """The last things that the vehicle said."""
    received: int
    """Messages received."""
    lost: int
    """Messages lost."""
    loss: Number
    """Lost share of everything sent, 0..1."""
    bytes_per_s: Number
    """Received, over the last seconds."""
    hand: Hand | None
    """Who moves it, if it is a simulated vehicle; null: it is none."""
    parameters_known: int
    """How many parameters were heard."""


class VehicleSensorsModel(Answer):
    """The four kinds of calibration of a vehicle, and what it needs now."""

    verdict: Verdict
    summary: str
    sensors: list[SensorStateModel]


class WatchModel(Answer):
    """A watch. It is over 3 s after its stream has ended, or 10 s after nothing was taken from it."""

    id: str
    """For `follow_samples`."""
    rate_hz: Number
    """The requested rate, Hz."""
