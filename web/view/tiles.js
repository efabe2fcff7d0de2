// The four tiles of a vehicle: gyro, accelerometer, compass, temperature; each in color and in words.

import { h } from "../core/dom.js";
import { go } from "../core/route.js";
import { ask } from "../core/service.js";
import { kindName, sentence, span } from "../core/words.js";
import { badge, VERDICT_TONES } from "./parts.js";

/** @import { ProcedureModel, SensorStateModel, VehicleModel, VehicleSensorsModel } from "../mavcal.d.ts" */
/** @typedef {typeof import("../core/store.js").store} Store */

const MAX_AGE_MS = 15000;
const ICONS = {
  gyro: "M12 4a8 8 0 1 1-8 8M12 4l-3-2.5M12 4l-3 2.5M12 9a3 3 0 1 0 .01 0",
  accel: "M12 3v18M3 12h18M12 3l-2.5 3M12 3l2.5 3M21 12l-3-2.5M21 12l-3 2.5",
  mag: "M12 2.5a9.5 9.5 0 1 0 .01 0M12 5l3 7-3 7-3-7z",
  thermal: "M10 4a2 2 0 0 1 4 0v9a4.5 4.5 0 1 1-4 0zM12 9v8",
};

/** What is known of the calibration of a vehicle's sensors. @param {Store} store @param {VehicleModel} vehicle */
export function sensorStates(store, vehicle) {
  return store.answer(`sensors ${vehicle.id}`,
    () => ask("list_sensors", { parameters: { vehicle_id: vehicle.id } }), MAX_AGE_MS);
}

/** The gravest verdict, as a tone. @param {VehicleSensorsModel | undefined} states */
export function worst(states) {
  const found = (states?.sensors ?? []).map((state) => state.verdict);
  if (found.includes("fail")) return "bad";
  if (found.includes("warn")) return "warn";
  return found.length && found.every((verdict) => verdict === "pass") ? "good" : "quiet";
}

/** @param {Store} store @param {VehicleModel} vehicle */
export function tiles(store, vehicle) {
  const states = sensorStates(store, vehicle);
  if (!states) return h("div", { class: "tiles loading", "aria-busy": "true" });
  return h("div", { class: "tiles" }, states.sensors.map((state) => tile(store, vehicle, state)));
}

/** @param {Store} store @param {VehicleModel} vehicle @param {SensorStateModel} state */
function tile(store, vehicle, state) {
  const procedure = store.procedures.find((known) => known.kind === state.kind);
  const busy = store.running(vehicle.id) !== undefined;
  const name = kindName(state.kind);
  const invitation = `Calibrate, about ${span(procedure?.duration_s)}`;
  return h("section", { class: `tile ${VERDICT_TONES[state.verdict]}`, key: state.kind, "aria-label": name },
    h("div", { class: "title" },
      h("svg", { viewBox: "0 0 24 24", width: "24", height: "24", "aria-hidden": "true" },
        h("path", { d: ICONS[/** @type {keyof typeof ICONS} */ (state.kind)] ?? "", fill: "none", stroke: "currentColor", "stroke-width": "1.6" })),
      h("h3", {}, name),
      badge(VERDICT_TONES[state.verdict], state.label)),
    h("p", { class: "what" }, state.text),
    state.advice ? h("p", { class: "quiet small" }, state.advice) : null,
    h("button", {
      class: state.verdict === "fail" || state.verdict === "warn" ? "primary" : "",
      disabled: busy || vehicle.silent,
      "aria-label": `${invitation}: ${name}`, // begins with what is read on it, for whoever speaks to the page
      onclick: () => start(store, vehicle.id, state.kind),
    }, invitation),
    procedure ? h("p", { class: "quiet small" }, `Needs ${procedure.needs}.`) : null);
}

/**
 * Start a calibration and go to it.
 * @param {Store} store @param {string} vehicle @param {string} kind @param {Record<string, number>} [options]
 */
export function start(store, vehicle, kind, options = {}) {
  return store.act(async () => {
    const job = await ask("start_job", { parameters: { vehicle_id: vehicle }, body: { kind, options } });
    store.jobs.set(job.id, job);
    store.full.set(job.id, job);
    go("job", job.id);
  });
}

/** The other methods, by the names that a pilot uses. @param {Store} store @param {VehicleModel} vehicle */
export function more(store, vehicle) {
  const shown = new Set(sensorStates(store, vehicle)?.sensors.map((state) => state.kind));
  const busy = store.running(vehicle.id) !== undefined;
  return h("details", { class: "card" },
    h("summary", {}, "More: level horizon and other methods"),
    h("ul", { class: "plain methods" }, store.procedures.filter((known) => !shown.has(known.kind)).map((known) =>
      h("li", { key: known.kind },
        h("div", {}, h("strong", {}, kindName(known.kind)), h("p", { class: "quiet small" }, `${sentence(known.needs)}. About ${span(known.duration_s)}.`)),
        starter(store, vehicle, known, busy || vehicle.silent)))));
}

/**
 * What starts a method: a button, with a field for each option that has to be given.
 * @param {Store} store @param {VehicleModel} vehicle @param {ProcedureModel} method @param {boolean} waits
 */
function starter(store, vehicle, method, waits) {
  const asked = method.options.filter((option) => option.default === null);
  if (!asked.length) return h("button", { disabled: waits, onclick: () => start(store, vehicle.id, method.kind) }, "Start");
  const id = (/** @type {string} */ name) => `${method.kind} ${name}`.replaceAll(/[^a-z]/g, "-");
  return h("form", { class: "row-form", onsubmit: (/** @type {Event} */ event) => {
    event.preventDefault();
    const fields = /** @type {HTMLFormElement} */ (event.target).elements;
    const given = asked.map((option) => [option.name, Number(/** @type {HTMLInputElement} */ (fields.namedItem(option.name)).value)]);
    start(store, vehicle.id, method.kind, Object.fromEntries(given));
  } },
  asked.map((option) => h("div", { key: option.name },
    h("label", { for: id(option.name) }, `${sentence(option.help)}, ${option.unit}`),
    h("input", { id: id(option.name), name: option.name, type: "number", step: "any", required: true,
      min: `${option.low ?? ""}`, max: `${option.high ?? ""}` }))),
  h("button", { type: "submit", disabled: waits }, "Start"));
}
