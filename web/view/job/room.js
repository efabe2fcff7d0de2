// The room of one job: while it runs, the prompt and its button are all that matters.

import { h } from "../../core/dom.js";
import { to } from "../../core/route.js";
import { ENDED } from "../../core/store.js";
import { kindName, moment, sentence } from "../../core/words.js";
import { chosen, choose } from "../../core/cues.js";
import { badge, quiet } from "../parts.js";
import { notice } from "../shell.js";
import { vehicleName } from "../home.js";
import { dock } from "./dock.js";
import { besides, guide } from "./guide.js";
import { leftOut, outcome, standing, stateOf } from "./outcome.js";
import { promptPart } from "./prompt.js";
import { review, written } from "./review.js";

/** @import { JobModel } from "../../mavcal.d.ts" */
/** @typedef {typeof import("../../core/store.js").store} Store */

/** @param {Store} store */
export function jobRoom(store) {
  const { id } = store.place;
  const job = store.full.get(id);
  if (!job) {
    const failed = store.answer(`job ${id}`, () => store.load(id).then(() => ""), 5000);
    return h("div", { class: "card" }, quiet(failed === undefined ? "Reading this job …" : "There is no such job."));
  }
  const over = ENDED.has(job.state) || job.state === "review";
  return h("div", { class: `job-room ${over ? "over" : "running"} ${job.kind}` },
    head(store, job),
    over ? null : h("div", { class: "now", key: "now" }, promptPart(store, job), store.connection.good ? silent(store, job) : lost(store, job), notice(store)),
    h("div", { class: "body", key: "body" },
      over ? h("div", { key: "over" }, notice(store), leftOut(job), outcome(job)) : guide(store, job),
      over ? null : more(store, job),
      standing(job),
      job.state === "review" ? review(store, job) : written(store, job),
      over ? warnings(job) : null),
    dock(store, job));
}

/** @param {Store} store @param {JobModel} job */
function head(store, job) {
  const vehicle = store.vehicles.get(job.vehicle_id ?? "");
  const back = job.vehicle_id ? to("vehicle", job.vehicle_id) : to("logs");
  return h("div", { class: "job-head" },
    h("a", { class: "back", href: back, "aria-label": "Back" }, "‹"),
    h("div", {}, h("h1", {}, kindName(job.kind)),
      h("p", { class: "quiet small" }, [vehicle ? vehicleName(vehicle) : "uploaded log", moment(job.created_at)].join(" · "))),
    h("div", { class: "badges" }, badge(...stateOf(job))),
    ENDED.has(job.state) ? null : cues(store));
}

/** What is not needed while the hands are full. @param {Store} store @param {JobModel} job */
function more(store, job) {
  const found = [...besides(store, job), warnings(job)].filter((view) => view !== null);
  return h("details", { class: "more", key: "more", open: window.innerWidth >= 900 },
    h("summary", {}, found.length ? "Sounds, numbers, warnings" : "Sounds"), cues(store), found);
}

/** Signs for somebody who does not look. @param {Store} store */
function cues(store) {
  const now = chosen();
  /** @type {(name: keyof typeof now, text: string) => any} */
  const toggle = (name, text) => h("button", { class: "plain small", "aria-pressed": `${now[name]}`, key: name,
    onclick: () => { choose({ [name]: !now[name] }); store.changed(); } }, `${text} ${now[name] ? "on" : "off"}`);
  return h("div", { class: "cues" }, toggle("sound", "Tones"), toggle("speech", "Voice"), toggle("vibration", "Vibration"));
}

/** States in which something may have been written. */
const WRITING = new Set(["applying", "waiting_for_reboot", "verifying", "rolling_back", "in_doubt"]);

/** What is known while nobody answers. @param {Store} store @param {JobModel} job */
function lost(store, job) {
  const known = WRITING.has(job.state) ? "The write is finished or taken back when the service returns." : "Nothing had been written by then.";
  return h("p", { class: "notice", role: "alert" }, `${store.connection.text}. ${known} This page tries again by itself.`);
}

/** @param {Store} store @param {JobModel} job */
function silent(store, job) {
  const vehicle = store.vehicles.get(job.vehicle_id ?? "");
  return vehicle?.silent && job.state !== "waiting_for_reboot" && job.prompt?.step !== "silent" // the prompt says it
    ? h("p", { class: "notice", role: "alert" }, "The vehicle is silent. Check its power and the link; the job goes on when it is heard again.") : null;
}

/** @param {JobModel} job */
function warnings(job) {
  const said = job.left_out.length + job.broken.length > 0;
  const texts = job.warnings.filter((text) => !(said && text.includes("left out"))); // it stands first
  if (!texts.length) return null;
  return h("details", { class: "card", open: texts.length <= 2 },
    h("summary", {}, `${texts.length} ${texts.length === 1 ? "warning" : "warnings"}`),
    h("ul", {}, texts.map((text) => h("li", { class: "warn" }, sentence(text)))));
}
