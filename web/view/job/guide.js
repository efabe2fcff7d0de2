// What guides the hands: the vehicle and the wanted pose with its ring, the tiles of the poses, or a drift curve.

import { h } from "../../core/dom.js";
import { number, rough } from "../../core/words.js";
import { seen as projected } from "../../scene/eye.js";
import { DOWN, pointing, rotate, IDENTITY } from "../../scene/rotation.js";
import { current } from "../samples.js";
import { quiet } from "../parts.js";
import { handSwitch, picture } from "../stage.js";
import { compass, compassCloud } from "./compass.js";
import { driftChart } from "./drift.js";
import { held } from "./pose.js";
import { poses, poseWords } from "./poses.js";

/** @import { JobModel, PromptModel } from "../../mavcal.d.ts" */
/** @import { Quaternion, Vector } from "../../scene/rotation.js" */
/** @typedef {typeof import("../../core/store.js").store} Store */

const POSED = new Set(["accel", "accel-six-face", "accel-one-axis", "imu-multi", "mag-rings", "gyro-turntable"]);
const WRITING = new Set(["applying", "waiting_for_reboot", "verifying", "rolling_back", "in_doubt"]);

/** @param {Store} store @param {JobModel} job */
export function guide(store, job) {
  const { prompt } = job;
  if (job.state === "fitting") return h("div", { class: "working", role: "status" }, h("span", { class: "spinner", "aria-hidden": "true" }), "Computing");
  if (!job.vehicle_id) return null;
  if (WRITING.has(job.state)) {
    if (prompt?.step !== "prove") return null;
    return h("div", { class: "guide" }, scene(store, job), prompt.remaining.length ? poses(store, job) : null);
  }
  if (job.kind === "mag") return compass(store, job);
  if (job.kind === "thermal") return h("div", { class: "guide" }, driftChart(job), facts(job));
  return h("div", { class: "guide" }, scene(store, job), POSED.has(job.kind) ? poses(store, job) : null);
}

/** What a person may want to see besides. @param {Store} store @param {JobModel} job */
export function besides(store, job) {
  if (job.kind === "mag" && !WRITING.has(job.state)) return compassCloud(store, job);
  return job.kind === "thermal" ? [] : [facts(job)];
}

/** @param {Store} store @param {JobModel} job */
function scene(store, job) {
  const attitude = current()?.attitude ?? null;
  const vehicle = store.vehicles.get(job.vehicle_id ?? "");
  const prompt = job.prompt?.step === "silent" ? null : job.prompt; // nothing can be shown to be right then
  const wanted = prompt && !held(prompt) ? wantedDown(prompt) : null;
  const now = attitude ?? IDENTITY;
  return h("div", { class: "stage" },
    picture(store, vehicle, { attitude, ghost: wanted && pointing(now, wanted), words: poseWords(prompt) }),
    wanted && attitude ? arrow(now, wanted) : null,
    prompt?.hold_s ? ring(prompt) : null,
    handSwitch(store, vehicle),
    attitude ? null : quiet("The vehicle sends no attitude: the picture stands still."));
}

/** The body direction that should point down; null: nothing is asked. @param {PromptModel} prompt @returns {Vector | null} */
function wantedDown(prompt) {
  if (prompt.direction) return /** @type {Vector} */ (prompt.direction);
  const pose = prompt.pose ?? prompt.remaining[0];
  return (pose && DOWN[pose]) || null;
}

/** From the side that should point down to where it should be. @param {Quaternion} attitude @param {Vector} down */
function arrow(attitude, down) {
  const [[x0, y0], [x1, y1]] = [projected(rotate(attitude, down)), projected([0, 0, 1])];
  const length = Math.hypot(x1 - x0, y1 - y0);
  if (length < 0.25) return null;
  const [ux, uy] = [(x1 - x0) / length, (y1 - y0) / length];
  const bow = `${(x0 + x1) / 2 - 0.3 * uy} ${-((y0 + y1) / 2 + 0.3 * ux)}`;
  const tip = [[x1, y1], [x1 - 0.22 * ux - 0.12 * uy, y1 - 0.22 * uy + 0.12 * ux], [x1 - 0.22 * ux + 0.12 * uy, y1 - 0.22 * uy - 0.12 * ux]];
  return h("svg", { class: "turn-arrow", viewBox: "-1.5 -1.5 3 3", "aria-hidden": "true" },
    h("path", { d: `M ${x0} ${-y0} Q ${bow} ${x1 - 0.15 * ux} ${-(y1 - 0.15 * uy)}`, class: "shaft" }),
    h("path", { d: `M ${tip.map(([x, y]) => `${x} ${-y}`).join(" L ")} Z`, class: "tip" }));
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
  return known.length ? h("dl", { class: "facts", key: "facts" }, known.map(([name, value], i) => h("div", { key: `${i}` }, h("dt", {}, name), h("dd", {}, value)))) : null;
}
