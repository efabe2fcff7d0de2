// What guides the hands: the vehicle and the wanted pose, the faces that are done, the sphere of a compass, a drift curve.

import { h } from "../../core/dom.js";
import { number, POSES, rough } from "../../core/words.js";
import { DOWN, euler, pointing, rotate, conjugate, unit, IDENTITY } from "../../scene/rotation.js";
import { current } from "../samples.js";
import { quiet } from "../parts.js";
import { handSwitch, picture } from "../stage.js";
import { driftChart } from "./drift.js";
import { held, taken } from "./pose.js";

/** @import { JobModel, Pose, PromptModel } from "../../mavcal.d.ts" */
/** @import { Quaternion, Vector } from "../../scene/rotation.js" */
/** @typedef {typeof import("../../core/store.js").store} Store */

const FACES = /** @type {Pose[]} */ (["level", "left", "right", "nose_down", "nose_up", "back"]);
const POSED = new Set(["accel", "accel-six-face", "accel-one-axis", "imu-multi", "mag-rings", "gyro-turntable"]);

/** @param {Store} store @param {JobModel} job */
export function guide(store, job) {
  if (job.state === "fitting") return h("div", { class: "working", role: "status" }, h("span", { class: "spinner", "aria-hidden": "true" }), "Computing");
  if (["applying", "waiting_for_reboot", "verifying", "rolling_back", "in_doubt"].includes(job.state)) return null;
  if (!job.vehicle_id) return null;
  if (job.kind === "mag") return compass(store, job);
  if (job.kind === "thermal") return h("div", { class: "guide" }, driftChart(job), facts(job));
  return h("div", { class: "guide" }, scene(store, job, job.prompt), POSED.has(job.kind) ? faces(store, job) : null, facts(job));
}

/** @param {Store} store @param {JobModel} job @param {PromptModel | null} prompt */
function scene(store, job, prompt) {
  const samples = current();
  const attitude = samples?.attitude ?? null;
  const vehicle = store.vehicles.get(job.vehicle_id ?? "");
  return h("div", { class: "stage" },
    picture(store, vehicle, { attitude, ghost: ghost(prompt, attitude ?? IDENTITY), words: sceneWords(prompt) }),
    prompt?.hold_s ? ring(prompt) : null,
    handSwitch(store, vehicle),
    attitude ? null : quiet("The vehicle sends no attitude: the picture stands still."));
}

/** @param {PromptModel | null} prompt */
function sceneWords(prompt) {
  const target = prompt && wantedPose(prompt);
  return target ? `The vehicle, and the pose that is asked for: ${POSES[target].toLowerCase()}` : "The vehicle as it is held now";
}

/** @param {PromptModel} prompt @returns {Pose | null} */
const wantedPose = (prompt) => prompt.pose ?? prompt.remaining[0] ?? null;

/** The attitude to be reached; null: nothing is asked, or it is held already. @param {PromptModel | null} prompt @param {Quaternion} now @returns {Quaternion | null} */
function ghost(prompt, now) {
  if (!prompt || held(prompt)) return null;
  if (prompt.direction) return pointing(now, prompt.direction);
  const pose = wantedPose(prompt);
  return pose && DOWN[pose] ? pointing(now, DOWN[pose]) : null;
}

/** Fills while the pose is held. @param {PromptModel} prompt */
function ring(prompt) {
  const length = 2 * Math.PI * 44;
  const on = held(prompt);
  return h("svg", { class: `hold-ring ${on ? "held" : ""}`, viewBox: "0 0 100 100", "aria-hidden": "true" },
    h("circle", { cx: "50", cy: "50", r: "44", class: "track" }),
    h("circle", { cx: "50", cy: "50", r: "44", class: "fill", "stroke-dasharray": `${length}`,
      style: { "stroke-dashoffset": `${on ? 0 : length}`, "transition-duration": on ? `${prompt.hold_s}s` : "0.2s" } }));
}

/** The six faces and the oblique poses. @param {Store} store @param {JobModel} job */
function faces(store, job) {
  const { prompt } = job;
  const known = store.keep(`poses ${job.id}`, () => ({ remaining: /** @type {Pose[]} */ (FACES), whole: 10, done: 0 }));
  if (prompt) known.remaining = prompt.remaining; // while it reads or computes, the tiles stay as they were
  if (job.progress?.unit === "poses") Object.assign(known, { whole: job.progress.target, done: Math.floor(job.progress.current) });
  const { whole, done } = known;
  const missing = new Set(known.remaining);
  const vehicle = store.vehicles.get(job.vehicle_id ?? "");
  const oblique = job.kind === "accel" || job.kind === "imu-multi" ? whole - 6 : 0;
  const obliqueDone = Math.max(0, done - (6 - FACES.filter((pose) => missing.has(pose)).length));
  return h("ol", { class: "faces", "aria-label": "Poses" },
    FACES.map((pose) => {
      const state = prompt?.detected === pose && !taken(prompt) ? "here" : missing.has(pose) ? "open" : "done";
      return h("li", { class: state, key: pose },
        h("attitude-scene", { flat: true, "aria-hidden": "true", scene: { airframe: vehicle?.airframe ?? "multirotor", attitude: faceAttitude(pose), ghost: null } }),
        h("span", {}, POSES[pose]), h("span", { class: "mark" }, state === "done" ? "✓ done" : state === "here" ? "now" : "open"));
    }),
    oblique > 0 ? h("li", { key: "oblique", class: obliqueDone >= oblique ? "done" : prompt?.detected === "oblique" ? "here" : "open" },
      h("attitude-scene", { flat: true, "aria-hidden": "true", scene: { airframe: vehicle?.airframe ?? "multirotor", attitude: euler(35, 30, 0), ghost: null } }),
      h("span", {}, "Oblique"), h("span", { class: "mark" }, `${Math.min(obliqueDone, oblique)} of ${oblique}`)) : null);
}

/** @type {Record<string, [number, number, number]>} roll, pitch, yaw in deg */
const EULER = { level: [0, 0, 0], left: [-90, 0, 0], right: [90, 0, 0], nose_down: [0, -90, 0], nose_up: [0, 90, 0], back: [180, 0, 0] };

/** @param {string} pose */
const faceAttitude = (pose) => euler(...EULER[pose]);

/** @param {Store} store @param {JobModel} job */
function compass(store, job) {
  const samples = current();
  const detail = /** @type {Record<string, any>} */ (job.progress?.detail ?? {});
  const chosen = store.keep(`compass ${job.id}`, () => ({ instance: "0", masks: /** @type {Record<string, number[]>} */ ({}) }));
  chosen.masks = detail.coverage_mask ?? chosen.masks; // while it reads or computes, the sphere stays as it was
  const masks = Object.entries(chosen.masks);
  const mask = masks.find(([instance]) => instance === chosen.instance)?.[1] ?? masks[0]?.[1] ?? [];
  const now = /** @type {Vector | undefined} */ (samples?.now.get(`mag ${chosen.instance}`));
  return h("div", { class: "guide compass" },
    h("div", { class: "stage" },
      h("field-sphere", { role: "img", "aria-label": `Directions covered: ${Math.round(100 * (detail.coverage ?? 0))} %`,
        field: { mask, points: [], next: job.prompt?.direction ?? null, now: now ? unit(now) : null, attitude: samples?.attitude ?? null } }),
      h("p", { class: "caption quiet small" }, "Green: covered. Blue: the field now. Orange: this side should point down, then turn a full circle.")),
    scene(store, job, job.prompt),
    h("div", { class: "compass-list" }, masks.map(([instance]) => compassCard(job, detail, instance, chosen, store))),
    h("point-cloud", { role: "img", "aria-label": "Readings of the compass: as measured, and with the calibration in force",
      cloud: { raw: samples?.cloud.get(Number(chosen.instance)) ?? [], radius: detail.model_ut ?? samples?.field ?? 50, attitude: samples?.attitude ?? null } }));
}

/** @param {JobModel} job @param {Record<string, any>} detail @param {string} instance @param {{ instance: string }} chosen @param {Store} store */
function compassCard(job, detail, instance, chosen, store) {
  const sd = detail.heading_sd_deg?.[instance];
  const field = detail.field_ut?.[instance];
  const model = detail.model_ut;
  const target = Number(job.options.uncertainty ?? 0.3);
  const off = field && model ? Math.abs(field / model - 1) : 0;
  return h("button", { class: "compass-card", key: instance, "aria-pressed": `${chosen.instance === instance}`,
    onclick: () => { chosen.instance = instance; store.changed(); } },
  h("strong", {}, `Compass ${Number(instance) + 1}`),
  h("span", { class: sd && sd <= target ? "good" : "" }, sd ? `heading ± ${rough(sd)}°, wanted ${number(target)}°` : "heading not known yet"),
  h("span", { class: off > 0.15 ? "bad" : "quiet" }, field ? `reads ${number(field, 3)} µT${model ? `, Earth ${number(model, 3)} µT` : ""}` : ""));
}

/** Numbers of a procedure that a person may want. @param {JobModel} job */
function facts(job) {
  const detail = /** @type {Record<string, any>} */ (job.progress?.detail ?? {});
  /** @type {[string, string][]} */
  const known = [];
  if (detail.offset_sd_deg_s) known.push(["Offset known to", `${rough(detail.offset_sd_deg_s)} deg/s`], ["Wanted", `${number(detail.asked_deg_s)} deg/s`]);
  if (detail.offset_sd) known.push(["Offset known to", `${rough(detail.offset_sd)} m/s²`]);
  if (detail.rate_degc_per_min !== undefined) known.push(["Temperature changes by", `${number(detail.rate_degc_per_min, 2)} °C/min`]);
  for (const [instance, degrees] of Object.entries(/** @type {Record<string, number>} */ (detail.temperature ?? {}))) {
    const span = detail.spans?.[instance];
    known.push([`IMU ${Number(instance) + 1}`, `${number(degrees, 3)} °C${span ? `, ${number(span, 2)} °C covered` : ""}`]);
  }
  return known.length ? h("dl", { class: "facts" }, known.map(([name, value], i) => h("div", { key: `${i}` }, h("dt", {}, name), h("dd", {}, value)))) : null;
}

/** The world's down, in the body. @param {Quaternion} q */
export const bodyDown = (q) => rotate(conjugate(q), [0, 0, 1]);
