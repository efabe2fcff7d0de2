// One log: what is in it, what is worth fitting, plots, and what came of the fits.

import { h } from "../core/dom.js";
import { go, to } from "../core/route.js";
import { ask } from "../core/service.js";
import { number, sentence, size, words } from "../core/words.js";
import { badge, isNarrow, quiet, table, title } from "./parts.js";
import { vehicleName } from "./home.js";

/** @import { RecordingModel } from "../mavcal.d.ts" */
/** @typedef {typeof import("../core/store.js").store} Store */

/** @param {Store} store */
export function logRoom(store) {
  const { id } = store.place;
  const recording = store.answer(`recording ${id}`, () => ask("get_recording", { parameters: { recording_id: id } }), 1e9);
  if (!recording) return h("div", { class: "card" }, quiet("Reading this log …"));
  const found = /** @type {Record<string, any>} */ (recording.inspection);
  return h("div", {},
    title(recording.name, h("a", { class: "button", href: to("gap") }, "Compare with a simulator")),
    h("p", { class: "quiet small" }, [size(recording.size), found.duration ? `${number(found.duration, 4)} s` : "", found.identity?.autopilot ?? ""].filter(Boolean).join(" · ")),
    health(found.health ?? null),
    sanity(found.flight ?? null),
    plots(store, id),
    fits(store, recording, found),
    channels(found));
}

/** Is something wrong with a sensor, which one, and what to do. @param {Record<string, any> | null} found */
function health(found) {
  if (!found) return null;
  const tones = { ok: "good", suspicious: "warn", faulty: "bad" };
  const sensors = /** @type {any[]} */ (found.sensors);
  const bad = (/** @type {any} */ sensor) => sensor.findings.filter((/** @type {any} */ f) => f.verdict === "faulty" || f.verdict === "suspicious");
  const row = (/** @type {any} */ sensor) =>
    h("li", { key: sensor.name }, badge(/** @type {any} */ (tones)[sensor.verdict] ?? "unknown", words(sensor.verdict)),
      h("div", {}, h("strong", {}, sentence(sensor.name)),
        (bad(sensor).length ? bad(sensor) : sensor.findings.slice(0, 1)).map((/** @type {any} */ f, /** @type {number} */ i) => h("p", { key: `${i}` }, sentence(f.text)))));
  return h("section", { class: "card" }, h("h2", {}, "Is something wrong with a sensor?"),
    h("p", {}, h("strong", {}, found.summary), found.action ? ` ${found.action}` : ""),
    h("ul", { class: "plain checks" }, sensors.filter((sensor) => sensor.verdict !== "ok").map(row)),
    folded(sensors.filter((sensor) => sensor.verdict === "ok").map(row), "sensor is sound", "sensors are sound"),
    found.lacks.length ? h("details", {}, h("summary", {}, "What the log lacks to say more"),
      h("ul", { class: "small" }, found.lacks.map((/** @type {string} */ line) => h("li", { key: line }, sentence(line))))) : null);
}

/** What needs no look. @param {any[]} rows @param {string} one @param {string} many */
const folded = (rows, one, many) => rows.length
  ? h("details", {}, h("summary", {}, `${rows.length} ${rows.length === 1 ? one : many}`), h("ul", { class: "plain checks" }, rows)) : null;

/** The sanity of the inertial sensors. @param {Record<string, any> | null} flight */
function sanity(flight) {
  if (!flight) return null;
  const tones = { pass: "good", warn: "warn", fail: "bad" };
  const items = /** @type {any[]} */ (flight.items);
  const row = (/** @type {any} */ item, /** @type {number} */ i) =>
    h("li", { key: `${i}` }, badge(/** @type {any} */ (tones)[item.verdict] ?? "unknown", words(item.verdict)),
      h("div", {}, h("strong", {}, `${sentence(words(item.name))}, ${item.subject}`), h("p", {}, sentence(item.text))));
  const found = items.filter((item) => item.verdict === "warn" || item.verdict === "fail");
  return h("section", { class: "card" }, h("h2", {}, "At rest and in flight"),
    items.length ? null : quiet("The log shows neither rest nor flight."),
    items.length && !found.length ? quiet("Nothing stands out.") : h("ul", { class: "plain checks" }, found.map(row)),
    folded(items.filter((item) => item.verdict === "pass").map(row), "check passes", "checks pass"),
    folded(items.filter((item) => item.verdict === "not_testable").map(row), "check is not possible", "checks are not possible"));
}

/** The sensors over the log. @param {Store} store @param {string} id */
function plots(store, id) {
  const series = store.answer(`series ${id}`, () => ask("list_series", { parameters: { recording_id: id } }), 1e9);
  if (!series) return quiet("Drawing its sensors …");
  return h("details", { class: "card", open: !isNarrow() }, h("summary", {}, "Its sensors over time"),
    h("div", { class: "charts" }, series.map((one) => h("figure", { key: `${one.sensor}${one.instance}` },
      h("figcaption", {}, `${sentence(words(one.sensor))} ${one.instance + 1}`, h("span", { class: "quiet small" }, ` ${one.source}`)),
      h("line-chart", { role: "img", "aria-label": `${words(one.sensor)} ${one.instance + 1} over time`, chart: {
        x: one.t, unit: one.unit, xUnit: "s",
        lines: one.values.map((y, i) => ({ name: one.values.length > 1 ? "xyz"[i] : "", color: one.values.length > 1 ? "xyz"[i] : "accent", y })) } })))));
}

/** @param {Store} store @param {RecordingModel} recording @param {Record<string, any>} found */
function fits(store, recording, found) {
  const steps = /** @type {{ method: string, worthwhile: boolean, reason: string }[]} */ (found.next ?? []);
  const worth = steps.filter((step) => step.worthwhile);
  const others = store.answer("methods", () => ask("list_methods"), 1e9) ?? [];
  const vehicles = [...store.vehicles.values()];
  /** @type {(method: string) => Promise<any>} */
  const fit = (method) => store.act(async () => {
    const job = await ask("start_fit", { body: { recording: recording.id, method } });
    await store.load(job.id);
    go("job", job.id);
  });
  /** @type {(method: string, vehicle: string) => Promise<any>} */
  const plan = (method, vehicle) => store.act(async () => {
    const job = await ask("plan_recording", { parameters: { recording_id: recording.id }, body: { method, vehicle_id: vehicle } });
    await store.load(job.id);
    go("job", job.id);
  });
  const buttons = (/** @type {string} */ method) => h("div", { class: "actions" },
    h("button", { class: "primary", "aria-label": `Fit ${method}`, onclick: () => fit(method) }, "Fit"),
    vehicles.map((vehicle) => h("button", { key: vehicle.id, onclick: () => plan(method, vehicle.id) }, `Plan for ${vehicleName(vehicle)}`)));
  const chosen = store.keep("method", () => ({ name: "" }));
  return h("section", { class: "card" }, h("h2", {}, "What is worth fitting"),
    worth.length ? h("ul", { class: "plain methods" }, worth.map(({ method, reason }) =>
      h("li", { key: method }, h("div", {}, h("strong", {}, method), h("p", { class: "quiet small" }, sentence(reason))), buttons(method)))) : null,
    steps.length > worth.length ? h("details", {}, h("summary", {}, "What is not, and why"), h("ul", { class: "small" },
      steps.filter((step) => !step.worthwhile).map(({ method, reason }) => h("li", { key: method }, `${method}: ${reason}`)))) : null,
    h("div", { class: "row-form" }, h("label", { for: "method" }, "Any other method"),
      h("select", { id: "method", onchange: (/** @type {Event} */ event) => { chosen.name = /** @type {HTMLSelectElement} */ (event.target).value; store.changed(); } },
        h("option", { value: "" }, "Choose one"), others.map(({ name, summary }) => h("option", { value: name, selected: chosen.name === name }, `${name}: ${summary}`))),
      chosen.name ? buttons(chosen.name) : null));
}

/** @param {Record<string, any>} found */
function channels(found) {
  const rows = /** @type {any[]} */ (found.channels ?? []).map((c) => [`${words(c.sensor)} ${c.instance + 1}`, c.source, number(c.rate, 4), c.samples, c.n_gaps]);
  return rows.length ? h("details", { class: "card" }, h("summary", {}, `${rows.length} channels`), table(["sensor", "source", ">Hz", ">samples", ">gaps"], rows, "Channels", [0, 2])) : null;
}
