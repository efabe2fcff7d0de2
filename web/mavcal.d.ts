// Written by scripts/generate-client from docs/openapi.json. Do not edit.
//
// Types of what the service takes and tells. A program that uses it needs no more than fetch and EventSource.

/** A MAVLink command that is sent when every parameter was read back. */
export interface AfterWriteModel {
  /** MAV_CMD. */
  command: number;
  /** Its seven parameters. */
  params: [number, number, number, number, number, number, number];
  why: string;
}

/** A sensor that is left as it is: the fit agrees with what is in force. */
export interface AgreementModel {
  sensor: Sensor;
  /** Which sensor of its kind, from 0. */
  instance: number;
  /** Root mean square of the change, in standard deviations. */
  deviation: number;
  text: string;
}

/** The shape that a picture of a vehicle has. */
export type Airframe = "multirotor" | "plane" | "boat";

/** What was answered. */
export interface AnswerData {
  value: string;
}

/** The operator answered a prompt. */
export interface AnswerEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "answer";
  data: AnswerData;
}

/** Answer the prompt of a job. */
export interface AnswerRequest {
  /** One of the answers that the prompt offers. */
  value: string;
}

/** Accept a plan. */
export interface ApplyRequest {
  /** Digest of the plan that is accepted. */
  plan_sha256: string;
  /** Restart the vehicle if the plan needs it. */
  reboot?: boolean;
  /** How long to wait for movements that prove the rest, s. */
  prove_s?: number;
  /** Look at the vehicle for some seconds afterwards and say whether it would arm now. */
  preflight?: boolean;
}

/** Whether the audit trail is as it was written. */
export interface AuditCheck {
  intact: boolean;
  /** How many there are. */
  rows: number;
  /** Digest of the newest row; kept elsewhere it vouches for all rows up to it. */
  head: string;
  /** First row that does not fit; null: all do. */
  broken_at: number | null;
}

/** Who asked for what. */
export interface AuditModel {
  /** Rows are numbered in the order of their arrival. */
  id: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  actor: string;
  action: string;
  subject: string;
  detail: Record<string, unknown>;
  /** Covers this row and all before it; null: from before there was a chain. */
  sha256: string | null;
}

/** Rows of the audit trail, oldest first. */
export interface AuditPage {
  rows: AuditModel[];
  /** `after` of the next page; null: this is the last one. */
  next: number | null;
}

/** The firmware family. */
export type Autopilot = "ardupilot" | "px4" | "other";

/** Calibrate many vehicles. */
export interface CalibrationCampaignRequest {
  /** Most items of this campaign at a time; null: its queue alone bounds it. */
  at_once?: number | null;
  /** Ids of `/vehicles`, or `all` that are heard now. */
  vehicles: string[] | "all";
  /** Only those that carry this tag; null: whatever they carry. */
  tag?: string | null;
  /** Options of every plan; confirmations belong to one plan and are refused. */
  plan_options?: PlanOptions;
  /** Accept and write every plan that nothing stands against; needs the scope write-params. */
  apply?: boolean;
  /** With `apply`: restart a vehicle whose plan needs it; else that plan stays in review. */
  reboot?: boolean;
  /** A kind of `/procedures`, such as gyro or level. */
  kind: string;
  /** Options of that procedure. */
  options?: Record<string, number | boolean>;
}

/** One parameter to be set. */
export interface ChangeModel {
  name: string;
  /** In `unit`; null: hidden, the vehicle did not list it. */
  old: number | null;
  /** In `unit`. */
  new: number;
  kind: ParameterKind;
  why: string;
  /** Standard deviation of `new`, in `unit`; null: not an estimate. */
  sd: number | null;
  /** Unit of the parameter; empty: a pure number. */
  unit: string;
  sensor: Sensor | null;
  /** Which sensor of its kind, from 0. */
  instance: number;
  needs_reboot: boolean;
  /** A setting of this session, put back when the job ends. */
  session: boolean;
}

/** Stable names of the checks, in the order of the report. */
export type CheckId = "sensors_heard" | "gyro_rest" | "gyro_noise" | "accel_force" | "compass_field" | "compass_direction" | "attitude" | "temperature" | "calibration_age" | "sensor_ids" | "parameters_changed" | "motor_compensation" | "vibration" | "onboard_calibration" | "arming_checks" | "vehicle_prearm";

/** One check; value, sd and limit are those of its worst number, null where it has none. */
export interface CheckModel {
  id: CheckId;
  verdict: Verdict;
  /** In `unit`. */
  value: number | null;
  /** Standard deviation of `value`, in `unit`: noise and whatever else limits it. */
  sd: number | null;
  /** In `unit`. */
  limit: number | null;
  /** Empty: a pure number, or none. */
  unit: string;
  reason: string;
  /** What helps; empty where nothing has to be done. */
  remedy: string;
  /** Every number and fact that the check rests on. */
  evidence: string[];
  /** What is off; several: all of them, or one of them and nothing tells which, as the reason says. */
  suspects?: string[];
}

/** The temperatures that a calibration covers, degC. */
export interface CoveredModel {
  /** degC. */
  low: number;
  /** degC. */
  high: number;
  how: string;
}

/** What speaks for or against a plan. */
export interface CriterionModel {
  id: string;
  verdict: Verdict;
  /** In `unit`; null: it has none. */
  value: number | null;
  /** In `unit`; null: it has none. */
  limit: number | null;
  unit: string;
  text: string;
  /** What helps; empty: nothing has to be done. */
  remedy: string;
}

/** A file that a job has made. */
export interface DocumentModel {
  name: string;
  /** Its address, relative to the root of the service. */
  href: string;
}

/** How a bias drifts. Slopes are along the sensor's axes; null: not determined, `open` says why. */
export interface DriftModel {
  /** Measurements that it rests on. */
  n: number;
  unit: string;
  /** How far the bias may be from what corrects it, in `unit`. */
  limit: number;
  per_year: SlopeModel[] | null;
  per_degc: SlopeModel[] | null;
  leaving: LeavingModel | null;
  open: OpenModel[];
}

/** A check of the last preflight that did not pass. */
export interface FailedCheckModel {
  id: CheckId;
  verdict: Verdict;
  reason: string;
}

/** The job did not reach its goal. */
export interface FailureModel {
  /** How much of what shows on a stream the stream has proved after the write. */
  proof: ProofLevel;
  proof_reason: string;
  unproved: UnprovedModel[];
  kind: "failure";
  code: string;
  cause: string;
  remedy: string;
}

/** What is wrong with one field of a request. */
export interface FieldError {
  field: string;
  message: string;
}

/** Whose plan it is: any difference means that it has to be made again. */
export interface FingerprintModel {
  autopilot: string;
  /** Hardware id, hexadecimal. */
  uid: string;
  firmware: string;
  /** Device ids of the sensors, by parameter. */
  device_ids: [string, number][];
}

/** Fit many uploads. */
export interface FitCampaignRequest {
  /** Most items of this campaign at a time; null: its queue alone bounds it. */
  at_once?: number | null;
  /** Ids of `/recordings`, or `all` that are there now. */
  recordings: string[] | "all";
  /** A method of `mavcal fit --help`. */
  method: string;
  /** Options of that method. */
  options?: Record<string, unknown>;
}

/** Fit an uploaded recording as a job. */
export interface FitJobRequest {
  /** A method of `mavcal fit --help`. */
  method: string;
  /** Options of that method. */
  options?: Record<string, unknown>;
  /** Id of the recording. */
  recording: string;
}

/** The calibration of one sensor with its uncertainty, and what the data do not say about it. */
export interface FitModel {
  method: string;
  sensor: Sensor;
  /** Which sensor of its kind, from 0. */
  instance: number;
  status: FitStatus;
  message: string;
  /** How many samples were given. */
  n_samples: number;
  /** How many of them were used. */
  n_used: number;
  /** Fitted on top of a calibration that is not known; never absolute values. */
  relative: boolean;
  model: SensorModel;
  /** Standard deviations in the shape of `model`; 0: held fixed. */
  sd: SensorModel;
  /** The method's own form. */
  native: Record<string, unknown>;
  /** In `unit`. */
  residual_rms: number | null;
  /** Unit of the offset. */
  unit: string;
  /** Condition number of the problem in scaled unknowns; a pure number. */
  condition_number: number | null;
  /** Names of parameters that the data do not determine. */
  undetermined: string[];
  /** For each of these: the movement that would determine it. */
  movements: Record<string, string>;
  warnings: string[];
  /** Numbers about the data. */
  quality: Record<string, unknown>;
  /** Mean temperature of the sensor, degC; null: not known. */
  temperature: number | null;
  /** Square, in the order of `parameters` and in products of their units. */
  covariance: ((number | null)[])[];
  /** Every parameter with its value, standard deviation and unit. */
  parameters: FitParameterModel[];
}

/** One parameter of a fit. */
export interface FitParameterModel {
  /** offset_x, matrix_xy, poly1_x ... */
  name: string;
  /** In `unit`; null: not determined. */
  value: number | null;
  /** Standard deviation, in `unit`; 0: held fixed; null: not determined. */
  sd: number | null;
  /** Empty: a pure number. */
  unit: string;
}

/** Fit an uploaded recording. */
export interface FitRequest {
  /** A method of `mavcal fit --help`. */
  method: string;
  /** Options of that method. */
  options?: Record<string, unknown>;
}

/** What may be done with a fit. */
export type FitStatus = "ok" | "partial" | "refused";

/** Fits of an uploaded recording. */
export interface FitsModel {
  method: string;
  /** One a sensor, as in `mavcal fit --json`. */
  fits: FitModel[];
}

/** A calibration that was run before the checks. */
export interface FixModel {
  kind: Fixable;
  job_id: string;
  state: JobState;
  /** What came of it. */
  text: string;
}

/** Kinds of jobs that want nothing but a vehicle at rest. */
export type Fixable = "gyro" | "level";

/** One sensor of a unit as it is known now. */
export interface FleetSensorModel {
  sensor: Sensor;
  /** 0 for the first of its kind. */
  instance: number;
  /** 0: not known. */
  device_id: number;
  /** Name of the part; empty: not known. */
  type: string;
  /** Bus and address of the part; empty: not known. */
  bus: string;
  /** Time of the last verified calibration, s since 1970; null: none known. */
  calibrated_at: number | null;
  /** Days since then; null: none known. */
  age_days: number | null;
  /** The job that calibrated it last. */
  job_id: string | null;
  covered: CoveredModel | null;
  /** As it was measured last, in the unit of `drift`; null: never absolutely. */
  bias: [number, number, number] | null;
  /** At which that was, degC. */
  temperature: number | null;
  drift: DriftModel;
  /** Null: fewer than six sensors of its type are known. */
  oddness: OddnessModel | null;
}

/** A unit in one row. */
export interface FleetUnitModel {
  /** `uid-` and its hardware id, or where it was heard. */
  unit: string;
  href: string;
  /** What people call it; empty: nothing. */
  name: string;
  tags: string[];
  autopilot: string;
  firmware: string;
  /** On a link of this service now. */
  connected: boolean;
  /** No heartbeat for 3 s; null: not connected. */
  silent: boolean | null;
  /** When it was identified last, s since 1970; null: not known. */
  seen_at: number | null;
  preflight: UnitPreflightModel | null;
  /** Age of its oldest calibration, days; null: a sensor has none. */
  age_days: number | null;
  /** The same by kind of sensor. */
  ages: Record<string, number | null>;
  /** For the sensor that leaves its limit first. */
  leaving: LeavingModel | null;
  needs_recalibration: boolean;
  reasons: ReasonModel[];
  sensors: FleetSensorModel[];
}

/** Diagnose the sim-to-real gap of many uploads. */
export interface GapCampaignRequest {
  /** Most items of this campaign at a time; null: its queue alone bounds it. */
  at_once?: number | null;
  /** Ids of `/recordings`, or `all` that are there now, without `sim` and `nominal`. */
  recordings: string[] | "all";
  /** Id of a simulator's recording, for all of them. */
  sim?: string | null;
  /** Ids of recordings without an effect. */
  nominal?: string[];
}

/** A diagnosis with its report. */
export interface GapModel {
  id: string;
  /** Its address, relative to the root of the service. */
  href: string;
  /** That of the job, whose id is the same. */
  state: JobState;
  /** Why it failed. */
  error: string | null;
  /** Wall-clock time, s since 1970. */
  created_at: number;
  real: string;
  sim: string | null;
  nominal: string[];
  /** As `mavcal gap --json`; null until it has succeeded. */
  report: Record<string, unknown> | null;
  /** Address of the report as a page, relative to the root of the service. */
  page: string | null;
}

/** Diagnose the sim-to-real gap of uploaded recordings. */
export interface GapRequest {
  /** Id of the recording whose gap is asked for. */
  real: string;
  /** Id of a simulator's recording, of the same flight or such a one. */
  sim?: string | null;
  /** Ids of recordings without an effect, for noise and field. */
  nominal?: string[];
  /** Seconds of processor time after which the best answer so far is given; null: 60. */
  limit_s?: number | null;
}

/** A diagnosis in a list. */
export interface GapSummary {
  id: string;
  /** Its address, relative to the root of the service. */
  href: string;
  /** That of the job, whose id is the same. */
  state: JobState;
  /** Why it failed. */
  error: string | null;
  /** Wall-clock time, s since 1970. */
  created_at: number;
  real: string;
  sim: string | null;
  nominal: string[];
}

/** Who moves a simulated vehicle. */
export type Hand = "auto" | "mouse" | "off";

/** Who moves a simulated vehicle from now on. */
export interface HandRequest {
  hand: Hand;
}

/** The process answers. */
export interface HealthModel {
  status: "ok";
}

/** Which value a parameter holds. */
export type Holds = "old" | "new" | "other" | "unknown";

/** What one autopilot keeps of a procedure's result. */
export interface HoldsModel {
  /** Parameters. */
  writes: string[];
  cannot_represent: string[];
}

/** Name and versions. */
export interface InfoModel {
  name: string;
  version: string;
  python: string;
}

/** What became of an item. */
export interface ItemData {
  /** Its place in the campaign, from 1. */
  number: number;
  /** Id of the vehicle or upload, or the file. */
  subject: string;
  outcome: ItemOutcome;
  code: string;
  text: string;
  /** The job that was begun for it. */
  job_id: string | null;
}

/** An item of the campaign has ended. */
export interface ItemEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "item";
  data: ItemData;
}

/** One vehicle or upload of a campaign. */
export interface ItemModel {
  /** Its place in the campaign, from 1. */
  number: number;
  /** Id of the vehicle or upload; for a campaign of a command, the file. */
  subject: string;
  /** File name of an upload; empty otherwise. */
  name: string;
  outcome: ItemOutcome;
  /** The outcome in one word: a problem code, the verdict of a preflight or a diagnosis, or the state of the job when the item ended. */
  code: string;
  text: string;
  /** The job that was begun for it; null: it needed none. */
  job_id: string | null;
  /** The present state of that job; null: there is none, or not any more. */
  job_state: JobState | null;
  /** s since 1970; null: not yet. */
  began_at: number | null;
  /** s since 1970; null: not yet. */
  ended_at: number | null;
  /** Report, if the campaign runs preflights. */
  preflight: PreflightModel | null;
  /** One fit for each sensor instance, if the campaign fits. */
  fits: FitModel[];
  /** Each report, if the campaign diagnoses. */
  documents: DocumentModel[];
}

/** What became of an item. */
export type ItemOutcome = "waiting" | "running" | "done" | "warned" | "review" | "refused" | "skipped" | "failed" | "in_doubt" | "cancelled";

export type JobEvent = StateEvent | PromptEvent | ProgressEvent | AnswerEvent | WarningEvent | SegmentsEvent | SetAsideEvent | JobVehicleEvent | PlanEvent | WriteEvent | VerificationEvent | StandingEvent | ReadinessEvent | ItemEvent;

/** Something happened to a job. `id` continues the stream: it is sent again as `Last-Event-ID`. */
export interface JobMessage {
  event: "job";
  id: string;
  data: JobEvent;
}

/** A job with its results. */
export interface JobModel {
  id: string;
  /** Its address, relative to the root of the service. */
  href: string;
  /** Null: the job computes something of uploads and needs no vehicle. */
  vehicle_id: string | null;
  kind: string;
  state: JobState;
  /** Wall-clock time, s since 1970. */
  created_at: number;
  /** Wall-clock time, s since 1970. */
  updated_at: number;
  progress: ProgressModel | null;
  /** What the operator is asked to do; null: nothing now. */
  prompt: PromptModel | null;
  /** Null while the job goes on, and while a plan waits that was not tried yet. */
  outcome: OutcomeModel | null;
  /** Sensors that were asked for and get no new calibration, or only a part of it; not empty: the job is done in part. */
  left_out: LeftOutModel[];
  /** Sensors that fell out and that this kind of job does not calibrate; its own result is whole. */
  broken: LeftOutModel[];
  /** Null: nothing was accepted yet. */
  last_write: WriteModel | null;
  /** Options of the procedure or method, and what an upload adds. */
  options: Record<string, unknown>;
  /** What the operator decided about the plan: given fields of PlanOptions. */
  plan_options: Record<string, unknown>;
  warnings: string[];
  /** One fit a sensor instance, as in `mavcal fit --json`. */
  results: FitModel[];
  plan: PlanModel | null;
  verification: VerificationModel | null;
  /** Would the vehicle arm now; null until it was looked at after a write that succeeded. */
  readiness: VehicleReadinessModel | null;
  /** Parameters in doubt (all that were sent, or may have been), or left to a third party. */
  standing: StandingModel[];
  /** What the job has made beside its results. */
  documents: DocumentModel[];
  /** What the fit was made of. */
  segments: SegmentModel[];
}

/** Start a calibration. */
export interface JobRequest {
  /** A kind of `/procedures`, such as gyro, accel or mag-rings. */
  kind: string;
  /** Options of that procedure. */
  options?: Record<string, number | boolean>;
  /** Options of the plan. */
  plan_options?: PlanOptions;
}

/** Where a job is. */
export type JobState = "queued" | "running" | "waiting_for_operator" | "fitting" | "review" | "applying" | "waiting_for_reboot" | "verifying" | "succeeded" | "rolling_back" | "reverted" | "in_doubt" | "failed" | "cancelled" | "interrupted";

/** A job in a list. */
export interface JobSummary {
  id: string;
  /** Its address, relative to the root of the service. */
  href: string;
  /** Null: the job computes something of uploads and needs no vehicle. */
  vehicle_id: string | null;
  kind: string;
  state: JobState;
  /** Wall-clock time, s since 1970. */
  created_at: number;
  /** Wall-clock time, s since 1970. */
  updated_at: number;
  progress: ProgressModel | null;
  /** What the operator is asked to do; null: nothing now. */
  prompt: PromptModel | null;
  /** Null while the job goes on, and while a plan waits that was not tried yet. */
  outcome: OutcomeModel | null;
  /** Sensors that were asked for and get no new calibration, or only a part of it; not empty: the job is done in part. */
  left_out: LeftOutModel[];
  /** Sensors that fell out and that this kind of job does not calibrate; its own result is whole. */
  broken: LeftOutModel[];
  /** Null: nothing was accepted yet. */
  last_write: WriteModel | null;
  /** Options of the procedure or method, and what an upload adds. */
  options: Record<string, unknown>;
}

/** The vehicle of an interrupted write, which has no unique id, is heard on another link and named by that. */
export interface JobVehicleEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "vehicle";
  data: VehicleData;
}

/** EXTENDED_SYS_STATE.landed_state. */
export type Landed = "undefined" | "on_ground" | "in_air" | "takeoff" | "landing";

/** When a bias leaves its limit; null: not within ten years from the last measurement. */
export interface LeavingModel {
  /** With 90 % it leaves between here and `latest`, s since 1970. */
  earliest: number | null;
  /** As likely before as after, s since 1970. */
  middle: number | null;
  /** End of that interval, s since 1970. */
  latest: number | null;
}

/** A sensor that was asked for and gets no new calibration, or only a part of it. */
export interface LeftOutModel {
  sensor: Sensor;
  /** Which sensor of its kind, from 0. */
  instance: number;
  reason: string;
}

/** The present state of a link. */
export interface LinkMessage {
  event: "link";
  data: LinkModel;
}

/** A link. */
export interface LinkModel {
  id: string;
  url: string;
  state: LinkState;
  /** Why it is in that state. */
  reason: string;
  /** Name of the key that signs it; null: it is not signed. */
  signing_key: string | null;
  /** Ids of the vehicles heard on it. */
  vehicles: string[];
  /** Damaged frames, which cannot be attributed to a sender. */
  crc_errors: number;
}

/** Open a link. */
export interface LinkRequest {
  /** An endpoint such as udpin:0.0.0.0:14550. */
  url: string;
}

/** Where a link stands; the reason is a sentence beside it. */
export type LinkState = "connecting" | "up" | "down" | "closed";

/** What came from the sensors of a vehicle, ten times a second. */
export interface LiveMessage {
  event: "samples";
  data: LiveModel;
}

/** Samples since the last message. */
export interface LiveModel {
  /** As they are streamed; one a sensor and instance. */
  channels: SamplesModel[];
  /** Compasses without the calibration in force, where that is known. */
  bare: SamplesModel[];
  /** Quaternion w x y z, body (front right down) to north-east-down; null: none has come. */
  attitude: [number, number, number, number] | null;
  /** Strength of the Earth's field by the World Magnetic Model, uT; null: the position is not known. */
  model_field_ut: number | null;
  /** Share of the vehicle's messages that were lost in the last 10 s, 0..1; null: none has come. */
  loss: number | null;
  /** Null: the stream is of no watch. */
  watch: WatchStatusModel | null;
}

/** State of a watch. */
export type LiveState = "asking" | "granted" | "waiting";

/** A part of the fit that this firmware cannot hold. */
export interface LossModel {
  sensor: Sensor;
  /** Which sensor of its kind, from 0. */
  instance: number;
  what: string;
  /** Largest effect of leaving it out, over all directions, in `unit`. */
  cost: number;
  unit: string;
  text: string;
}

export type Message = JobMessage | VehicleMessage | LinkMessage;

/** A method that fits a recording. */
export interface MethodModel {
  name: string;
  /** What it finds, of what. */
  summary: string;
}

/** A rotation that the firmware has by number. */
export interface MountingChoiceModel {
  /** For the plan option `mountings`. */
  number: number;
  text: string;
  /** Takes the sensor to the body. */
  matrix: number[][];
}

/** The mounting of a compass; numbers are the firmware's. */
export interface MountingModel {
  /** Which compass, from 0. */
  instance: number;
  /** What the vehicle is told now. */
  stated: number;
  stated_text: string;
  /** What the plan takes instead; null: as it was found. */
  chosen: number | null;
}

/** What would prove the parameters that are still open. */
export interface MovementModel {
  text: string;
  /** Poses to be held still. */
  faces: string[];
  /** Turn the vehicle through all directions. */
  turn: boolean;
  /** Bring the sensors to about this, degC; null: any. */
  temperature: number | null;
}

/** An empty object. */
export interface Nothing {
}

/** A number that the operator is asked for; the answer is the number as text. */
export interface NumberModel {
  name: string;
  unit: string;
  /** Least value, in `unit`. */
  low: number;
  /** Greatest value, in `unit`. */
  high: number;
}

/** Where a measurement comes from. */
export type ObservationSource = "job" | "preflight";

/** How far a sensor is from the middle of its type, in robust standard deviations of its worst axis. */
export interface OddnessModel {
  /** Robust standard deviations. */
  distance: number;
  /** A healthy group has one sensor beyond it in 1 of 100 groups. */
  limit: number;
  /** 0, 1 or 2. */
  axis: number;
  /** Sensors of this type that are known. */
  group: number;
  odd: boolean;
}

/** What the measurements do not determine. */
export interface OpenModel {
  quantity: Quantity;
  why: string;
}

/** A number or a switch that may be set when a job is started. */
export interface OptionModel {
  name: string;
  /** In `unit`; null: it has to be given. */
  default: boolean | number | null;
  help: string;
  /** Empty: a switch, or a pure number. */
  unit: string;
  /** Least value, in `unit`; null: without a limit. */
  low: number | null;
  /** Greatest value, in `unit`; null: without a limit. */
  high: number | null;
}

export type OutcomeModel = ResultModel | FailureModel | WriteFailedModel;

/** The type that a parameter has on the wire. */
export type ParameterKind = "real32" | "int32" | "int16" | "int8" | "uint8" | "uint16" | "uint32";

/** A parameter as the vehicle states it. */
export interface ParameterModel {
  name: string;
  /** In the unit that the firmware documents; null: not a finite number. */
  value: number | null;
  kind: ParameterKind;
}

/** What the stream says of one written parameter. */
export interface ParameterVerdictModel {
  name: string;
  verdict: ProofVerdict;
  /** How far the stream would be off without this parameter, in `unit`; null: not finite. */
  effect: number | null;
  /** Standard deviation of the check, in `unit`; null: not finite. */
  sd: number | null;
  unit: string;
  text: string;
  /** False: no stream depends on it; it is judged by read-back alone. */
  acts_on_stream: boolean;
}

/** The new plan. */
export interface PlanData {
  sha256: string;
}

/** The job was planned again. */
export interface PlanEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "plan";
  data: PlanData;
}

/** What would be written, in this order, why, and what it costs. */
export interface PlanModel {
  fingerprint: FingerprintModel;
  /** Digest of the parameters that the plan rests on. */
  snapshot_sha256: string;
  changes: ChangeModel[];
  losses: LossModel[];
  after: AfterWriteModel[];
  warnings: string[];
  /** Why nothing of it may be written; empty: it may be. */
  blockers: string[];
  agreements: AgreementModel[];
  /** Sensors that were fitted and are not written, or in part only. */
  left_out: LeftOutModel[];
  needs_reboot: boolean;
  /** Digest of the plan; whoever accepts it quotes this. */
  sha256: string;
}

/** What the operator decides about a plan; sensors are named gyro0 (the first gyro), accel1, mag0. */
export interface PlanOptions {
  /** Plan for these sensors alone; empty: for all that were fitted. */
  only?: string[];
  /** ArduPilot: keep the gyro offsets (INS_GYR_CAL = 0). */
  keep_gyro_at_boot?: boolean;
  /** ArduPilot: mark the sensors as calibrated. */
  mark_calibrated?: boolean;
  /** Carry the level trim over to a new accelerometer calibration. */
  adjust_level?: boolean;
  /** A compass really is mounted as the job found it. */
  confirm_mounting?: boolean;
  /** Mounting of a compass that its movement did not show, by the firmware's number. */
  mountings?: Record<string, number>;
  /** A recording without a board id is of this vehicle; the audit keeps it. */
  confirm_other_unit?: boolean;
  /** PX4: device id that no stream says, by sensor. */
  device_ids?: Record<string, number>;
  /** PX4: degC at which CAL_ACC in force was taken, by sensor. */
  accel_temperature?: Record<string, number>;
}

/** Plan again. */
export interface PlanRequest {
  /** Replaces the earlier options; null: as before. */
  plan_options?: PlanOptions | null;
}

/** How the offset follows the temperature T: the sum over k of coefficients[axis][k-1] * (T - t_ref)^k. */
export interface PolynomialModel {
  /** degC. */
  t_ref: number;
  /** degC; null: without a limit. */
  t_min: number | null;
  /** degC; null: without a limit. */
  t_max: number | null;
  /** A row an axis, from the first power on, in the unit of the fit / degC^k; null: not determined. */
  coefficients: ((number | null)[])[];
}

/** The six faces, in the order and meaning of MAVLink's ``ACCELCAL_VEHICLE_POS`` (1..6), and oblique poses. */
export type Pose = "level" | "left" | "right" | "nose_down" | "nose_up" | "back" | "oblique";

/** Check many vehicles. */
export interface PreflightCampaignRequest {
  /** Most items of this campaign at a time; null: its queue alone bounds it. */
  at_once?: number | null;
  /** Ids of `/vehicles`, or `all` that are heard now. */
  vehicles: string[] | "all";
  /** Only those that carry this tag; null: whatever they carry. */
  tag?: string | null;
}

/** Whether a vehicle is fit to fly, as far as its sensors and their calibration go. */
export interface PreflightModel {
  vehicle_id: string;
  /** Wall-clock time, s since 1970. */
  at: number;
  /** How long it took, s. */
  seconds: number;
  /** Any failure fails the whole; then warnings count, then what is unknown. */
  verdict: Verdict;
  summary: string;
  checks: CheckModel[];
  /** What stood in the way of looking. */
  notes: string[];
  fixed: FixModel[];
}

/** Check a vehicle that stands still. */
export interface PreflightRequest {
  /** True heading of its nose, deg, if it is known. */
  heading?: number | null;
  /** Calibrations that need no hands, to be run and written before it is checked; needs the scope write-params, and takes up to a minute each. */
  fix?: ("gyro" | "level")[];
}

/** A problem document (RFC 9457). */
export interface Problem {
  /** Address of the page that explains it, relative to the address of the request; it ends in `code`. */
  type: string;
  code: ProblemCode;
  title: string;
  /** That of the answer. */
  status: number;
  /** What happened, and what helps. */
  detail: string;
  /** Id under which the log of the service has the details. */
  request_id: string;
  /** Fields of an invalid request. */
  errors?: FieldError[] | null;
}

/** What kind of problem it is. */
export type ProblemCode = "answer-refused" | "authentication-required" | "campaigns-busy" | "capture-disturbed" | "capture-ended" | "capture-interrupted" | "capture-moved" | "command-forbidden" | "command-refused" | "command-timeout" | "data-dir-locked" | "disk-full" | "document-unknown" | "endpoint-refused" | "endpoint-unknown" | "export-unknown" | "file-not-processed" | "files-busy" | "gap-error" | "gap-unfinished" | "gap-unknown" | "gaps-busy" | "hand-busy" | "http" | "idempotency-key-reused" | "illegal-transition" | "internal-error" | "invalid-input" | "job-cancelled" | "job-elsewhere" | "job-error" | "job-unknown" | "lease-lost" | "link-busy" | "link-down" | "link-elsewhere" | "link-error" | "link-open" | "link-unknown" | "no-vehicle" | "not-allowed" | "not-cancellable" | "not-found" | "not-revertible" | "not-simulated" | "nothing-verified" | "other-vehicle" | "parameter-error" | "parameter-missing" | "parameter-rejected" | "parameter-timeout" | "physical-job-running" | "plan-blocked" | "plan-changed" | "plan-missing" | "port-busy" | "preflight-running" | "recording-unknown" | "signing-key-error" | "signing-key-unknown" | "signing-not-confirmed" | "store-error" | "too-many-attempts" | "too-many-streams" | "unit-unknown" | "upload-too-large" | "upload-unreadable" | "validation" | "vehicle-armed" | "vehicle-busy" | "vehicle-conflict" | "vehicle-error" | "vehicle-silent" | "vehicle-unknown" | "watch-unknown" | "write-failed" | "write-stopped";

/** A procedure: what it needs, ends on, writes and cannot represent. */
export interface ProcedureModel {
  kind: string;
  title: string;
  /** These must stream. */
  sensors: Sensor[];
  /** Used where they stream. */
  helpful: Sensor[];
  options: OptionModel[];
  needs: string;
  ends_on: string;
  autopilots: Record<string, HoldsModel>;
  /** Typical length with the default options, s of the vehicle's clock. */
  duration_s: number;
}

/** How far the job is. */
export interface ProgressEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "progress";
  data: ProgressModel;
}

/** The field list of a progress bar. */
export interface ProgressModel {
  type: "progress";
  /** In `unit`. */
  current: number;
  /** In `unit`. */
  target: number;
  unit: string;
  text: string;
  /** s of the vehicle's clock; null: cannot be said yet. */
  eta: number | null;
  /** Numbers for a panel. */
  detail: Record<string, unknown> | null;
}

/** The operator is asked to do something else, or nothing more. */
export interface PromptEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "prompt";
  /** An empty object: nothing is asked any more. */
  data: PromptModel | Nothing;
}

/** What the operator is asked to do now. */
export interface PromptModel {
  type: "prompt";
  step: PromptStep;
  text: string;
  /** The pose that is asked for; null: any, or none. */
  pose: Pose | null;
  /** Poses still missing; their order is free. */
  remaining: Pose[];
  /** How long to hold still, s. */
  hold_s: number | null;
  rotate: boolean;
  /** Body direction (front, right, down) that should point down; a unit vector. */
  direction: [number, number, number] | null;
  /** Bring the sensors to about this, degC; null: any. */
  temperature: number | null;
  /** The pose that the vehicle is in. */
  detected: Pose | null;
  /** Whether it is at rest there. */
  stable: boolean;
  /** Answers that are accepted; empty: the data answer. */
  answers: string[];
  /** Turn about this body axis (front, right, down), right-handed; a unit vector. */
  axis: [number, number, number] | null;
  /** How many turns to make; null: until the prompt changes. */
  turns: number | null;
  /** A number that is asked for beside `answers`. */
  number: NumberModel | null;
  /** The detected pose is done already: the next one is waited for. */
  taken: boolean;
  /** Oblique poses: those that were taken, then those that are asked for. */
  tilts: TiltModel[];
  /** What stays open after the answer `finish` now; empty: nothing. */
  unfinished: string;
  /** Null: the vehicle is heard. */
  silence: SilenceModel | null;
}

/** What a prompt is about, for programs: those of a capture, then those of a write. */
export type PromptStep = "hold_still" | "pose" | "place" | "rotate" | "turn" | "warm_up" | "state" | "prove" | "reboot" | "wait" | "busy" | "silent";

/** How much of what acts on a stream the stream has proved. */
export type ProofLevel = "full" | "partial" | "none";

/** Verdict on one written parameter. */
export type ProofVerdict = "proved" | "consistent" | "not_observable" | "contradicted";

/** What a trend may leave undetermined. */
export type Quantity = "time" | "temperature" | "leaving";

/** The vehicle was looked at after a write. */
export interface ReadinessEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "readiness";
  data: VehicleReadinessModel;
}

/** Whether jobs can be run. */
export interface ReadinessModel {
  status: "ready" | "not ready";
  /** What keeps jobs from being run. */
  reason?: string;
}

/** How an uploaded file is to be read; as the options of `mavcal fit`. */
export interface ReadingOptions {
  /** Canonical column: header name or 0-based number, with an optional *factor. */
  mapping?: Record<string, string>;
  world?: "ned" | "enu";
  body?: "frd" | "flu";
  /** Makes `t`, Hz. */
  rate?: number | null;
  unit_accel?: string;
  unit_gyro?: string;
  unit_mag?: string;
  /** Which vehicle of a telemetry log. */
  system?: number | null;
}

/** Why a unit should be calibrated again. */
export type ReasonCode = "never" | "age" | "drift" | "preflight";

/** Why a unit should be calibrated again. */
export interface ReasonModel {
  code: ReasonCode;
  /** Null: the unit as a whole. */
  sensor: Sensor | null;
  /** 0 for the first of its kind; null: all of them. */
  instance: number | null;
  text: string;
}

/** Plan the fits of an uploaded recording for a connected vehicle. */
export interface RecordingJobRequest {
  /** A method of `mavcal fit --help`. */
  method: string;
  /** Options of that method. */
  options?: Record<string, unknown>;
  /** The vehicle that the recording is of. */
  vehicle_id: string;
  /** Options of the plan. */
  plan_options?: PlanOptions;
}

/** An uploaded recording. */
export interface RecordingModel {
  id: string;
  /** Its address, relative to the root of the service. */
  href: string;
  name: string;
  /** Bytes. */
  size: number;
  sha256: string;
  /** Wall-clock time, s since 1970. */
  uploaded_at: number;
  /** What is in it, as `mavcal inspect --json`. */
  inspection: Record<string, unknown>;
}

/** How BlueOS lists a service; it drops the whole if one of the first seven is missing. */
export interface RegistrationModel {
  name: string;
  description: string;
  /** Name of an icon of Material Design Icons. */
  icon: string;
  company: string;
  version: string;
  webpage: string;
  /** Address of the API's page, relative to the root of the service. */
  api: string;
  /** Address of the panel below the root; empty: the root itself. */
  route: string;
  /** Whether it opens in a page of its own. */
  new_page: boolean;
  extra_query: string;
  avoid_iframes: boolean;
  works_in_relative_paths: boolean;
  /** Addresses of manifests for other hosts, by host. */
  extras: Record<string, string>;
}

/** Put the last verified calibration of many vehicles back. */
export interface RestoreCampaignRequest {
  /** Most items of this campaign at a time; null: its queue alone bounds it. */
  at_once?: number | null;
  /** Ids of `/vehicles`, or `all` that are heard now. */
  vehicles: string[] | "all";
  /** Only those that carry this tag; null: whatever they carry. */
  tag?: string | null;
  /** Options of every plan; confirmations belong to one plan and are refused. */
  plan_options?: PlanOptions;
  /** Accept and write every plan that nothing stands against; needs the scope write-params. */
  apply?: boolean;
  /** With `apply`: restart a vehicle whose plan needs it; else that plan stays in review. */
  reboot?: boolean;
}

/** Put the last verified calibration back. */
export interface RestoreRequest {
  /** These sensors alone, as gyro0 or accel1; empty: all, and what belongs to the board. */
  only?: string[];
  /** ArduPilot: mark the sensors as calibrated. */
  mark_calibrated?: boolean;
}

/** The job reached its goal. */
export interface ResultModel {
  /** How much of what shows on a stream the stream has proved after the write. */
  proof: ProofLevel;
  proof_reason: string;
  unproved: UnprovedModel[];
  kind: "result";
  text: string;
}

/** What a plan does, and what speaks for and against it. */
export interface ReviewModel {
  headline: string;
  sensors: SensorEffectModel[];
  criteria: CriterionModel[];
  /** Address of the picture of before and after, relative to the root of the service; null: none. */
  picture: string | null;
  /** Compasses whose mounting can be chosen. */
  mountings: MountingModel[];
  /** What can be chosen. */
  mounting_choices: MountingChoiceModel[];
}

/** New samples of one sensor. */
export interface SamplesModel {
  sensor: Sensor;
  /** Which sensor of its kind, from 0. */
  instance: number;
  unit: string;
  /** The message that carries it. */
  source: string;
  /** The vehicle's clock, s. */
  t: number[];
  /** A column an axis, in `unit`; null: not a finite number. */
  values: ((number | null)[])[];
}

/** A span of a telemetry log. */
export interface SegmentModel {
  /** Name of the log. */
  path: string;
  /** First byte in the log, from 0. */
  start_byte: number;
  /** The byte behind the last one. */
  end_byte: number;
  /** Digest of these bytes. */
  sha256: string;
}

/** The recording of the job is closed. */
export interface SegmentsEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "segments";
  data: Nothing;
}

/** What a channel measures; the comment gives the columns and the unit. */
export type Sensor = "accel" | "gyro" | "mag" | "temperature" | "current" | "throttle" | "motor" | "rotor_speed" | "attitude" | "position" | "velocity" | "place" | "vibration" | "gyro_vibration" | "control" | "mixer" | "voltage" | "height" | "air";

/** What a sensor should read after a write. */
export type SensorCheckId = "gyro_zero" | "accel_gravity" | "accel_direction" | "level" | "attitude";

/** Reading of one sensor after the write against zero, gravity, another unit's direction, or level. */
export interface SensorCheckModel {
  id: SensorCheckId;
  sensor: Sensor;
  /** Which sensor of its kind, from 0. */
  instance: number;
  /** How far it is off, in `unit`; null: not observed. */
  value: number | null;
  /** The most that noise, drift and the fit explain, in `unit`. */
  limit: number | null;
  unit: string;
  /** Standard deviation of `value`, in `unit`. */
  sd: number | null;
  verdict: SensorVerdict;
  text: string;
}

/** What a plan does for one sensor. */
export interface SensorEffectModel {
  sensor: Sensor;
  /** Which sensor of its kind, from 0. */
  instance: number;
  /** What is off: heading, rate at rest, acceleration, level or drift. */
  quantity: string;
  unit: string;
  /** Largest error with the calibration in force, in `unit`; null: what is in force is not known. */
  before: number | null;
  /** One standard deviation of what is left, with what cannot be stored, in `unit`. */
  after: number;
  text: string;
}

/** Corrected = matrix (measured - offset - polynomial(T)). */
export interface SensorModel {
  /** x y z, in the unit of the fit; null: not determined. */
  offset: (number | null)[];
  /** Three rows of pure numbers; null: not determined. */
  matrix: ((number | null)[])[];
  polynomial: PolynomialModel | null;
}

/** One sensor as a job or a preflight measured it once. */
export interface SensorRecordModel {
  sensor: Sensor;
  /** 0 for the first of its kind. */
  instance: number;
  /** As the firmware numbers it; 0: not known. */
  device_id: number;
  type: string;
  /** Wall-clock time, s since 1970. */
  at: number;
  source: ObservationSource;
  /** The job, whose calibration can be compared and restored. */
  source_id: string;
  /** Kind of the job; `rest`: a preflight. */
  what: string;
  /** The sensor was corrected by this from then on. */
  applied: boolean;
  proved: boolean;
  unit: string;
  /** Raw, in `unit`. */
  bias: [number, number, number] | null;
  sd: [number, number, number] | null;
  /** From a preflight: rate or specific force as the vehicle used it, in `unit`. */
  norm: number | null;
  /** degC. */
  temperature: number | null;
  covered: CoveredModel | null;
}

/** State of one kind of calibration. */
export interface SensorStateModel {
  /** The procedure that would calibrate it. */
  kind: string;
  verdict: Verdict;
  /** The verdict in one or two words. */
  label: string;
  /** When it was calibrated, at what temperature, how good it is. */
  text: string;
  /** What it needs; empty: nothing. */
  advice: string;
  /** When it was calibrated, wall-clock time, s since 1970; null: never here. */
  at: number | null;
  /** The job that did; null: never here. */
  job: string | null;
  /** Temperature of the calibration, degC; null: not known. */
  temperature: number | null;
}

/** Whether a sensor reads, after a write, what it should. */
export type SensorVerdict = "right" | "wrong" | "not_observable";

/** One sensor over a recording; thinned, so that its extremes stay. */
export interface SeriesModel {
  sensor: Sensor;
  /** Which sensor of its kind, from 0. */
  instance: number;
  unit: string;
  /** The message or column that carries it. */
  source: string;
  /** s since the recording began. */
  t: number[];
  /** A row an axis, in `unit`; null: not a finite number. */
  values: ((number | null)[])[];
}

/** What was set aside. */
export interface SetAsideData {
  /** Spans of the recording. */
  segments: number;
}

/** What was recorded so far is not used: the vehicle was disturbed, and the capture begins again. */
export interface SetAsideEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "set_aside";
  data: SetAsideData;
}

/** A signing key without the key. */
export interface SigningKeyModel {
  name: string;
  /** The first 12 digits of the SHA-256 of the key's 32 bytes. */
  fingerprint: string;
  /** Where it is kept. */
  source: "settings" | "file";
}

/** Keep a signing key. */
export interface SigningKeyRequest {
  /** What links call it: letters, digits, `.`, `_`, `-`. */
  name: string;
  /** 64 hexadecimal digits; null: a new random key. */
  key?: string | null;
}

/** Give the vehicle of a link a key. */
export interface SigningRequest {
  /** Name of the key. */
  key: string;
}

/** For how long the vehicle has not been heard. */
export interface SilenceModel {
  /** s. */
  lasted: number;
  /** After so long the job gives up, s. */
  limit: number;
}

/** A slope along one axis, with the interval that holds it with 90 %. */
export interface SlopeModel {
  /** Per year or per degC, in the unit of the drift. */
  value: number;
  /** End of the interval, same unit. */
  low: number;
  /** End of the interval, same unit. */
  high: number;
}

/** Why it is not certain. */
export interface StandingData {
  note: string;
}

/** What was known of the parameters of an interrupted write is not certain any more. */
export interface StandingEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "standing";
  data: StandingData;
}

/** What is known of one parameter that a job has written or may have written. */
export interface StandingModel {
  name: string;
  /** The value before the write, in the unit of the parameter; null: not known. */
  old: number | null;
  /** The value that was to be written, in the same unit. */
  new: number | null;
  /** The last value heard, in the same unit; null: none since the last PARAM_SET left. */
  value: number | null;
  /** False: it may have changed since. */
  certain: boolean;
  note: string;
  holds: Holds;
}

/** The state that a job has come to. */
export interface StateData {
  state: JobState;
  outcome: OutcomeModel | null;
}

/** The job has come to another state. */
export interface StateEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "state";
  data: StateData;
}

/** A ticket for one event stream. */
export interface TicketModel {
  /** Empty: the service runs without keys, and asks for none. */
  ticket: string;
  /** How long it is good, s. */
  valid_s: number;
}

/** An oblique pose that is asked for, or that was taken. */
export interface TiltModel {
  /** Body direction (front, right, down) that points down; a unit vector. */
  direction: [number, number, number];
  taken: boolean;
}

/** How a simulated vehicle is to be held. */
export interface TurnRequest {
  /** Quaternion w x y z, body (front right down) to north-east-down. */
  attitude: [number, number, number, number];
}

/** A job that claims its vehicle, and what is known of the parameters that it has sent. */
export interface UnfinishedModel {
  job: JobSummary;
  /** When this state was read; earlier events belong to the run that is over. */
  at: number;
  /** Parameters of the vehicle may be this job's. */
  writing: boolean;
  /** Nothing of it is in doubt any more. */
  ended: boolean;
  /** Parameters for which a PARAM_SET may have left. */
  sent: string[];
  /** What is known of each of them. */
  standing: StandingModel[];
  /** What is going to happen to it. */
  beginning: string;
  /** How it ended, or what is in doubt, a sentence each. */
  ending: string[];
}

/** Everything that was measured of a unit's sensors, oldest first, with their drifts. */
export interface UnitHistoryModel {
  unit: FleetUnitModel;
  records: SensorRecordModel[];
}

/** The last preflight of a unit. */
export interface UnitPreflightModel {
  /** Wall-clock time, s since 1970. */
  at: number;
  /** s since then. */
  age_s: number;
  verdict: Verdict;
  summary: string;
  failed: FailedCheckModel[];
}

/** A name, tags, or both; what is left out stays as it is. */
export interface UnitRequest {
  /** What people call it; empty: nothing any more. */
  name?: string | null;
  /** All of its tags; a key that is bound to tags may not change them. */
  tags?: string[] | null;
}

/** A parameter that no stream has proved, or a sensor that could not be seen to read right with the new values. */
export interface UnprovedModel {
  name: string;
  verdict: "consistent" | "not_observable" | "contradicted" | "wrong";
  why: string;
}

/** Whose job it is. */
export interface VehicleData {
  id: string;
}

/** The present state of a vehicle. */
export interface VehicleMessage {
  event: "vehicle";
  data: VehicleModel;
}

/** A vehicle in one page. */
export interface VehicleModel {
  id: string;
  /** Id of the link in use: everything is sent over it. */
  link: string;
  /** Ids of all links over which it was heard, the one in use first. */
  links: string[];
  /** MAVLink system id. */
  system: number;
  /** MAVLink component id. */
  component: number;
  autopilot: Autopilot;
  /** The shape that a picture of it should have, from its MAV_TYPE. */
  airframe: Airframe;
  /** Version of the firmware; empty: not known yet. */
  firmware: string;
  /** Hardware id, hexadecimal; null: not known. */
  uid: string | null;
  armed: boolean;
  landed: Landed;
  /** No heartbeat for 3 s. */
  silent: boolean;
  /** Whether parameters may be written now. */
  writable: boolean;
  /** Why nothing may be written now. */
  obstacles: string[];
  /** What the state rests on. */
  evidence: string[];
  /** The last things that the vehicle said. */
  texts: string[];
  /** Messages received. */
  received: number;
  /** Messages lost. */
  lost: number;
  /** Lost share of everything sent, 0..1. */
  loss: number;
  /** Received, over the last seconds. */
  bytes_per_s: number;
  /** Who moves it, if it is a simulated vehicle; null: it is none. */
  hand: Hand | null;
  /** How many parameters were heard. */
  parameters_known: number;
}

/** What a preflight after the write says; the event `readiness` carries the same. */
export interface VehicleReadinessModel {
  /** That of the preflight; unknown: the vehicle could not be looked at. */
  verdict: Verdict;
  /** This vehicle would arm now, or what stands against it in its own words. */
  text: string;
  /** Every check that does not pass, failures first. */
  against: string[];
}

/** The four kinds of calibration of a vehicle, and what it needs now. */
export interface VehicleSensorsModel {
  verdict: Verdict;
  summary: string;
  sensors: SensorStateModel[];
}

/** What a check, or a whole report, comes to. */
export type Verdict = "pass" | "warn" | "fail" | "unknown";

/** What the stream has proved. */
export interface VerificationData {
  proved: boolean;
  proof: ProofLevel;
}

/** The stream was checked after the write. */
export interface VerificationEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "verification";
  data: VerificationData;
}

/** The physical check of a plan: do the parameters act, and do the sensors read right with them. */
export interface VerificationModel {
  parameters: ParameterVerdictModel[];
  /** What would prove the rest; null: nothing would. */
  movement: MovementModel | null;
  sensors: SensorCheckModel[];
  /** Parameters whose sensor was not streamed or never at rest. */
  unseen: string[];
  /** Every parameter that acts on a stream is proved, and no sensor reads wrong. */
  proved: boolean;
  /** Parameters that were accepted and did not take effect. */
  contradicted: string[];
  /** Sensors that read wrong although their parameters act. */
  refuted: string[];
}

/** A warning. */
export interface WarningData {
  text: string;
}

/** The job has one warning more. */
export interface WarningEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "warning";
  data: WarningData;
}

/** A watch. It is over 3 s after its stream has ended, or 10 s after nothing was taken from it. */
export interface WatchModel {
  /** For `follow_samples`. */
  id: string;
  /** The requested rate, Hz. */
  rate_hz: number;
}

/** A wish to watch a vehicle. */
export interface WatchRequest {
  /** How often each inertial unit is to be sent, Hz. */
  rate_hz?: number;
}

/** How it stands with the rates that a watch wishes for. */
export interface WatchStatusModel {
  state: LiveState;
  /** Why samples wait, or come slower than requested; empty: they come as requested. */
  text: string;
  /** The fastest rate that anybody who watches this vehicle has requested, Hz. */
  rate_hz: number;
}

/** A write has ended. */
export interface WriteEvent {
  job_id: string;
  /** Number among the events of this job, from 1. */
  sequence: number;
  /** Wall-clock time, s since 1970. */
  at: number;
  kind: "write";
  data: WriteModel;
}

/** The plan that was accepted could not be written. Nothing was sent, and the job is in review again. */
export interface WriteFailedModel {
  /** How much of what shows on a stream the stream has proved after the write. */
  proof: ProofLevel;
  proof_reason: string;
  unproved: UnprovedModel[];
  kind: "write_failed";
  code: string;
  cause: string;
  remedy: string;
}

/** The last attempt to write a job's plan; the event `write` carries the same when it ends. */
export interface WriteModel {
  /** Failed: nothing was sent, and the job is in review again. */
  result: WriteResult;
  /** Wall-clock time, s since 1970. */
  at: number;
  cause: string;
  remedy: string;
  /** Parameters for which a PARAM_SET may have left. */
  sent: number;
}

/** Result of the last attempt to write. */
export type WriteResult = "running" | "failed" | "in_doubt" | "reverted" | "succeeded";

/** Every operation by its id: what it takes and what it answers with. */
export interface Operations {
  /** Every open link. */
  list_links: {
    method: "GET";
    path: "/api/v1/links";
    answer: LinkModel[];
  };
  /** Open a link; one that is open already is returned as it is. */
  open_link: {
    method: "POST";
    path: "/api/v1/links";
    body: LinkRequest;
    answer: LinkModel;
  };
  /** One link. */
  get_link: {
    method: "GET";
    path: "/api/v1/links/{link_id}";
    parameters: { link_id: string };
    answer: LinkModel;
  };
  /** Close a link; its recording stays. Not while a write needs it: 409. */
  close_link: {
    method: "DELETE";
    path: "/api/v1/links/{link_id}";
    parameters: { link_id: string };
    answer: null;
  };
  /** Every signing key by name, without the key. */
  list_signing_keys: {
    method: "GET";
    path: "/api/v1/signing-keys";
    answer: SigningKeyModel[];
  };
  /** Keep a signing key, or make one. */
  add_signing_key: {
    method: "POST";
    path: "/api/v1/signing-keys";
    body: SigningKeyRequest;
    answer: SigningKeyModel;
  };
  /** Forget a signing key that no open link uses. */
  remove_signing_key: {
    method: "DELETE";
    path: "/api/v1/signing-keys/{name}";
    parameters: { name: string };
    answer: null;
  };
  /** Give the one vehicle of a link a key (SETUP_SIGNING); the link is signed once the vehicle signs with it. */
  set_up_signing: {
    method: "POST";
    path: "/api/v1/links/{link_id}/signing";
    parameters: { link_id: string };
    body: SigningRequest;
    answer: LinkModel;
  };
  /** Every vehicle that was heard. */
  list_vehicles: {
    method: "GET";
    path: "/api/v1/vehicles";
    answer: VehicleModel[];
  };
  /** One vehicle. */
  get_vehicle: {
    method: "GET";
    path: "/api/v1/vehicles/{vehicle_id}";
    parameters: { vehicle_id: string };
    answer: VehicleModel;
  };
  /** Every parameter of the vehicle as heard last; `refresh` lists them again first. */
  list_parameters: {
    method: "GET";
    path: "/api/v1/vehicles/{vehicle_id}/parameters";
    parameters: { vehicle_id: string };
    query: { refresh?: boolean };
    answer: ParameterModel[];
  };
  /** How the calibrations of a vehicle stand, and what it needs now; asks the vehicle for nothing. */
  list_sensors: {
    method: "GET";
    path: "/api/v1/vehicles/{vehicle_id}/sensors";
    parameters: { vehicle_id: string };
    answer: VehicleSensorsModel;
  };
  /** Say who moves a simulated vehicle: it follows prompts by itself, a person turns it, or it stays as it is. */
  choose_hand: {
    method: "POST";
    path: "/api/v1/vehicles/{vehicle_id}/hand";
    parameters: { vehicle_id: string };
    body: HandRequest;
    answer: VehicleModel;
  };
  /** Turn a simulated vehicle whose hand is `mouse`; it gets there within a second or two. */
  turn_vehicle: {
    method: "POST";
    path: "/api/v1/vehicles/{vehicle_id}/turns";
    parameters: { vehicle_id: string };
    body: TurnRequest;
    answer: VehicleModel;
  };
  /** The vehicle's state, once a second, as long as its link is open. */
  follow_vehicle: {
    method: "GET";
    path: "/api/v1/vehicles/{vehicle_id}/stream";
    parameters: { vehicle_id: string };
    message: VehicleMessage;
  };
  /** Have the vehicle send its samples for as long as `follow_samples` is read with this watch. */
  watch_vehicle: {
    method: "POST";
    path: "/api/v1/vehicles/{vehicle_id}/watches";
    parameters: { vehicle_id: string };
    body: WatchRequest;
    answer: WatchModel;
  };
  /** What the sensors read, ten times a second, as the vehicle streams it. */
  follow_samples: {
    method: "GET";
    path: "/api/v1/vehicles/{vehicle_id}/samples";
    parameters: { vehicle_id: string };
    query: { watch?: string | null };
    message: LiveMessage;
  };
  /** Check a vehicle that stands still, in ten seconds (30 on a slow link). */
  run_preflight: {
    method: "POST";
    path: "/api/v1/vehicles/{vehicle_id}/preflight";
    parameters: { vehicle_id: string };
    body: PreflightRequest;
    answer: PreflightModel;
  };
  /** Plan to put the last verified calibration of this unit back, mapped by device id; `apply` writes the plan. */
  restore_calibration: {
    method: "POST";
    path: "/api/v1/vehicles/{vehicle_id}/restore";
    parameters: { vehicle_id: string };
    body: RestoreRequest;
    answer: JobModel;
  };
  /** What can be calibrated, what each procedure needs, ends on, writes and cannot represent. */
  list_procedures: {
    method: "GET";
    path: "/api/v1/procedures";
    answer: ProcedureModel[];
  };
  /** Start a calibration; 409 if that vehicle has one running. */
  start_job: {
    method: "POST";
    path: "/api/v1/vehicles/{vehicle_id}/jobs";
    parameters: { vehicle_id: string };
    body: JobRequest;
    answer: JobModel;
  };
  /** Jobs of every kind, a page at a time. A header `Link` with `rel="next"` leads to the next page, if any. */
  list_jobs: {
    method: "GET";
    path: "/api/v1/jobs";
    query: { vehicle_id?: string | null; kind?: string | null; state?: JobState | null; order?: "oldest" | "newest"; limit?: number; after?: string | null };
    answer: JobSummary[];
  };
  /** One job with its results. */
  get_job: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}";
    parameters: { job_id: string };
    answer: JobModel;
  };
  /** Cancel a job that has not written anything. */
  cancel_job: {
    method: "DELETE";
    path: "/api/v1/jobs/{job_id}";
    parameters: { job_id: string };
    answer: JobModel;
  };
  /** Answer the prompt of a job. */
  answer_job: {
    method: "POST";
    path: "/api/v1/jobs/{job_id}/answers";
    parameters: { job_id: string };
    body: AnswerRequest;
    answer: JobModel;
  };
  /** What would be written, why, and what it costs. */
  get_plan: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/plan";
    parameters: { job_id: string };
    answer: PlanModel;
  };
  /** Plan again on the vehicle's present parameters: what `apply` asks for when something has changed. */
  renew_plan: {
    method: "POST";
    path: "/api/v1/jobs/{job_id}/plan";
    parameters: { job_id: string };
    body: PlanRequest;
    answer: PlanModel;
  };
  /** Fit what an interrupted job has recorded. */
  refit_job: {
    method: "POST";
    path: "/api/v1/jobs/{job_id}/refit";
    parameters: { job_id: string };
    answer: JobModel;
  };
  /** Accept the plan with this digest and write it; 409 if it is no longer the plan to be written. */
  apply_plan: {
    method: "POST";
    path: "/api/v1/jobs/{job_id}/apply";
    parameters: { job_id: string };
    header: { "idempotency-key"?: string | null };
    body: ApplyRequest;
    answer: JobModel;
  };
  /** Take back what a job has written, where it still stands. */
  revert_job: {
    method: "POST";
    path: "/api/v1/jobs/{job_id}/revert";
    parameters: { job_id: string };
    answer: JobModel;
  };
  /** The result as a file: param, parm, params, json, csv or html. */
  export_job: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/export.{form}";
    parameters: { job_id: string; form: "param" | "parm" | "params" | "json" | "csv" | "html" };
    answer: string;
  };
  /** A document that the job has made, such as the report of a diagnosis. */
  get_document: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/documents/{name}";
    parameters: { job_id: string; name: string };
    answer: string;
  };
  /** Everything that happens to a job, from its beginning or from Last-Event-ID on. */
  follow_job: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/events";
    parameters: { job_id: string };
    header: { "Last-Event-ID"?: number | null };
    message: JobMessage;
  };
  /** Everything that happens: to any job, from now or from Last-Event-ID on, and to vehicles and links. */
  follow_events: {
    method: "GET";
    path: "/api/v1/events";
    header: { "Last-Event-ID"?: number | null };
    message: Message;
  };
  /** Jobs that earlier runs have left unfinished, oldest first, as they were when this service began. */
  list_unfinished: {
    method: "GET";
    path: "/api/v1/unfinished";
    answer: UnfinishedModel[];
  };
  /** What a job has sent, and what is in doubt now. */
  get_unfinished: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/unfinished";
    parameters: { job_id: string };
    answer: UnfinishedModel;
  };
  /** What the plan of a job does, and what speaks for and against it; 409 while there is no plan. */
  get_review: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/review";
    parameters: { job_id: string };
    answer: ReviewModel;
  };
  /** Each sensor before and after the plan; 409 while there is no plan, or nothing of it can be drawn. */
  get_picture: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/picture.svg";
    parameters: { job_id: string };
    query: { columns?: number | null };
    answer: string;
  };
  /** Every uploaded recording. */
  list_recordings: {
    method: "GET";
    path: "/api/v1/recordings";
    answer: RecordingModel[];
  };
  /** Upload a recording as the body of the request. */
  upload_recording: {
    method: "POST";
    path: "/api/v1/recordings";
    query: { name: string; reading?: ReadingOptions };
    body: Blob;
    answer: RecordingModel;
  };
  /** The methods that fit an uploaded recording. */
  list_methods: {
    method: "GET";
    path: "/api/v1/methods";
    answer: MethodModel[];
  };
  /** One uploaded recording, and what is in it. */
  get_recording: {
    method: "GET";
    path: "/api/v1/recordings/{recording_id}";
    parameters: { recording_id: string };
    answer: RecordingModel;
  };
  /** The sensors of an uploaded recording over its time, thinned for a picture. */
  list_series: {
    method: "GET";
    path: "/api/v1/recordings/{recording_id}/series";
    parameters: { recording_id: string };
    answer: SeriesModel[];
  };
  /** Run one method on an uploaded recording and wait for it; `POST /fits` does not wait. */
  fit_recording: {
    method: "POST";
    path: "/api/v1/recordings/{recording_id}/fits";
    parameters: { recording_id: string };
    body: FitRequest;
    answer: FitsModel;
  };
  /** A job that runs one method on an uploaded recording: followed, cancelled and listed as every other job. */
  start_fit: {
    method: "POST";
    path: "/api/v1/fits";
    body: FitJobRequest;
    answer: JobModel;
  };
  /** A job that fits an uploaded recording; then it is in review, or failed if it is not of this vehicle's sensors. */
  plan_recording: {
    method: "POST";
    path: "/api/v1/recordings/{recording_id}/jobs";
    parameters: { recording_id: string };
    body: RecordingJobRequest;
    answer: JobModel;
  };
  /** Every diagnosis, oldest first, without its report. */
  list_gaps: {
    method: "GET";
    path: "/api/v1/gaps";
    answer: GapSummary[];
  };
  /** Diagnose the sim-to-real gap of an uploaded recording; 429 if too many diagnoses are waiting. */
  diagnose_gap: {
    method: "POST";
    path: "/api/v1/gaps";
    body: GapRequest;
    answer: GapSummary;
  };
  /** Where a diagnosis stands, and its report once it is done. */
  get_gap: {
    method: "GET";
    path: "/api/v1/gaps/{gap_id}";
    parameters: { gap_id: string };
    answer: GapModel;
  };
  /** The report as a page; 409 while there is none. */
  get_gap_report: {
    method: "GET";
    path: "/api/v1/gaps/{gap_id}/report.html";
    parameters: { gap_id: string };
    answer: string;
  };
  /** Every known unit, a page at a time. */
  list_fleet: {
    method: "GET";
    path: "/api/v1/fleet";
    query: { order?: "name" | "verdict" | "age" | "leaving" | "seen"; descending?: boolean; limit?: number; after?: string | null; verdict?: ("pass" | "warn" | "fail" | "unknown" | "none")[] | null; tag?: string | null; min_age_days?: number | null; sensor?: string | null; needs_recalibration?: boolean | null; odd?: boolean | null };
    answer: FleetUnitModel[];
  };
  /** The same as a table, one row a unit, all of them. */
  export_fleet: {
    method: "GET";
    path: "/api/v1/fleet.csv";
    query: { order?: "name" | "verdict" | "age" | "leaving" | "seen"; descending?: boolean; verdict?: ("pass" | "warn" | "fail" | "unknown" | "none")[] | null; tag?: string | null; min_age_days?: number | null; sensor?: string | null; needs_recalibration?: boolean | null; odd?: boolean | null };
    answer: string;
  };
  /** One unit. */
  get_unit: {
    method: "GET";
    path: "/api/v1/fleet/{unit_id}";
    parameters: { unit_id: string };
    answer: FleetUnitModel;
  };
  /** Give a unit a name, tags, or both; they stay with its hardware id. */
  change_unit: {
    method: "PATCH";
    path: "/api/v1/fleet/{unit_id}";
    parameters: { unit_id: string };
    body: UnitRequest;
    answer: FleetUnitModel;
  };
  /** Every calibration of each sensor with its numbers, and what preflights read, oldest first. */
  get_unit_history: {
    method: "GET";
    path: "/api/v1/fleet/{unit_id}/history";
    parameters: { unit_id: string };
    answer: UnitHistoryModel;
  };
  /** Check many vehicles as one job. A vehicle that is armed, silent or busy is skipped, and its item says so. */
  start_preflight_campaign: {
    method: "POST";
    path: "/api/v1/campaigns/preflight";
    body: PreflightCampaignRequest;
    answer: JobModel;
  };
  /** Calibrate many vehicles as one job, which begins a job for each. Without `apply` their plans wait in review. */
  start_calibration_campaign: {
    method: "POST";
    path: "/api/v1/campaigns/calibrate";
    body: CalibrationCampaignRequest;
    answer: JobModel;
  };
  /** Put the last verified calibration of many vehicles back as a job; without `apply` their plans wait in review. */
  start_restore_campaign: {
    method: "POST";
    path: "/api/v1/campaigns/restore";
    body: RestoreCampaignRequest;
    answer: JobModel;
  };
  /** Run one method on many uploads as one job; the fits are in its items. */
  start_fit_campaign: {
    method: "POST";
    path: "/api/v1/campaigns/fit";
    body: FitCampaignRequest;
    answer: JobModel;
  };
  /** Diagnose the sim-to-real gap of many uploads as one job; the reports are documents of its items. */
  start_gap_campaign: {
    method: "POST";
    path: "/api/v1/campaigns/gap";
    body: GapCampaignRequest;
    answer: JobModel;
  };
  /** Go on with a campaign that was interrupted; what has ended is not done again. */
  resume_campaign: {
    method: "POST";
    path: "/api/v1/campaigns/{job_id}/resume";
    parameters: { job_id: string };
    answer: JobModel;
  };
  /** Stop a running campaign so that it can be resumed; jobs that it has begun go on. */
  interrupt_campaign: {
    method: "POST";
    path: "/api/v1/campaigns/{job_id}/interrupt";
    parameters: { job_id: string };
    answer: JobModel;
  };
  /** Items of a campaign, a page at a time; other jobs have none. A header `Link` leads to the next page, if any. */
  list_items: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/items";
    parameters: { job_id: string };
    query: { outcome?: ItemOutcome[] | null; after?: number; limit?: number };
    answer: ItemModel[];
  };
  /** The outcome of a campaign as a table: one line an item. */
  export_items: {
    method: "GET";
    path: "/api/v1/jobs/{job_id}/items.{form}";
    parameters: { job_id: string; form: "csv" };
    query: { outcome?: ItemOutcome[] | null };
    answer: string;
  };
  /** Whether the process answers. */
  get_health: {
    method: "GET";
    path: "/healthz";
    answer: HealthModel;
  };
  /** Whether jobs can be run: the store takes writes and nothing stands in the way. */
  get_readiness: {
    method: "GET";
    path: "/readyz";
    answer: ReadinessModel;
  };
  /** Counters in the format of Prometheus. */
  get_metrics: {
    method: "GET";
    path: "/metrics";
    answer: string;
  };
  /** Name and versions. */
  get_info: {
    method: "GET";
    path: "/info";
    answer: InfoModel;
  };
  /** How BlueOS lists the service. */
  get_registration: {
    method: "GET";
    path: "/register_service";
    answer: RegistrationModel;
  };
  /** What a problem code means; the `type` of a problem document leads here. */
  explain_problem: {
    method: "GET";
    path: "/problems/{code}";
    parameters: { code: string };
    answer: string;
  };
  /** Make a ticket for one event stream. */
  make_ticket: {
    method: "POST";
    path: "/api/v1/tickets";
    answer: TicketModel;
  };
  /** Who asked for what, oldest first, a page at a time. */
  list_audit: {
    method: "GET";
    path: "/api/v1/audit";
    query: { after?: number; limit?: number };
    answer: AuditPage;
  };
  /** Check the hash chain of the audit trail. */
  check_audit: {
    method: "GET";
    path: "/api/v1/audit/check";
    answer: AuditCheck;
  };
}
