// The one button of the moment, and the way out, at the lower edge of the screen. What cannot be undone asks once.

import { h } from "../../core/dom.js";
import { go } from "../../core/route.js";
import { ask } from "../../core/service.js";
import { CANCELLABLE, ENDED } from "../../core/store.js";
import { kindName, sentence } from "../../core/words.js";
import { start } from "../tiles.js";

/** @import { JobModel } from "../../mavcal.d.ts" */
/** @typedef {typeof import("../../core/store.js").store} Store */
/** @typedef {{ question: string, yes: string, no: string, act: () => Promise<any>, grave?: boolean }} Question */

const CALIBRATIONS = new Set(["gyro", "accel", "mag", "thermal"]);

/** @param {Store} store @param {JobModel} job */
export function dock(store, job) {
  const asked = store.keep(`question ${job.id}`, () => ({ about: "" }));
  const question = { cancel: cancelling(job), revert: reverting(job) }[/** @type {"cancel" | "revert"} */ (asked.about)];
  const set = (/** @type {string} */ about) => () => { asked.about = about; store.changed(); };
  const content = question ? confirmation(store, job, question, set("")) : buttons(store, job, set);
  return content.length ? h("div", { class: "dock", key: "dock" }, content) : null;
}

/** Do it, then read the job again. @param {Store} store @param {JobModel} job @param {() => Promise<any>} act */
const doing = (store, job, act) => () => store.act(async () => { await act(); await store.load(job.id); });

/** @param {Store} store @param {JobModel} job @param {Question} asked @param {() => void} close */
function confirmation(store, job, { question, yes, no, act, grave }, close) {
  const sure = () => { close(); doing(store, job, act)(); };
  const go = h("button", { class: grave ? "danger" : "primary", key: "sure", onclick: sure }, yes);
  const stay = h("button", { class: grave ? "primary" : "", key: "keep", onclick: close }, no);
  return [h("p", { class: "why", role: "status", key: "why" }, question), ...(grave ? [stay, go] : [go, stay])];
}

/** @param {JobModel} job @returns {Question | null} */
function cancelling(job) {
  if (!CANCELLABLE.has(job.state)) return null;
  const act = () => ask("cancel_job", { parameters: { job_id: job.id } });
  if (job.state === "review") return { question: "Discard this result? Nothing has been written.", yes: "Discard it", no: "Keep it", act, grave: true };
  const what = CALIBRATIONS.has(job.kind) ? `the ${kindName(job.kind).toLowerCase()} calibration` : "this job";
  return { question: `Stop ${what}? Nothing has been written.`, yes: "Stop it", no: "Go on", act, grave: true };
}

/** @param {JobModel} job @returns {Question | null} */
function reverting(job) {
  if (!revertible(job)) return null;
  const act = () => ask("revert_job", { parameters: { job_id: job.id } });
  const count = job.plan?.changes.length ?? 0;
  return { question: `Write the old values of ${count} parameters back? The vehicle has to stay disarmed.`,
    yes: "Yes, write the old values", no: "Keep the new ones", act };
}

/** @param {JobModel} job */
const revertible = (job) => job.state === "succeeded" && (job.plan?.changes.length ?? 0) > 0 && job.vehicle_id !== null;

/** @param {Store} store @param {JobModel} job @param {(about: string) => () => void} set */
function buttons(store, job, set) {
  const parameters = { job_id: job.id };
  const unfinished = job.prompt?.unfinished ?? "";
  const answers = ENDED.has(job.state) ? [] : (job.prompt?.answers ?? []);
  const again = ["failed", "cancelled", "reverted"].includes(job.state) && job.vehicle_id;
  return [
    answers.includes("finish") && unfinished ? h("p", { class: "why", key: "why" }, `Finish now: ${unfinished}`) : null,
    ...answers.map((answer) => h("button", { class: answer === "finish" && unfinished ? "" : "primary", key: answer,
      onclick: doing(store, job, () => ask("answer_job", { parameters, body: { value: answer } })) }, sentence(answer))),
    job.state === "review" && job.plan ? accept(store, job) : null,
    job.state === "interrupted" ? h("button", { class: "primary", onclick: doing(store, job, () => ask("refit_job", { parameters })) }, "Fit what was recorded") : null,
    again ? h("button", { class: "primary", onclick: () => start(store, job.vehicle_id ?? "", job.kind) }, "Try again") : null,
    job.state === "succeeded" && job.vehicle_id
      ? h("button", { class: "primary", key: "done", onclick: () => go("vehicle", job.vehicle_id ?? "") }, "Done") : null,
    CANCELLABLE.has(job.state) ? h("button", { class: "danger way-out", key: "cancel", onclick: set("cancel") }, job.state === "review" ? "Discard" : "Cancel") : null,
    revertible(job) ? h("button", { class: "danger way-out", key: "revert", onclick: set("revert") }, "Take back") : null,
  ].flat().filter((button) => button !== null);
}

/** @param {Store} store @param {JobModel} job */
function accept(store, job) {
  const plan = /** @type {NonNullable<JobModel["plan"]>} */ (job.plan);
  const write = (/** @type {boolean} */ reboot) => doing(store, job, () => ask("apply_plan", {
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
