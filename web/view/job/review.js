// The review that one can read: what was wrong, what it will be, what stands against it; the parameters folded below.

import { h } from "../../core/dom.js";
import { ask, save } from "../../core/service.js";
import { number, rough, sentence, unitName, words } from "../../core/words.js";
import { badge, quiet, table, VERDICT_TONES } from "../parts.js";
import { mountings } from "./mounting.js";
import { takenBack } from "./outcome.js";

/** @import { ChangeModel, JobModel, PlanModel, ReviewModel } from "../../mavcal.d.ts" */
/** @typedef {typeof import("../../core/store.js").store} Store */

/** @param {Store} store @param {JobModel} job */
function reviewOf(store, job) {
  return store.answer(`review ${job.id} ${job.plan?.sha256 ?? ""} ${job.state}`, () => ask("get_review", { parameters: { job_id: job.id } }), 1e9);
}

/** @param {Store} store @param {JobModel} job */
export function review(store, job) {
  const plan = job.plan;
  if (!plan) return quiet("There is no plan: see the reason above.");
  const found = reviewOf(store, job);
  return h("section", { class: "review", "aria-label": "Review" },
    found ? headline(found) : quiet("Reading the review …"),
    plan.blockers.map((text, i) => h("p", { class: "notice", role: "alert", key: `b${i}` }, `Nothing will be written: ${onPage(text)}`)),
    found ? criteria(found, job.left_out.length > 0) : null,
    found?.picture ? picture(store, job) : null,
    notes(plan),
    plan.agreements.length ? h("ul", {}, plan.agreements.map((agreement) => h("li", { class: "quiet" }, sentence(agreement.text)))) : null,
    losses(plan),
    choices(store, job, plan, found),
    h("details", { class: "card" }, h("summary", {}, `${plan.changes.length} parameters: old, new, uncertainty`), changes(plan)),
    exports(store, job));
}

/** @param {ReviewModel} found */
function headline(found) {
  return h("div", { class: "headline" },
    h("h2", {}, found.headline),
    found.sensors.length > 1 ? h("ul", { class: "plain" }, found.sensors.map((sensor) =>
      h("li", { key: `${sensor.sensor}${sensor.instance}` }, h("strong", {}, `${unitName(sensor.sensor, sensor.instance)}: `), sensor.text))) : null);
}

/** What passes is folded; what does not stands open with its remedy. @param {ReviewModel} found @param {boolean} inPart */
function criteria(found, inPart) {
  const passed = found.criteria.filter((criterion) => criterion.verdict === "pass");
  const others = found.criteria.filter((criterion) => criterion.verdict !== "pass");
  /** @type {(these: typeof passed) => any} */
  const list = (these) => h("ul", { class: "plain criteria" }, these.map((criterion) =>
    h("li", { key: criterion.id }, badge(VERDICT_TONES[criterion.verdict], words(criterion.verdict)),
      h("span", {}, sentence(criterion.text)), criterion.remedy ? h("span", { class: "quiet" }, criterion.remedy) : null)));
  return h("div", {}, others.length ? list(others) : null,
    passed.length ? h("details", { class: "card" },
      h("summary", {}, badge("good", `${passed.length} of ${found.criteria.length} ${inPart ? "pass for what is written" : "criteria pass"}`)), list(passed)) : null);
}

/** The same picture as in the export: before and after. @param {Store} store @param {JobModel} job */
function picture(store, job) {
  const columns = window.innerWidth < 700 ? 1 : window.innerWidth < 1400 ? 2 : 3;
  const svg = store.answer(`picture ${job.id} ${columns} ${job.plan?.sha256}`, () =>
    ask("get_picture", { parameters: { job_id: job.id }, query: { columns } }), 1e9);
  if (!svg) return null;
  return h("figure", { class: "before-after" },
    h("img", { src: `data:image/svg+xml;charset=utf-8,${encodeURIComponent(svg)}`, alt: "The sensor before and after this calibration" }));
}

/** What a person should know before writing: open where it is short. @param {PlanModel} plan */
function notes(plan) {
  const agreed = plan.agreements.map(({ text }) => text);
  const warnings = [...new Set(plan.warnings)].filter((text) => !agreed.some((other) => text.includes(other) || other.includes(text))); // read below
  if (!warnings.length) return null;
  return h("details", { class: "card", open: warnings.length <= 2 },
    h("summary", {}, badge("warn", warnings.length === 1 ? "1 thing to know" : `${warnings.length} things to know`)),
    h("ul", { class: "plan-warnings" }, warnings.map((text) => h("li", { class: "warn" }, sentence(onPage(text))))));
}

/** @param {PlanModel} plan */
function losses(plan) {
  if (!plan.losses.length) return null;
  return h("details", { class: "card" }, h("summary", {}, "What this autopilot cannot hold"),
    h("ul", {}, plan.losses.map((loss) => h("li", {}, `${sentence(loss.text)} Cost: ${rough(loss.cost)} ${loss.unit}.`))));
}

/** An advice about a plan without the names that it has elsewhere. @param {string} text */
function onPage(text) {
  return text.replace(/ Confirm it with the plan option .*$/, " Confirm it below, once you have looked.")
    .replaceAll(/the plan option (confirm_\w+|keep_gyro_at_boot) \(--[\w-]+\)/g, "the choice below").replaceAll(/ \(--[\w-]+\)/g, "");
}

/** What only a person can know, once they have looked. */
const CONFIRMATIONS = { confirm_mounting: "I have looked: the compass is mounted as said", confirm_other_unit: "The log really is of this vehicle" };

/**
 * Which sensors, and what else the person decides; each choice makes the plan again.
 * @param {Store} store @param {JobModel} job @param {PlanModel} plan @param {ReviewModel | undefined} found
 */
function choices(store, job, plan, found) {
  const options = /** @type {Record<string, any>} */ (job.plan_options);
  const sensors = [...new Set(job.results.map((fit) => `${fit.sensor}${fit.instance}`))];
  const wanted = /** @type {string[]} */ (options.only?.length ? options.only : sensors);
  const agreeing = new Set(plan.agreements.map(({ sensor, instance }) => `${sensor}${instance}`));
  const only = wanted.filter((name) => !agreeing.has(name));
  /** @type {(change: Record<string, any>) => Promise<any>} */
  const again = (change) => store.act(async () => {
    await ask("renew_plan", { parameters: { job_id: job.id }, body: { plan_options: { ...options, ...change } } });
    await store.load(job.id);
  });
  /** @type {(name: string, text: string, on: boolean, change: Record<string, any>, off?: boolean) => any} */
  const box = (name, text, on, change, off = false) => h("label", { class: "choice", key: name },
    h("input", { type: "checkbox", checked: on, disabled: off, onchange: () => again(change) }), text);
  const gyro = job.results.some((fit) => fit.sensor === "gyro") && plan.fingerprint.autopilot === "ardupilot";
  return h("fieldset", { class: "choices" }, h("legend", {}, "What is written"),
    sensors.length > 1 ? job.results.map(({ sensor, instance }) => {
      const name = `${sensor}${instance}`;
      const on = only.includes(name);
      if (agreeing.has(name)) return box(name, `${unitName(sensor, instance)}: as it is, nothing new to write`, false, {}, true);
      return box(name, unitName(sensor, instance), on, { only: on ? only.filter((other) => other !== name) : [...only, name] }, on && only.length === 1);
    }) : null,
    gyro ? box("keep", "Keep the gyro offsets at the next start (INS_GYR_CAL = 0)", options.keep_gyro_at_boot === true, { keep_gyro_at_boot: options.keep_gyro_at_boot !== true }) : null,
    mountings(job, store.vehicles.get(job.vehicle_id ?? ""), found, options, again),
    Object.entries(CONFIRMATIONS).map(([name, text]) => options[name] === true || [...plan.blockers, ...plan.warnings].some((said) => said.includes(name))
      ? box(name, text, options[name] === true, { [name]: options[name] !== true }) : null),
    h("button", { class: "plain small", onclick: () => again({}) }, "Plan again on the present parameters"));
}

/** @param {PlanModel} plan */
function changes(plan) {
  return table(["parameter", ">now", ">new", ">± sd", "unit", "why"],
    plan.changes.map((change) => [change.name, number(change.old, 6), number(change.new, 6), rough(change.sd), change.unit, change.why]), "Parameters", [0, 1, 2]);
}

/** @param {Store} store @param {JobModel} job */
function exports(store, job) {
  const forms = /** @type {const} */ (["param", "params", "json", "csv", "html"]);
  return h("div", { class: "actions small" }, h("span", { class: "quiet" }, "Save as"), forms.map((form) =>
    h("button", { class: "plain", key: form, onclick: () => store.act(() => save("export_job", { parameters: { job_id: job.id, form } }, `mavcal-${job.id}.${form}`)) }, `.${form}`)));
}

/** How many parameters have been sent, in the order of the plan. What follows the sending tells of none. @param {Store} store @param {JobModel} job */
function sentOf(store, job) {
  const { state, progress } = job;
  const kept = store.keep(`sent ${job.id} ${job.plan?.sha256}`, () => ({ sent: 0 }));
  if (state === "rolling_back") kept.sent = 0;
  if (state === "applying" && progress?.text.startsWith("writing:")) kept.sent = Math.max(kept.sent, progress.current);
  if (["waiting_for_reboot", "verifying"].includes(state)) kept.sent = Infinity; // nothing gets so far that was not sent
  return kept.sent;
}

/** While and after it is written: each parameter, and what the stream proves of it. @param {Store} store @param {JobModel} job */
export function written(store, job) {
  const { plan, verification } = job;
  if (!plan || !plan.changes.length) return null;
  const found = job.state === "succeeded" ? reviewOf(store, job) : undefined;
  const running = ["applying", "verifying", "waiting_for_reboot", "rolling_back"].includes(job.state);
  const undone = takenBack(job);
  const verdicts = new Map(((undone ? null : verification)?.parameters ?? []).map((p) => [p.name, p]));
  const sent = sentOf(store, job);
  /** @type {(change: ChangeModel, i: number) => any} */
  const state = (change, i) => {
    const verdict = verdicts.get(change.name);
    if (verdict) {
      const tone = { proved: "good", consistent: "warn", not_observable: "warn", contradicted: "bad" }[verdict.verdict];
      return badge(/** @type {any} */ (tone), words(verdict.verdict));
    }
    if (undone) return badge("good", "old value");
    if (job.state === "rolling_back") return badge("busy", "is taken back");
    return running ? i < sent ? badge("good", "written") : badge("busy", "waits") : null;
  };
  return h("div", { key: "written" },
    found ? headline(found) : null,
    found?.picture ? picture(store, job) : null,
    verification?.sensors.length && !undone ? h("ul", { class: "plain criteria" }, verification.sensors.map((check) =>
      h("li", { key: check.id + check.instance }, badge(check.verdict === "right" ? "good" : check.verdict === "wrong" ? "bad" : "warn", words(check.verdict)), h("span", {}, check.text)))) : null,
    verification?.movement && !undone ? h("p", { class: "quiet" }, `To prove the rest: ${verification.movement.text}`) : null,
    h("details", { class: "card", open: job.state === "applying" }, h("summary", {}, `${plan.changes.length} parameters${takenBack(job) ? ", each read back" : ""}`),
      table(["parameter", "state", ">before", ">new"], plan.changes.map((change, i) =>
        [change.name, state(change, i), number(change.old, 6), number(change.new, 6)]), "Parameters", [0, 1])),
    running ? null : exports(store, job));
}
