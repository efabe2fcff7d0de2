// A campaign: its vehicles in one table, whoever needs a hand next on top.

import { h } from "../core/dom.js";
import { to } from "../core/route.js";
import { ask } from "../core/service.js";
import { BUSY, ENDED } from "../core/store.js";
import { sentence, span, STATES, tone, words } from "../core/words.js";
import { campaignName } from "./fleet.js";
import { vehicleName } from "./home.js";
import { badge, bar, quiet, title } from "./parts.js";

/** @import { ItemModel, JobSummary } from "../mavcal.d.ts" */
/** @import { Tone } from "./parts.js" */
/** @typedef {typeof import("../core/store.js").store} Store */

const AGE_MS = 1500;
const MOST = 1000; // items in one answer

/** Which of its vehicles a person should turn to first, by what they are. */
const ORDER = ["hand", "in_doubt", "review", "failed", "refused", "warned", "running", "waiting", "skipped", "cancelled", "done"];
/** @type {Record<string, [Tone, string]>} */
const SHOWN = {
  in_doubt: ["bad", "in doubt"], review: ["warn", "ready for your review"], failed: ["bad", "failed"], refused: ["bad", "did not pass"],
  warned: ["warn", "warns"], running: ["busy", "runs"], waiting: ["unknown", "waits for its turn"], skipped: ["warn", "skipped"],
  cancelled: ["warn", "cancelled"], done: ["good", "done"],
};

/** @param {Store} store */
export function campaignRoom(store) {
  const { id } = store.place;
  const job = store.full.get(id);
  if (!job) {
    const failed = store.answer(`job ${id}`, () => store.load(id).then(() => ""), 5000);
    return h("div", { class: "card" }, quiet(failed === undefined ? "Reading this campaign …" : "There is no such campaign."));
  }
  const over = ENDED.has(job.state);
  const items = store.answer(`items ${id} ${over}`, () => ask("list_items", { parameters: { job_id: id }, query: { limit: MOST } }), over ? 15000 : AGE_MS)
    ?? /** @type {ItemModel[] | undefined} */ (store.kept.get(`answer items ${id} false`)?.value); // while the last answer is on its way
  const rows = (items ?? []).map((item) => ({ item, needs: need(store, item) })).sort((a, b) =>
    ORDER.indexOf(a.needs) - ORDER.indexOf(b.needs) || a.item.number - b.item.number);
  return h("div", {},
    title(`${campaignName(job)} of ${items ? vehicles(items.length) : "many vehicles"}`, h("p", { class: "badges" }, badge(tone(job.state), STATES[job.state]))),
    head(store, job, rows.map((row) => row.needs)),
    items ? table(store, rows) : quiet("Reading its vehicles …"));
}

/** @param {number} count */
const vehicles = (count) => `${count} ${count === 1 ? "vehicle" : "vehicles"}`;

/** What an item needs: a hand now, or what became of it. @param {Store} store @param {ItemModel} item */
function need(store, item) {
  const state = store.jobs.get(item.job_id ?? "")?.state ?? item.job_state;
  if (item.outcome === "review") return state === "review" ? "review" : state === "succeeded" ? "done" : state && BUSY.has(state) ? "running" : "cancelled";
  if (item.outcome !== "running") return item.outcome;
  return state === "waiting_for_operator" || promptOf(store, item) ? "hand" : state === "in_doubt" ? "in_doubt" : "running";
}

/** @param {Store} store @param {ItemModel} item */
const promptOf = (store, item) => store.jobs.get(item.job_id ?? "")?.prompt?.text ?? "";

/** How far it is, what it waits for, and the way to stop it. @param {Store} store @param {JobSummary} job @param {string[]} needs */
function head(store, job, needs) {
  const over = ENDED.has(job.state);
  const { progress } = job;
  const waits = needs.filter((one) => one === "hand").length;
  const text = over ? job.outcome?.kind === "result" ? job.outcome.text : job.outcome?.cause ?? STATES[job.state]
    : `${progress?.text ?? "It begins"}${progress?.eta ? `, about ${span(progress.eta)} left` : ""}.`;
  return h("div", { class: "card" },
    h("p", { role: "status" }, sentence(text.replace(/(\d+) refused/, "$1 did not pass"))),
    over ? null : bar(progress?.current ?? 0, progress?.target ?? needs.length, text),
    waits ? h("p", { class: "first-line warn" }, `${vehicles(waits)} ${waits === 1 ? "needs" : "need"} your hand now. They stand first.`) : null,
    h("div", { class: "actions" }, h("a", { class: "button", href: to("home") }, "All vehicles"), over ? null : stop(store, job)));
}

/** Stopping asks once. @param {Store} store @param {JobSummary} job */
function stop(store, job) {
  const asking = store.keep(`stop ${job.id}`, () => ({ sure: false }));
  const set = (/** @type {boolean} */ sure) => () => { asking.sure = sure; store.changed(); };
  if (!asking.sure) return h("button", { key: "stop", onclick: set(true) }, "Stop");
  return [h("span", { key: "ask" }, "Stop all that has not ended? A write that has begun goes on to its end."),
    h("button", { class: "danger", key: "sure", onclick: () => store.act(async () => {
      asking.sure = false;
      await ask("cancel_job", { parameters: { job_id: job.id } });
      await store.load(job.id);
    }) }, "Stop them"),
    h("button", { key: "on", onclick: set(false) }, "Go on")];
}

/** @param {Store} store @param {{ item: ItemModel, needs: string }[]} rows */
function table(store, rows) {
  return h("div", { class: "scroll fleet campaign", tabindex: "0", role: "region", "aria-label": "Vehicles of this campaign" },
    h("table", {},
      h("thead", {}, h("tr", {}, ["Vehicle", "State", "What", ""].map((text) => text ? h("th", { scope: "col" }, text) : h("td", {})))),
      h("tbody", {}, rows.map(({ item, needs }) => row(store, item, needs)))));
}

/** @param {Store} store @param {ItemModel} item @param {string} needs */
function row(store, item, needs) {
  const vehicle = store.vehicles.get(item.subject);
  const job = store.jobs.get(item.job_id ?? "");
  const [sign, label] = SHOWN[needs] ?? ["warn", item.job_state ? STATES[item.job_state].toLowerCase() : "needs you"];
  const open = item.job_id ? to("job", item.job_id) : to("vehicle", item.subject);
  const found = item.preflight?.checks.filter((check) => check.verdict !== "pass") ?? [];
  const said = promptOf(store, item) || (needs === "running" ? job?.progress?.text ?? "" : item.text);
  return h("tr", { key: `${item.number}`, class: needs },
    h("th", { scope: "row" }, h("a", { href: open }, vehicle ? vehicleName(vehicle) : item.name || item.subject.slice(0, 16))),
    h("td", { class: "state" }, badge(sign, label)),
    h("td", { class: "needs" }, h("p", {}, sentence(said)),
      found.length ? h("details", { class: "small" }, h("summary", {}, `${found.length} ${found.length === 1 ? "check does" : "checks do"} not pass`),
        h("ul", {}, found.map((check) => h("li", { key: check.id }, `${sentence(words(check.id))}: ${check.reason}`)))) : null),
    h("td", { class: "do" }, h("a", { class: "button small", href: open, "aria-label": `Open ${vehicle ? vehicleName(vehicle) : item.subject}` }, "Open")));
}
