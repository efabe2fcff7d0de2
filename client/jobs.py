"""Jobs, and what they are made of."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from mavcal.client.base import Answer, Number
from mavcal.client.enums import (
    FitStatus,
    Holds,
    JobState,
    ParameterKind,
    Pose,
    PromptStep,
    ProofLevel,
    ProofVerdict,
    Sensor,
    SensorCheckId,
    SensorVerdict,
    Verdict,
    WriteResult,
)


class AfterWriteModel(Answer):
    """A MAVLink command that is sent when every parameter was read back."""

    command: int
    """MAV_CMD."""
    params: list[Number]
    """Its seven parameters."""
    why: str


class AgreementModel(Answer):
    """A sensor that is left as it is: the fit agrees with what is in force."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    deviation: Number
    """Root mean square of the change, in standard deviations."""
    text: str


class ChangeModel(Answer):
    """One parameter to be set."""

    name: str
    old: Number | None
    """In `unit`; null: hidden, the vehicle did not list it."""
    new: Number
    """In `unit`."""
    kind: ParameterKind
    why: str
    sd: Number | None
    """Standard deviation of `new`, in `unit`; null: not an estimate."""
    unit: str
    """Unit of the parameter; empty: a pure number."""
    sensor: Sensor | None
    instance: int
    """Which sensor of its kind, from 0."""
    needs_reboot: bool
    session: bool
    """A setting of this session, put back when the job ends."""


class DocumentModel(Answer):
    """A file that a job has made."""

    name: str
    href: str
    """Its address, relative to the root of the service."""


class UnprovedModel(Answer):
    """A parameter that no stream has proved, or a sensor that could not be seen to read right with the new values."""

    name: str
    verdict: Literal["consistent", "not_observable", "contradicted", "wrong"]
    why: str


class AnyOutcomeModel(Answer):
    """What every OutcomeModel has."""

    proof: ProofLevel
    """How much of what shows on a stream the stream has proved after the write."""
    proof_reason: str
    unproved: list[UnprovedModel]


class FailureModel(AnyOutcomeModel):
    """The job did not reach its goal."""

    kind: Literal["failure"]
    code: str
    cause: str
    remedy: str


class FingerprintModel(Answer):
    """Whose plan it is: any difference means that it has to be made again."""

    autopilot: str
    uid: str
    """Hardware id, hexadecimal."""
    firmware: str
    device_ids: list[tuple[str, int]]
    """Device ids of the sensors, by parameter."""


class PolynomialModel(Answer):
    """How the offset follows the temperature T: the sum over k of coefficients[axis][k-1] * (T - t_ref)^k."""

    t_ref: Number
    """degC."""
    t_min: Number | None
    """degC; null: without a limit."""
    t_max: Number | None
    """degC; null: without a limit."""
    coefficients: list[list[Number | None]]
    """A row an axis, from the first power on, in the unit of the fit / degC^k; null: not determined."""


class SensorModel(Answer):
    """Corrected = matrix (measured - offset - polynomial(T))."""

    offset: list[Number | None]
    """x y z, in the unit of the fit; null: not determined."""
    matrix: list[list[Number | None]]
    """Three rows of pure numbers; null: not determined."""
    polynomial: PolynomialModel | None


class FitParameterModel(Answer):
    """One parameter of a fit."""

    name: str
    """offset_x, matrix_xy, poly1_x ..."""
    value: Number | None
    """In `unit`; null: not determined."""
    sd: Number | None
    """Standard deviation, in `unit`; 0: held fixed; null: not determined."""
    unit: str
    """Empty: a pure number."""


class FitModel(Answer):
    """The calibration of one sensor with its uncertainty, and what the data do not say about it."""

    method: str
    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    status: FitStatus
    message: str
    n_samples: int
    """How many samples were given."""
    n_used: int
    """How many of them were used."""
    relative: bool
    """Fitted on top of a calibration that is not known; never absolute values."""
    model: SensorModel
    sd: SensorModel
    """Standard deviations in the shape of `model`; 0: held fixed."""
    native: dict[str, Any]
    """The method's own form."""
    residual_rms: Number | None
    """In `unit`."""
    unit: str
    """Unit of the offset."""
    condition_number: Number | None
    """Condition number of the problem in scaled unknowns; a pure number."""
    undetermined: list[str]
    """Names of parameters that the data do not determine."""
    movements: dict[str, str]
    """For each of these: the movement that would determine it."""
    warnings: list[str]
    quality: dict[str, Any]
    """Numbers about the data."""
    temperature: Number | None
    """Mean temperature of the sensor, degC; null: not known."""
    covariance: list[list[Number | None]]
    """Square, in the order of `parameters` and in products of their units."""
    parameters: list[FitParameterModel]
    """Every parameter with its value, standard deviation and unit."""


class ProgressModel(Answer):
    """The field list of a progress bar."""

    type: Literal["progress"]
    current: Number
    """In `unit`."""
    target: Number
    """In `unit`."""
    unit: str
    text: str
    eta: Number | None
    """s of the vehicle's clock; null: cannot be said yet."""
    detail: dict[str, Any] | None
    """Numbers for a panel."""


class NumberModel(Answer):
    """A number that the operator is asked for; the answer is the number as text."""

    name: str
    unit: str
    low: Number
    """Least value, in `unit`."""
    high: Number
    """Greatest value, in `unit`."""


class TiltModel(Answer):
    """An oblique pose that is asked for, or that was taken."""

    direction: list[Number]
    """Body direction (front, right, down) that points down; a unit vector."""
    taken: bool


class SilenceModel(Answer):
    """For how long the vehicle has not been heard."""

    lasted: Number
    """s."""
    limit: Number
    """After so long the job gives up, s."""


class PromptModel(Answer):
    """What the operator is asked to do now."""

    type: Literal["prompt"]
    step: PromptStep
    text: str
    pose: Pose | None
    """The pose that is asked for; null: any, or none."""
    remaining: list[Pose]
    """Poses still missing; their order is free."""
    hold_s: Number | None
    """How long to hold still, s."""
    rotate: bool
    direction: list[Number] | None
    """Body direction (front, right, down) that should point down; a unit vector."""
    temperature: Number | None
    """Bring the sensors to about this, degC; null: any."""
    detected: Pose | None
    """The pose that the vehicle is in."""
    stable: bool
    """Whether it is at rest there."""
    answers: list[str]
    """Answers that are accepted; empty: the data answer."""
    axis: list[Number] | None
    """Turn about this body axis (front, right, down), right-handed; a unit vector."""
    turns: Number | None
    """How many turns to make; null: until the prompt changes."""
    number: NumberModel | None
    """A number that is asked for beside `answers`."""
    taken: bool
    """The detected pose is done already: the next one is waited for."""
    tilts: list[TiltModel]
    """Oblique poses: those that were taken, then those that are asked for."""
    unfinished: str
    """What stays open after the answer `finish` now; empty: nothing."""
    silence: SilenceModel | None
    """Null: the vehicle is heard."""


class ResultModel(AnyOutcomeModel):
    """The job reached its goal."""

    kind: Literal["result"]
    text: str


class WriteFailedModel(AnyOutcomeModel):
    """The plan that was accepted could not be written. Nothing was sent, and the job is in review again."""

    kind: Literal["write_failed"]
    code: str
    cause: str
    remedy: str


OutcomeModel = Annotated[ResultModel | FailureModel | WriteFailedModel, Field(discriminator="kind")]
"""One of OutcomeModel."""


class LeftOutModel(Answer):
    """A sensor that was asked for and gets no new calibration, or only a part of it."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    reason: str


class WriteModel(Answer):
    """The last attempt to write a job's plan; the event `write` carries the same when it ends."""

    result: WriteResult
    """Failed: nothing was sent, and the job is in review again."""
    at: Number
    """Wall-clock time, s since 1970."""
    cause: str
    remedy: str
    sent: int
    """Parameters for which a PARAM_SET may have left."""


class LossModel(Answer):
    """A part of the fit that this firmware cannot hold."""

    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    what: str
    cost: Number
    """Largest effect of leaving it out, over all directions, in `unit`."""
    unit: str
    text: str


class PlanModel(Answer):
    """What would be written, in this order, why, and what it costs."""

    fingerprint: FingerprintModel
    snapshot_sha256: str
    """Digest of the parameters that the plan rests on."""
    changes: list[ChangeModel]
    losses: list[LossModel]
    after: list[AfterWriteModel]
    warnings: list[str]
    blockers: list[str]
    """Why nothing of it may be written; empty: it may be."""
    agreements: list[AgreementModel]
    left_out: list[LeftOutModel]
    """Sensors that were fitted and are not written, or in part only."""
    needs_reboot: bool
    sha256: str
    """Digest of the plan; whoever accepts it quotes this."""


class ParameterVerdictModel(Answer):
    """What the stream says of one written parameter."""

    name: str
    verdict: ProofVerdict
    effect: Number | None
    """How far the stream would be off without this parameter, in `unit`; null: not finite."""
    sd: Number | None
    """Standard deviation of the check, in `unit`; null: not finite."""
    unit: str
    text: str
    acts_on_stream: bool
    """False: no stream depends on it; it is judged by read-back alone."""


class MovementModel(Answer):
    """What would prove the parameters that are still open."""

    text: str
    faces: list[str]
    """Poses to be held still."""
    turn: bool
    """Turn the vehicle through all directions."""
    temperature: Number | None
    """Bring the sensors to about this, degC; null: any."""


class SensorCheckModel(Answer):
    """Reading of one sensor after the write against zero, gravity, another unit's direction, or level."""

    id: SensorCheckId
    sensor: Sensor
    instance: int
    """Which sensor of its kind, from 0."""
    value: Number | None
    """How far it is off, in `unit`; null: not observed."""
    limit: Number | None
    """The most that noise, drift and the fit explain, in `unit`."""
    unit: str
    sd: Number | None
    """Standard deviation of `value`, in `unit`."""
    verdict: SensorVerdict
    text: str


class VerificationModel(Answer):
    """The physical check of a plan: do the parameters act, and do the sensors read right with them."""

    parameters: list[ParameterVerdictModel]
    movement: MovementModel | None
    """What would prove the rest; null: nothing would."""
    sensors: list[SensorCheckModel]
    unseen: list[str]
    """Parameters whose sensor was not streamed or never at rest."""
    proved: bool
    """Every parameter that acts on a stream is proved, and no sensor reads wrong."""
    contradicted: list[str]
    """Parameters that were accepted and did not take effect."""
    refuted: list[str]
    """Sensors that read wrong although their parameters act."""


class VehicleReadinessModel(Answer):
    """What a preflight after the write says; the event `readiness` carries the same."""

    verdict: Verdict
    """That of the preflight; unknown: the vehicle could not be looked at."""
    text: str
    """This vehicle would arm now, or what stands against it in its own words."""
    against: list[str]
    """Every check that does not pass, failures first."""


class StandingModel(Answer):
    """What is known of one parameter that a job has written or may have written."""

    name: str
    old: Number | None
    """The value before the write, in the unit of the parameter; null: not known."""
    new: Number | None
    """The value that was to be written, in the same unit."""
    value: Number | None
    """The last value heard, in the same unit; null: none since the last PARAM_SET left."""
    certain: bool
    """False: it may have changed since."""
    note: str
    holds: Holds


class SegmentModel(Answer):
    """A span of a telemetry log."""

    path: str
    """Name of the log."""
    start_byte: int
    """First byte in the log, from 0."""
    end_byte: int
    """The byte behind the last one."""
    sha256: str
    """Digest of these bytes."""


class JobModel(Answer):
    """A job with its results."""

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
    plan_options: dict[str, Any]
    """What the operator decided about the plan: given fields of PlanOptions."""
    warnings: list[str]
    results: list[FitModel]
    """One fit a sensor instance, as in `mavcal fit --json`."""
    plan: PlanModel | None
    verification: VerificationModel | None
    readiness: VehicleReadinessModel | None
    """Would the vehicle arm now; null until it was looked at after a write that succeeded."""
    standing: list[StandingModel]
    """Parameters in doubt (all that were sent, or may have been), or left to a third party."""
    documents: list[DocumentModel]
    """What the job has made beside its results."""
    segments: list[SegmentModel]
    """What the fit was made of."""
