// The poses as tiles: the six faces and the oblique ones, each as it is asked for, with the vehicle's own attitude in it.

import { h } from "../../core/dom.js";
import { POSES } from "../../core/words.js";
import { EYE } from "../../scene/eye.js";
import { conjugate, dot, DOWN, euler, IDENTITY, multiply, pointing, rotate, turn } from "../../scene/rotation.js";
import { current } from "../samples.js";
import { taken } from "./pose.js";

/** @import { JobModel, Pose, PromptModel, TiltModel } from "../../mavcal.d.ts" */
/** @import { Quaternion, Vector } from "../../scene/rotation.js" */
/** @typedef {typeof import("../../core/store.js").store} Store */
/** @typedef {{ remaining: Pose[], tilts: TiltModel[], faces: Pose[], asked: boolean }} Known */
/** @typedef {{ key: string, name: string, state: "open" | "here" | "done", attitude: Quaternion, down: Vector | null }} Tile */

const FACES = /** @type {Pose[]} */ (["level", "left", "right", "nose_down", "nose_up", "back"]);
/** @type {Record<string, string>} */
const SHORT = { level: "Level", left: "Left", right: "Right", nose_down: "Nose down", nose_up: "Nose up", back: "Back" };
/** @type {Record<string, [number, number, number]>} roll, pitch, yaw in deg */
const EULER = { level: [0, 0, 0], left: [-90, 0, 0], right: [90, 0, 0], nose_down: [0, -90, 0], nose_up: [0, 90, 0], back: [180, 0, 0] };
const HEADINGS = [0, 0.5, -0.5, 1, -1]; // rad
const EDGE = 0.4; // cosine between the upright axis and the line of sight below which little is seen of a flat body
const MARKS = { done: "✓", here: "●", open: "" };
const STATES = { done: "done", here: "now", open: "open" };

/** @param {Store} store @param {JobModel} job */
export function poses(store, job) {
  const { prompt } = job;
  const proving = job.state === "verifying";
  const known = /** @type {Known} */ (store.keep(`poses ${job.id} ${proving}`, () => ({
    remaining: FACES, tilts: [], asked: false, faces: proving ? prompt?.remaining ?? [] : FACES })));
  if (prompt) {
    Object.assign(known, { remaining: prompt.remaining, tilts: prompt.tilts, asked: true });
  } else if (known.asked) { // nothing is asked for any more: it reads and computes
    known.remaining = [];
    known.tilts = known.tilts.map((tilt) => ({ ...tilt, taken: true }));
  }
  const airframe = store.vehicles.get(job.vehicle_id ?? "")?.airframe ?? "multirotor";
  const tiles = [...known.faces.map((pose) => face(pose, known, prompt)), ...tilts(known, prompt)];
  return h("ol", { class: "faces", "aria-label": "Poses" }, tiles.map((tile) => h("li", { class: tile.state, key: tile.key },
    h("attitude-scene", { flat: true, "aria-hidden": "true", scene: { airframe, attitude: tile.attitude, ghost: own(tile), sides: true } }),
    h("span", { class: "name" }, tile.name),
    h("span", { class: "mark", role: "img", "aria-label": STATES[tile.state] }, MARKS[tile.state]))));
}

/** @param {Pose} pose @param {Known} known @param {PromptModel | null} prompt @returns {Tile} */
function face(pose, { remaining }, prompt) {
  const here = prompt?.detected === pose && !taken(prompt);
  const state = here ? "here" : remaining.includes(pose) ? "open" : "done";
  return { key: pose, name: SHORT[pose], state, attitude: euler(...EULER[pose]), down: null };
}

/** @param {Known} known @param {PromptModel | null} prompt @returns {Tile[]} */
function tilts({ tilts: asked, remaining }, prompt) {
  const next = asked.findIndex((tilt) => !tilt.taken);
  const facesDone = !remaining.some((pose) => FACES.includes(pose)); // the faces come first
  return asked.map(({ direction, taken: done }, i) => {
    const here = i === next && prompt?.detected === "oblique" && !taken(prompt);
    return {
      key: `tilt ${i}`, name: `Tilted ${i + 1}`, state: done ? "done" : here ? "here" : "open",
      attitude: open(pointing(IDENTITY, /** @type {Vector} */ (direction))), down: facesDone && !done ? /** @type {Vector} */ (direction) : null,
    };
  });
}

/** The same tilt with the least turn of its nose that shows more than an edge. @param {Quaternion} tilted @returns {Quaternion} */
function open(tilted) {
  const turned = HEADINGS.map((heading) => multiply(turn(DOWN.level, heading), tilted));
  return turned.find((attitude) => Math.abs(dot(rotate(attitude, DOWN.level), EYE)) > EDGE) ?? tilted;
}

/** The vehicle's own attitude beside the asked one, whatever its heading; null: it is not shown. @param {Tile} tile @returns {Quaternion | null} */
function own({ attitude, down }) {
  const now = down && current()?.attitude;
  return now ? pointing(attitude, rotate(conjugate(now), DOWN.level)) : null;
}

/** The pose in words, for a picture. @param {PromptModel | null} prompt */
export function poseWords(prompt) {
  const pose = prompt && (prompt.pose ?? prompt.remaining[0]);
  return pose ? `The vehicle, and the pose that is asked for: ${POSES[pose].toLowerCase()}` : "The vehicle as it is held now";
}
