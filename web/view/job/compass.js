// What guides a compass: one picture of the covered directions with the vehicle in their middle, and how well each is known.

import { h } from "../../core/dom.js";
import { number, rough } from "../../core/words.js";
import { unit } from "../../scene/rotation.js";
import { current } from "../samples.js";
import { handSwitch, picture } from "../stage.js";

/** @import { JobModel } from "../../mavcal.d.ts" */
/** @import { Vector } from "../../scene/rotation.js" */
/** @typedef {typeof import("../../core/store.js").store} Store */
/** @typedef {{ instance: string, masks: Record<string, number[]> }} Chosen */

/** @param {Store} store @param {JobModel} job @returns {Chosen} */
const chosenOf = (store, job) => store.keep(`compass ${job.id}`, () => ({ instance: "0", masks: {} }));

/** @param {Store} store @param {JobModel} job */
export function compass(store, job) {
  const samples = current();
  const detail = /** @type {Record<string, any>} */ (job.progress?.detail ?? {});
  const chosen = chosenOf(store, job);
  chosen.masks = detail.coverage_mask ?? chosen.masks; // while it reads or computes, the sphere stays as it was
  const masks = Object.entries(chosen.masks);
  const mask = masks.find(([instance]) => instance === chosen.instance)?.[1] ?? masks[0]?.[1] ?? [];
  const now = /** @type {Vector | undefined} */ (samples?.now.get(`mag ${chosen.instance}`));
  const attitude = samples?.attitude ?? null;
  const vehicle = store.vehicles.get(job.vehicle_id ?? "");
  return h("div", { class: "guide compass" },
    h("div", { class: "stage" },
      h("field-sphere", { role: "img", "aria-label": `Directions covered: ${Math.round(100 * (detail.coverage ?? 0))} %`,
        field: { mask, points: [], next: job.prompt?.direction ?? null, now: now ? unit(now) : null, attitude } }),
      h("div", { class: "middle" }, picture(store, vehicle, { attitude, ghost: null, words: "The vehicle as it is held now" })),
      handSwitch(store, vehicle)),
    h("div", { class: "compass-list" }, masks.map(([instance]) => card(store, job, detail, instance, chosen))));
}

/** @param {Store} store @param {JobModel} job @param {Record<string, any>} detail @param {string} instance @param {Chosen} chosen */
function card(store, job, detail, instance, chosen) {
  const sd = detail.heading_sd_deg?.[instance];
  const field = detail.field_ut?.[instance];
  const model = detail.model_ut;
  const target = Number(job.options.uncertainty ?? 0.3);
  const off = field && model ? Math.abs(field / model - 1) : 0;
  return h("button", { class: "compass-card", key: instance, "aria-pressed": `${chosen.instance === instance}`,
    onclick: () => { chosen.instance = instance; store.changed(); } },
  h("strong", {}, `Compass ${Number(instance) + 1}`),
  h("span", { class: sd && sd <= target ? "good" : "" }, sd ? `± ${rough(sd)}°, wanted ${number(target)}°` : "heading not known yet"),
  h("span", { class: off > 0.15 ? "bad" : "quiet" }, field ? `${number(field, 3)} µT${model ? `, Earth ${number(model, 3)} µT` : ""}` : ""));
}

/** The readings themselves, and what the colors of the sphere mean. @param {Store} store @param {JobModel} job */
export function compassCloud(store, job) {
  const samples = current();
  const detail = /** @type {Record<string, any>} */ (job.progress?.detail ?? {});
  return [
    h("p", { class: "quiet small", key: "colors" }, "Green: covered. Blue: the field now. Orange: this side should point down, then turn a full circle."),
    h("point-cloud", { key: "cloud", role: "img", "aria-label": "Readings of the compass: as measured, and with the calibration in force",
      cloud: { raw: samples?.cloud.get(Number(chosenOf(store, job).instance)) ?? [], radius: detail.model_ut ?? samples?.field ?? 50, attitude: samples?.attitude ?? null } })];
}
