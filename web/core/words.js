// Numbers, times and names as a person reads them.

/** @import { JobState, Pose } from "../mavcal.d.ts" */

/** @param {string} text */
export const words = (text) => text.replaceAll("_", " ");

/** @param {string} text */
export const sentence = (text) => (text ? text[0].toUpperCase() + text.slice(1) : "");

/** So many significant digits, without an exponent where that can be read. @param {number | null | undefined} value */
export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return Number(value.toPrecision(digits)).toString();
}

/** A standard deviation: two digits are enough. @param {number | null | undefined} value */
export const rough = (value) => number(value, 2);

/** A unit as it is read. @param {string} unit */
export const unitText = (unit) => unit.replace("m/s2", "m/s²").replace("uT", "µT");

/** @param {number} value @param {string} unit */
export const withUnit = (value, unit) => (unit ? `${number(value)} ${unit}` : number(value));

/** A length of time. @param {number | null | undefined} seconds */
export function span(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  if (seconds < 90) return `${Math.max(0, Math.ceil(seconds))} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} days`;
}

/** How long ago, from a wall-clock time in s. @param {number} at */
export function ago(at, now = Date.now() / 1000) {
  const passed = Math.max(0, now - at);
  return passed < 60 ? "just now" : `${span(passed)} ago`;
}

/** A wall-clock time, s. @param {number} at */
export const moment = (at) => new Date(1000 * at).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });

/** @param {number} bytes */
export function size(bytes) {
  if (bytes < 1e6) return `${Math.max(1, Math.round(bytes / 1e3))} kB`;
  return bytes < 1e9 ? `${number(bytes / 1e6, 3)} MB` : `${number(bytes / 1e9, 3)} GB`;
}

/** @type {Record<Pose, string>} */
export const POSES = {
  level: "Level",
  left: "Left side down",
  right: "Right side down",
  nose_down: "Nose down",
  nose_up: "Nose up",
  back: "On its back",
  oblique: "Tilted",
};

/** What a state of a job means to a person. @type {Record<JobState, string>} */
export const STATES = {
  queued: "Waiting for its turn",
  running: "Measuring",
  waiting_for_operator: "Waiting for you",
  fitting: "Computing",
  review: "Ready for your review",
  applying: "Writing",
  waiting_for_reboot: "Vehicle restarts",
  verifying: "Checking on the vehicle",
  succeeded: "Done",
  rolling_back: "Taking back",
  reverted: "Taken back",
  in_doubt: "In doubt",
  failed: "Failed",
  cancelled: "Cancelled",
  interrupted: "Interrupted",
};

/** Which color and sign a state has. @param {JobState} state @returns {"good" | "warn" | "bad" | "busy"} */
export function tone(state) {
  if (state === "succeeded") return "good";
  if (state === "failed" || state === "in_doubt") return "bad";
  if (["review", "reverted", "cancelled", "interrupted"].includes(state)) return "warn";
  return "busy";
}

/** @type {Record<string, string>} */
export const AUTOPILOTS = { ardupilot: "ArduPilot", px4: "PX4", other: "Autopilot" };

/** @type {Record<string, string>} */
export const LANDED = {
  undefined: "landed state unknown", on_ground: "on the ground", in_air: "in the air", takeoff: "taking off", landing: "landing",
};

/** @type {Record<string, string>} */
export const SENSORS = { gyro: "Gyro", accel: "Accelerometer", mag: "Compass", temperature: "Temperature" };

/** What a compass, gyro ... is called beside its siblings. @param {string} sensor @param {number} instance */
export const unitName = (sensor, instance) => `${SENSORS[sensor] ?? words(sensor)} ${instance + 1}`;

/** Names that a pilot uses; the service's own titles say how a method works. @type {Record<string, string>} */
export const KINDS = {
  gyro: "Gyro",
  accel: "Accelerometer",
  mag: "Compass",
  thermal: "Temperature",
  level: "Level horizon",
  "accel-one-axis": "Accelerometer, one pose",
  "accel-six-face": "Accelerometer on a block",
  "mag-rings": "Compass on six faces",
  "mag-fixed-yaw": "Compass at one heading",
  "gyro-turntable": "Gyro on a turntable",
  "gyro-thread": "Gyro on a thread",
  "imu-multi": "Accelerometer and gyro together",
  fit: "Fit of a log",
  gap: "Gap diagnosis",
  recording: "Calibration from a log",
  restore: "Restore",
  campaign: "Campaign",
  preflight: "Preflight",
};

/** @param {string} kind */
export const kindName = (kind) => KINDS[kind] ?? sentence(words(kind));
