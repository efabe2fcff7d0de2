// The room of one job: while it runs, the prompt and its button are all that matters.

import { h } from "../../core/dom.js";
import { go, to } from "../../core/route.js";
import { ask } from "../../core/service.js";
import { CANCELLABLE, ENDED } from "../../core/store.js";
import { kindName, moment, sentence, STATES, tone } from "../../core/words.js";
import { chosen, choose } from "../../core/cues.js";
import { badge, quiet } from "../parts.js";
import { notice } from "../shell.js";
import { vehicleName } from "../home.js";
import { guide } from "./guide.js";
import { outcome, standing } from "./outcome.js";
import { promptPart } from "./prompt.js";
import { review, written } from "./review.js";
import { start } from "../tiles.js";

/** @import { JobModel, JobSummary } from "../../mavcal.d.ts" */
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
    over ? null : h("div", { class: "now", key: "now" }, promptPart(store, job), store.connection.good ? silent(store, job) : lost(store), notice(store)),
    h("div", { class: "body", key: "body" },
      over ? h("div", { key: "over" }, notice(store), outcome(job)) : guide(store, job),
      over ? null : cues(store),
      standing(job),
      job.state === "review" ? review(store, job) : written(store, job),
      warnings(job)),
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
    h("div", { class: "badges" }, badge(tone(job.state), STATES[job.state])),
    ENDED.has(job.state) ? null : cues(store));
}

/** Signs for somebody who does not look. @param {Store} store */
function cues(store) {
  const now = chosen();
  /** @type {(name: keyof typeof now, text: string) => any} */
  const toggle = (name, text) => h("button", { class: "plain small", "aria-pressed": `${now[name]}`, key: name,
    onclick: () => { choose({ [name]: !now[name] }); store.changed(); } }, `${text} ${now[name] ? "on" : "off"}`);
  return h("div", { class: "cues" }, toggle("sound", "Tones"), toggle("speech", "Voice"), toggle("vibration", "Vibration"));
}

/** @param {Store} store */
const lost = (store) => h("p", { class: "notice", role: "alert" }, `${store.connection.text} The job goes on in the service.`);

/** @param {Store} store @param {JobModel} job */
function silent(store, job) {
  const vehicle = store.vehicles.get(job.vehicle_id ?? "");
  return vehicle?.silent && job.state !== "waiting_for_reboot"
    ? h("p", { class: "notice", role: "alert" }, "The vehicle is silent. Check its power and the link; the job goes on when it is heard again.") : null;
}

/** @param {JobModel} job */
function warnings(job) {
  if (!job.warnings.length) return null;
  return h("details", { class: "card", open: job.warnings.length <= 2 },
    h("summary", {}, `${job.warnings.length} ${job.warnings.length === 1 ? "warning" : "warnings"}`),
    h("ul", {}, job.warnings.map((text) => h("li", { class: "warn" }, sentence(text)))));
}

/** The one button of the moment, and the way out, at the lower edge of the screen. @param {Store} store @param {JobModel} job */
function dock(store, job) {
  const parameters = { job_id: job.id };
  /** @type {(act: () => Promise<any>) => () => void} */
  const doing = (act) => () => store.act(async () => { await act(); await store.load(job.id); });
  const answers = ENDED.has(job.state) ? [] : (job.prompt?.answers ?? []);
  const again = ["failed", "cancelled", "reverted"].includes(job.state) && job.vehicle_id;
  const buttons = [
    ...answers.map((answer, i) => h("button", { class: i ? "" : "primary", key: answer,
      onclick: doing(() => ask("answer_job", { parameters, body: { value: answer } })) }, sentence(answer))),
    job.state === "review" && job.plan ? accept(store, job, doing) : null,
    job.state === "interrupted" ? h("button", { class: "primary", onclick: doing(() => ask("refit_job", { parameters })) }, "Fit what was recorded") : null,
    again ? h("button", { class: "primary", onclick: () => start(store, job.vehicle_id ?? "", job.kind) }, "Try again") : null,
    job.state === "succeeded" && job.vehicle_id
      ? h("button", { class: "primary", onclick: () => go("vehicle", job.vehicle_id ?? "") }, "Done") : null,
    CANCELLABLE.has(job.state) ? h("button", { class: "danger", onclick: doing(() => ask("cancel_job", { parameters })) },
      job.state === "review" ? "Discard" : "Cancel") : null,
    job.state === "succeeded" && job.plan?.changes.length && job.vehicle_id ? takeBack(store, job, doing) : null,
  ].flat().filter((button) => button !== null);
  return buttons.length ? h("div", { class: "dock", key: "dock" }, buttons) : null;
}

/** @param {Store} store @param {JobModel} job @param {(act: () => Promise<any>) => () => void} doing */
function accept(store, job, doing) {
  const plan = /** @type {NonNullable<JobModel["plan"]>} */ (job.plan);
  const write = (/** @type {boolean} */ reboot) => doing(() => ask("apply_plan", {
    parameters: { job_id: job.id },
    header: { "idempotency-key": `${job.id}-${plan.sha256.slice(0, 16)}-${reboot}` }, // the same acceptance twice is one
    body: { plan_sha256: plan.sha256, reboot },
  }));
  const text = `Write ${plan.changes.length} parameters`;
  const blocked = plan.blockers.length > 0;
  if (!plan.needs_reboot) return h("button", { class: "primary", disabled: blocked, onclick: write(false) }, text);
  return [
    h("button", { class: "primary", disabled: blocked, key: "reboot", onclick: write(true) }, `${text}, then restart`),
    h("button", { disabled: blocked, key: "later", onclick: write(false) }, "Write, restart later"),
  ];
}

/** Taking back asks once more. @param {Store} store @param {JobModel} job @param {(act: () => Promise<any>) => () => void} doing */
function takeBack(store, job, doing) {
  const asking = store.keep(`take back ${job.id}`, () => ({ sure: false }));
  const set = (/** @type {boolean} */ sure) => () => { asking.sure = sure; store.changed(); };
  if (!asking.sure) return h("button", { class: "danger", key: "ask", onclick: set(true) }, "Take back");
  return [
    h("button", { class: "danger", key: "sure", onclick: () => { asking.sure = false; doing(() => ask("revert_job", { parameters: { job_id: job.id } }))(); } },
      "Yes, write the old values"),
    h("button", { key: "keep", onclick: set(false) }, "Keep the new ones"),
  ];
}
