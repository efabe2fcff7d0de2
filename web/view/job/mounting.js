// How a compass is mounted, if that is not as the parameters say: in words, in a picture, to be confirmed or chosen.

import { h } from "../../core/dom.js";
import { unitName } from "../../core/words.js";
import { IDENTITY } from "../../scene/rotation.js";

/** @import { JobModel, MountingModel, ReviewModel, VehicleModel } from "../../mavcal.d.ts" */
/** @import { Quaternion } from "../../scene/rotation.js" */

const ENDS = [["the nose", "the tail"], ["the right side", "the left side"], ["the underside", "the top"]];

const TURNED = new Set(["rotated", "by_angles"]);

/**
 * Each compass that is mounted otherwise than stated, and what may be chosen instead.
 * @param {JobModel} job @param {VehicleModel | undefined} vehicle @param {ReviewModel | undefined} review
 * @param {Record<string, any>} options @param {(change: Record<string, any>) => void} again
 */
export function mountings(job, vehicle, review, options, again) {
  const known = review?.mountings ?? [];
  const chosen = new Set(known.filter((one) => one.chosen !== null).map((one) => one.instance));
  return [...found(job, vehicle, chosen),
    ...known.map((one) => chooser(one, vehicle, /** @type {ReviewModel} */ (review), options, again))];
}

/**
 * @param {MountingModel} compass @param {VehicleModel | undefined} vehicle @param {ReviewModel} review
 * @param {Record<string, any>} options @param {(change: Record<string, any>) => void} again
 */
function chooser(compass, vehicle, review, options, again) {
  const [key, name] = [`mag${compass.instance}`, unitName("mag", compass.instance)];
  const choice = review.mounting_choices.find(({ number }) => number === compass.chosen);
  const choose = (/** @type {Event} */ event) => {
    const { value } = /** @type {HTMLSelectElement} */ (event.target);
    const { [key]: _, ...others } = options.mountings ?? {};
    again({ mountings: value === "" ? others : { ...others, [key]: Number(value) }, confirm_mounting: false });
  };
  const words = `${name} as chosen: ${choice?.text}.`;
  return h("div", { class: "mounting-choice", key: `choice ${key}` },
    choice ? picture(words, "Solid: how the compass is turned. Outline: the vehicle.", vehicle, choice.matrix) : null,
    h("label", {}, `Mounting of ${name.toLowerCase()}`,
      h("select", { onchange: choose },
        h("option", { value: "", selected: !choice }, `As its movement shows it; stated now: ${compass.stated_text}`),
        review.mounting_choices.map(({ number, text }) => h("option", { value: `${number}`, selected: number === compass.chosen }, text)))));
}

/** @param {string} words @param {string} legend @param {VehicleModel | undefined} vehicle @param {number[][]} matrix */
function picture(words, legend, vehicle, matrix) {
  return h("figure", { class: "mounting" },
    h("attitude-scene", { role: "img", "aria-label": words,
      scene: { airframe: vehicle?.airframe ?? "multirotor", attitude: quaternion(matrix), ghost: IDENTITY } }),
    h("figcaption", {}, words, h("span", { class: "quiet small" }, ` ${legend}`)));
}

/** @param {JobModel} job @param {VehicleModel | undefined} vehicle @param {Set<number>} chosen */
function found(job, vehicle, chosen) {
  return job.results.filter((fit) => fit.sensor === "mag" && !chosen.has(fit.instance)).map((fit) => {
    const found = /** @type {{ verdict?: string, name?: string, matrix?: number[][] } | undefined} */ (fit.quality.orientation);
    if (!TURNED.has(found?.verdict ?? "") || !found?.matrix) return null;
    const name = unitName(fit.sensor, fit.instance);
    const words = found.verdict === "by_angles" ? `${name} is turned against what is stated: ${found.name}.` : `${name} ${turned(found.matrix)}.`;
    return h("div", { key: `${fit.instance}` }, picture(words, "Solid: how the compass sees the vehicle. Outline: how it stands.", vehicle, found.matrix));
  }).filter((figure) => figure !== null);
}

/** Where the axes of a rotation (3, 3) lead, in words; empty: nowhere else. @param {number[][]} matrix */
function turned(matrix) {
  const said = [0, 2].map((axis) => {
    const column = matrix.map((row) => row[axis]);
    const to = column.reduce((best, part, i) => (Math.abs(part) > Math.abs(column[best]) ? i : best), 0);
    return to === axis && column[to] > 0 ? "" : `takes ${ENDS[to][column[to] > 0 ? 0 : 1]} for ${ENDS[axis][0]}`;
  }).filter(Boolean);
  return said.join(" and ");
}

/** The quaternion of a rotation; the largest of its parts is computed first, so that none is lost. @param {number[][]} m @returns {Quaternion} */
function quaternion(m) {
  const [w, x, y, z] = [1 + m[0][0] + m[1][1] + m[2][2], 1 + m[0][0] - m[1][1] - m[2][2], 1 - m[0][0] + m[1][1] - m[2][2], 1 - m[0][0] - m[1][1] + m[2][2]];
  const [a, b, c] = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
  const [d, e, f] = [m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]];
  const most = Math.max(w, x, y, z);
  const all = most === w ? [w, a, b, c] : most === x ? [a, x, d, e] : most === y ? [b, d, y, f] : [c, e, f, z];
  const size = Math.hypot(...all);
  return /** @type {Quaternion} */ (all.map((part) => part / size));
}
