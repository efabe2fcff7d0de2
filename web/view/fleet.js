// Many vehicles at once: which are meant, what is to be done with them, and the campaigns that go on.

import { h } from "../core/dom.js";
import { go, to } from "../core/route.js";
import { ask } from "../core/service.js";
import { ENDED } from "../core/store.js";
import { kindName, span } from "../core/words.js";
import { sensorStates, worst } from "./tiles.js";

/** @import { JobModel, VehicleModel } from "../mavcal.d.ts" */
/** @typedef {typeof import("../core/store.js").store} Store */
/** @typedef {"preflight" | "gyro" | "mag" | "restore"} Task */
/** @typedef {{ ids: Set<string>, asking: Task | "", write: boolean }} Chosen */

/** @type {[Task, string][]} */
const TASKS = [["preflight", "Preflight"], ["gyro", "Gyro"], ["mag", "Compass"], ["restore", "Restore"]];

/** @param {Store} store @returns {Chosen} */
const chosenOf = (store) => store.keep("chosen vehicles", () => ({ ids: new Set(), asking: "", write: false }));

/** The box of one vehicle. @param {Store} store @param {VehicleModel} vehicle @param {string} name */
export function choose(store, vehicle, name) {
  const { ids } = chosenOf(store);
  return h("input", { type: "checkbox", "aria-label": `Select ${name}`, checked: ids.has(vehicle.id), onchange: () => {
    if (!ids.delete(vehicle.id)) ids.add(vehicle.id);
    store.changed();
  } });
}

/** Select, start; with one vehicle there is nothing to select. @param {Store} store @param {VehicleModel[]} vehicles */
export function hands(store, vehicles) {
  if (vehicles.length < 2) return null;
  const chosen = chosenOf(store);
  const meant = vehicles.filter((vehicle) => chosen.ids.has(vehicle.id)).map((vehicle) => vehicle.id);
  return h("section", { class: "card hands", "aria-label": "Several vehicles at once" },
    groups(store, vehicles, chosen),
    chosen.asking && meant.length ? question(store, chosen, meant) : h("div", { class: "actions" },
      h("span", { class: "count", role: "status" }, meant.length ? `${meant.length} of ${vehicles.length} selected:` : "None is selected."),
      TASKS.map(([task, text]) => h("button", { key: task, disabled: !meant.length, onclick: () => {
        if (task === "preflight") begin(store, task, meant, false);
        else Object.assign(chosen, { asking: task, write: false });
        store.changed();
      } }, text))));
}

/** All, those in a state, those with a tag. @param {Store} store @param {VehicleModel[]} vehicles @param {Chosen} chosen */
function groups(store, vehicles, chosen) {
  const states = new Map(vehicles.map((vehicle) => [vehicle.id, vehicle.silent ? "silent" : worst(sensorStates(store, vehicle))]));
  const tags = [...new Set(vehicles.flatMap((vehicle) => store.tags.get(vehicle.id) ?? []))].sort();
  const having = (/** @type {string[]} */ wanted) => vehicles.filter((vehicle) => wanted.includes(states.get(vehicle.id) ?? ""));
  /** @type {[string, VehicleModel[]][]} */
  const known = [["All", vehicles], ["Need calibration", having(["bad", "warn"])], ["Good", having(["good"])], ["Silent", having(["silent"])],
    ...tags.map((tag) => /** @type {[string, VehicleModel[]]} */ ([`Tag ${tag}`, vehicles.filter((vehicle) => store.tags.get(vehicle.id)?.includes(tag))])),
    ["None", []]];
  return h("div", { class: "segmented", role: "group", "aria-label": "Select vehicles" },
    known.filter(([text, group]) => group.length || text === "None").map(([text, group]) => h("button", { class: "small", key: text, onclick: () => {
      chosen.ids = new Set(group.map((vehicle) => vehicle.id));
      chosen.asking = "";
      store.changed();
    } }, group.length ? `${text} (${group.length})` : text)));
}

/** What is needed, and whether plans are written, before vehicles are moved or parameters planned. @param {Store} store @param {Chosen} chosen @param {string[]} meant */
function question(store, chosen, meant) {
  const task = /** @type {Task} */ (chosen.asking);
  const procedure = store.procedures.find((known) => known.kind === task);
  const what = task === "restore" ? "Put the last verified calibration back" : `Calibrate: ${kindName(task)}`;
  return h("div", { key: "question" },
    h("h2", {}, `${what}, ${meant.length} ${meant.length === 1 ? "vehicle" : "vehicles"}`),
    procedure ? h("p", {}, `Each needs ${procedure.needs}. About ${span(procedure.duration_s)} each; up to 32 go at a time.`) : null,
    h("label", { class: "choice" },
      h("input", { type: "checkbox", checked: chosen.write, onchange: () => { chosen.write = !chosen.write; store.changed(); } }),
      "Write every plan that nothing stands against"),
    h("p", { class: "quiet small" }, chosen.write ? "Each write is read back, and can be taken back." : "Nothing is written: each plan waits for your review."),
    h("div", { class: "actions" },
      h("button", { class: "primary", onclick: () => { begin(store, task, meant, chosen.write); chosen.asking = ""; } }, "Start"),
      h("button", { onclick: () => { chosen.asking = ""; store.changed(); } }, "Back")));
}

/** Begin a campaign and go to it. @param {Store} store @param {Task} task @param {string[]} vehicles @param {boolean} apply */
function begin(store, task, vehicles, apply) {
  return store.act(async () => {
    const job = await (task === "preflight" ? ask("start_preflight_campaign", { body: { vehicles } })
      : task === "restore" ? ask("start_restore_campaign", { body: { vehicles, apply } })
        : ask("start_calibration_campaign", { body: { vehicles, kind: task, apply } }));
    store.jobs.set(job.id, job);
    store.full.set(job.id, /** @type {JobModel} */ (job));
    go("campaign", job.id);
  });
}

/** What a campaign does. @param {{ options: Record<string, unknown> }} job */
export function campaignName({ options }) {
  return kindName(`${options.task === "calibrate" ? options.kind : options.task ?? "campaign"}`);
}

/** Campaigns that go on. @param {Store} store */
export function goingOn(store) {
  return store.newest().filter((job) => job.kind === "campaign" && !ENDED.has(job.state)).map((job) =>
    h("a", { class: "first-line busy", key: job.id, href: to("campaign", job.id) },
      `${campaignName(job)} of many vehicles: ${job.progress?.text ?? "begins"}. Open it.`));
}
