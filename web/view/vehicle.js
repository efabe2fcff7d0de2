// One vehicle: its tiles, what it reads now, and what it says.

import { h } from "../core/dom.js";
import { to } from "../core/route.js";
import { ask } from "../core/service.js";
import { AUTOPILOTS, LANDED, kindName, ago, STATES, tone } from "../core/words.js";
import { badge, quiet, tabs, table, title, VERDICT_TONES } from "./parts.js";
import { condition, firstLine, linkQuality, vehicleName } from "./home.js";
import { live } from "./live.js";
import { more, sensorStates, tiles } from "./tiles.js";

/** @import { CheckModel, PreflightModel, VehicleModel } from "../mavcal.d.ts" */
/** @typedef {typeof import("../core/store.js").store} Store */

/** @param {Store} store */
export function vehicleRoom(store) {
  const { id, tab } = store.place;
  const vehicle = store.vehicles.get(id);
  if (!vehicle) return h("div", { class: "card" }, quiet(store.ready ? "This vehicle is not connected now." : "Looking for this vehicle …"));
  return h("div", {},
    title(vehicleName(vehicle), h("p", { class: "badges" }, badge(...condition(vehicle)), badge(...linkQuality(vehicle)))),
    h("p", { class: "quiet small" }, `${AUTOPILOTS[vehicle.autopilot]} ${vehicle.firmware} · system ${vehicle.system} · ${LANDED[vehicle.landed]}`),
    firstLine(store, vehicle),
    tabs([[to("vehicle", id), "Calibration", tab === ""], [to("vehicle", id, "live"), "Live", tab === "live"],
      [to("vehicle", id, "preflight"), "Preflight", tab === "preflight"],
      [to("history", vehicle.id), "History", false], [to("vehicle", id, "about"), "About", tab === "about"]]),
    tab === "live" ? live(store, vehicle) : tab === "preflight" ? preflight(store, vehicle)
      : tab === "about" ? about(store, vehicle) : calibration(store, vehicle));
}

/** @param {Store} store @param {VehicleModel} vehicle */
function calibration(store, vehicle) {
  const jobs = store.newest().filter((job) => job.vehicle_id === vehicle.id).slice(0, 8);
  return h("section", { key: "calibration" },
    vehicle.obstacles.length ? h("p", { class: "warn small" }, `Nothing can be written now: ${vehicle.obstacles.join("; ")}.`) : null,
    tiles(store, vehicle), more(store, vehicle),
    jobs.length ? h("section", {}, h("h2", {}, "Last calibrations"), h("ul", { class: "plain jobs" }, jobs.map((job) =>
      h("li", { key: job.id }, h("a", { href: to("job", job.id) }, kindName(job.kind)), badge(tone(job.state), STATES[job.state]),
        h("span", { class: "quiet small" }, ago(job.created_at)))))) : null);
}

/** @param {Store} store @param {VehicleModel} vehicle */
function preflight(store, vehicle) {
  const held = store.keep(`preflight ${vehicle.id}`, () => ({ began: 0, heading: "", report: /** @type {PreflightModel | undefined} */ (undefined) }));
  /** @type {(fix: ("gyro" | "level")[]) => Promise<any>} */
  const look = (fix) => store.act(async () => {
    held.began = Date.now();
    const clock = setInterval(() => store.changed(), 1000); // its seconds are counted
    store.changed();
    try {
      held.report = await ask("run_preflight", { parameters: { vehicle_id: vehicle.id }, body: { fix, heading: held.heading === "" ? null : Number(held.heading) } });
      store.forget(`sensors ${vehicle.id}`);
    } finally {
      clearInterval(clock);
      held.began = 0;
    }
  });
  const { began, report } = held;
  const job = store.running(vehicle.id);
  const waits = began > 0 || vehicle.silent || job !== undefined;
  return h("section", { key: "preflight" },
    h("p", {}, "Put the vehicle down, leave it still, and look. It takes 10 to 30 s. Nothing is written by a look."),
    job ? h("p", { class: "first-line busy" }, `${kindName(job.kind)} goes on: look when it has ended.`) : null,
    h("div", { class: "actions" },
      h("button", { class: "primary", disabled: waits, onclick: () => look([]) }, began ? `Looking … ${Math.round((Date.now() - began) / 1000)} s` : "Look now"),
      h("button", { disabled: waits, onclick: () => look(["gyro"]) }, "Calibrate the gyro, then look")),
    h("details", {}, h("summary", { class: "small" }, "The true heading is known"),
      h("div", { class: "row-form" }, h("label", { for: "heading" }, "Heading of the nose from true north, deg"),
        h("input", { id: "heading", type: "number", min: "0", max: "360", value: held.heading,
          oninput: (/** @type {Event} */ event) => { held.heading = /** @type {HTMLInputElement} */ (event.target).value; } })),
      h("p", { class: "quiet small" }, "With it a look tells which of two compasses is off.")),
    report ? h("section", {},
      h("p", { class: `first-line ${VERDICT_TONES[report.verdict]}` }, `${report.summary} Looked at for ${Math.round(report.seconds)} s.`),
      h("ul", { class: "plain checks" }, report.checks.map((check) => row(check)))) : null);
}

/** @param {CheckModel} check */
function row(check) {
  return h("li", { key: check.id, class: VERDICT_TONES[check.verdict] },
    badge(VERDICT_TONES[check.verdict], check.verdict),
    h("div", {}, h("strong", {}, check.id.replaceAll("_", " ")), h("p", {}, check.reason), check.remedy ? h("p", { class: "quiet" }, check.remedy) : null,
      check.evidence.length ? h("details", {}, h("summary", { class: "small" }, "What it rests on"),
        h("ul", { class: "small" }, check.evidence.map((text) => h("li", {}, text)))) : null));
}

/** @param {Store} store @param {VehicleModel} vehicle */
function about(store, vehicle) {
  return h("section", { key: "about", class: "about" },
    nameForm(store, vehicle),
    h("h2", {}, "What it says"),
    vehicle.texts.length ? h("ul", { class: "plain small" }, vehicle.texts.map((text, i) => h("li", { key: `${i}` }, text))) : quiet("It has said nothing yet."),
    h("h2", {}, "What the state rests on"), h("ul", { class: "small" }, vehicle.evidence.map((text, i) => h("li", { key: `${i}` }, text))),
    h("h2", {}, "Numbers"),
    table(["what", ">value"], [["unit id", vehicle.uid ?? "not known"], ["messages received", vehicle.received], ["messages lost", vehicle.lost],
      ["bytes/s", Math.round(vehicle.bytes_per_s)], ["parameters heard", vehicle.parameters_known]], "Numbers of the link"),
    sensorStates(store, vehicle) ? null : quiet("Its calibration is not known yet."));
}

/** The name that a person gives, kept by unit id. @param {Store} store @param {VehicleModel} vehicle */
function nameForm(store, vehicle) {
  if (!vehicle.uid) return quiet("It has not told its unit id, so a name cannot be kept.");
  return h("form", { class: "row-form", onsubmit: (/** @type {Event} */ event) => {
    event.preventDefault();
    const field = /** @type {HTMLInputElement} */ (/** @type {HTMLFormElement} */ (event.target).elements.namedItem("name"));
    store.act(async () => {
      await ask("change_unit", { parameters: { unit_id: vehicle.id }, body: { name: field.value.trim() } });
      await store.refresh();
    });
  } },
  h("label", { for: "name" }, "Name"), h("input", { id: "name", name: "name", value: store.names.get(vehicle.id) ?? "", maxlength: "60", autocomplete: "off" }),
  h("button", { type: "submit" }, "Keep this name"));
}
