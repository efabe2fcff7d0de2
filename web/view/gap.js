// The gap between a real and a simulated vehicle: drop two logs, watch, read where, which and how far.

import { h } from "../core/dom.js";
import { go, to } from "../core/route.js";
import { address, ask, hasKey, save } from "../core/service.js";
import { ago, sentence, STATES, tone } from "../core/words.js";
import { badge, bar, quiet, title } from "./parts.js";
import { dropZone } from "./logs.js";

/** @import { RecordingModel } from "../mavcal.d.ts" */
/** @typedef {typeof import("../core/store.js").store} Store */

/** @param {Store} store */
export function gapRoom(store) {
  return store.place.id ? diagnosis(store, store.place.id) : h("div", {}, title("Gap between a real and a simulated vehicle"), asking(store), earlier(store));
}

/** @param {Store} store */
function asking(store) {
  const chosen = store.keep("gap", () => ({ real: /** @type {RecordingModel | undefined} */ (undefined), sim: /** @type {RecordingModel | undefined} */ (undefined) }));
  /** @type {(which: "real" | "sim", text: string) => any} */
  const place = (which, text) => {
    const have = chosen[which];
    return have ? h("div", { class: "drop done", key: which }, h("strong", {}, `✓ ${have.name}`),
      h("button", { class: "plain", onclick: () => { chosen[which] = undefined; store.changed(); } }, "Another one"))
      : dropZone(store, (recording) => { chosen[which] = recording; store.changed(); }, which, text);
  };
  const { real, sim } = chosen;
  return h("section", {}, h("p", {}, "Two logs of the same flight, or of two such flights: one of the real vehicle, one of the simulator."),
    h("div", { class: "two" }, place("real", "Real log: drop it here, or choose it"), place("sim", "Simulated log (optional)")),
    h("button", { class: "primary", disabled: !real, onclick: () => store.act(async () => {
      const job = await ask("diagnose_gap", { body: { real: real?.id ?? "", sim: sim?.id ?? null } });
      go("gap", job.id);
    }) }, "Diagnose"));
}

/** @param {Store} store */
function earlier(store) {
  const gaps = store.answer("gaps", () => ask("list_gaps"), 10000) ?? [];
  return gaps.length ? h("section", {}, h("h2", {}, "Earlier diagnoses"), h("ul", { class: "plain jobs" }, [...gaps].reverse().map((gap) =>
    h("li", { key: gap.id }, h("a", { href: to("gap", gap.id) }, ago(gap.created_at)), badge(tone(gap.state), STATES[gap.state]))))) : null;
}

/** @param {Store} store @param {string} id */
function diagnosis(store, id) {
  const gap = store.answer(`gap ${id}`, () => ask("get_gap", { parameters: { gap_id: id } }), 2000);
  if (!gap) return quiet("Reading this diagnosis …");
  const job = store.jobs.get(id);
  if (gap.state === "queued" || gap.state === "fitting") {
    const progress = job?.progress;
    return h("section", { class: "card" }, h("h1", {}, gap.state === "queued" ? "Waits for its turn" : "Diagnosing"),
      h("p", { role: "status" }, progress?.text ?? "Reads both logs, then asks which effects the difference shows."),
      progress ? bar(progress.current, progress.target, progress.text) : h("div", { class: "working" }, h("span", { class: "spinner", "aria-hidden": "true" })),
      h("button", { class: "danger", onclick: () => store.act(async () => { await ask("cancel_job", { parameters: { job_id: id } }); store.forget(`gap ${id}`); }) }, "Cancel"));
  }
  if (gap.state !== "succeeded") return h("section", { class: "outcome bad" }, h("h2", {}, "No diagnosis"), h("p", {}, sentence(gap.error ?? "")), h("a", { class: "button", href: to("gap") }, "Back"));
  return report(store, id);
}

/** Where, which, how far: the sentence of the diagnosis, and its report. @param {Store} store @param {string} id */
function report(store, id) {
  const job = store.full.get(id) ?? void store.answer(`gap job ${id}`, () => store.load(id), 1e9);
  const told = job?.outcome?.kind === "result" ? job.outcome.text : "";
  const name = (/** @type {string} */ end) => `gap-${id}.${end}`;
  return h("div", {},
    title("Diagnosis", badge(tone("succeeded"), STATES.succeeded)),
    h("p", { class: "first-line" }, told ? sentence(told) : "Reading the report …"),
    hasKey() ? quiet("Save the report to read it: a frame cannot carry your key.")
      : h("iframe", { class: "report", title: "The whole report", sandbox: "", src: address("get_gap_report", { parameters: { gap_id: id } }) }),
    h("div", { class: "actions" },
      h("button", { class: "primary", onclick: () => store.act(() => save("get_gap_report", { parameters: { gap_id: id } }, name("html"))) }, "Save the report"),
      h("button", { onclick: () => store.act(() => save("get_gap", { parameters: { gap_id: id } }, name("json"))) }, "Save as JSON"),
      h("a", { class: "button", href: to("gap") }, "Another diagnosis")));
}
