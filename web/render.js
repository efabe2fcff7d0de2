// Draws what the service says. No decision is taken here.

/** @import { JobModel, LinkModel, NumberModel, OutcomeModel, PlanModel } from "./mavcal.d.ts" */
/** @import { ProcedureModel, StandingModel, VehicleModel, VerificationModel } from "./mavcal.d.ts" */

const GOOD = new Set(["succeeded"]);
const BAD = new Set(["failed", "in_doubt"]);
const ENDED = new Set(["succeeded", "reverted", "failed", "cancelled", "interrupted"]);
const SHOWS_PROGRESS = new Set(["queued", "running", "waiting_for_operator", "applying", "verifying"]);
const CANCELLABLE = new Set(["queued", "running", "waiting_for_operator", "fitting", "review"]);

/** An element with attributes, properties (`onclick`, `disabled`) and children; text is never parsed as HTML. */
export function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name in node && typeof value !== "string") node[name] = value;
    else node.setAttribute(name, value);
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
}

const words = (text) => text.replaceAll("_", " ");
const number = (value) => (value === null || value === undefined ? "–" : Number(value.toPrecision(6)).toString());

const rough = (value) => (value === null || value === undefined ? "–" : value.toPrecision(2));

/**
 * @param {VehicleModel} vehicle
 * @param {ProcedureModel[]} procedures
 */
export function vehicleCard(vehicle, procedures, busy, actions) {
  const state = vehicle.silent ? ["silent", "bad"] : vehicle.armed ? ["armed", "warn"] : ["disarmed", "good"];
  return el("article", { class: "card" },
    el("div", { class: "row" },
      el("h3", {}, `${vehicle.autopilot} ${vehicle.firmware}`),
      el("span", { class: `state ${state[1]}` }, state[0])),
    el("p", { class: "quiet small" },
      `system ${vehicle.system} on ${vehicle.link} · ${words(vehicle.landed)} · loss ${(100 * vehicle.loss).toFixed(1)} %`),
    vehicle.obstacles.length ? el("p", { class: "small warn" }, `Not writable: ${vehicle.obstacles.join("; ")}`) : null,
    el("div", { class: "actions" }, procedures.map((procedure) =>
      el("button", { disabled: busy || vehicle.silent, onclick: () => actions.start(vehicle.id, procedure.kind) },
        procedure.title))));
}

/** @param {LinkModel} link */
export function linkRow(link, actions) {
  return el("li", { class: "row small" },
    el("span", {}, `${link.url}: ${link.state}${link.reason ? `, ${link.reason}` : ""}`),
    el("button", { onclick: () => actions.closeLink(link.id) }, "Close"));
}

/** Bring the progress of a job's card up to date without touching anything else of it. */
export function showProgress(card, job) {
  const place = card.querySelector(".progress");
  if (place) place.replaceChildren(...progressPart(job.progress));
}

/**
 * @param {JobModel} job
 * @param {VehicleModel | undefined} vehicle
 */
export function jobCard(job, title, vehicle, actions) {
  const tone = GOOD.has(job.state) ? "good" : BAD.has(job.state) ? "bad" : "warn";
  return el("article", { class: "card", "data-job": job.id },
    el("div", { class: "row" },
      el("h3", {}, title),
      el("span", { class: `state ${ENDED.has(job.state) || BAD.has(job.state) ? tone : ""}` }, words(job.state))),
    el("p", { class: "quiet small" }, [vehicle ? `${vehicle.autopilot}, system ${vehicle.system}` : job.vehicle_id ?? "uploaded recording",
      new Date(1000 * job.created_at).toLocaleString()].join(" · ")),
    ENDED.has(job.state) ? null : promptPart(job, actions),
    SHOWS_PROGRESS.has(job.state) ? el("div", { class: "progress" }) : null,
    outcomePart(job.outcome, job.verification !== null),
    standingPart(job.standing ?? []),
    planPart(job, actions),
    verificationPart(job.verification),
    el("div", { class: "actions" },
      CANCELLABLE.has(job.state)
        ? el("button", { class: "danger", onclick: () => actions.cancel(job.id) }, "Cancel") : null,
      job.state === "review" ? el("button", { onclick: () => actions.planAgain(job.id) }, "Plan again") : null,
      job.plan ? ["param", "json", "html"].map((form) =>
        el("button", { class: "quiet", onclick: () => actions.save(job.id, form) }, `Save .${form}`)) : null,
      job.state === "succeeded" && job.vehicle_id
        ? el("button", { class: "danger", onclick: () => actions.revert(job.id) }, "Take back") : null));
}

/** @param {JobModel} job */
function promptPart(job, actions) {
  const prompt = job.prompt;
  if (!prompt) return null;
  const detail = [];
  if (prompt.remaining.length) detail.push(`Still missing: ${prompt.remaining.map((p) => words(p)).join(", ")}.`);
  if (prompt.detected) detail.push(`Detected: ${words(prompt.detected)}${prompt.stable ? ", still" : ""}.`);
  return el("div", { role: "status" },
    el("p", { class: "prompt" }, prompt.text),
    detail.length ? el("p", { class: "quiet" }, detail.join(" ")) : null,
    numberPart(job, prompt.number, actions),
    el("div", { class: "actions" }, prompt.answers.map((answer) =>
      el("button", { onclick: () => actions.answer(job.id, answer) }, answer))));
}

/** A field for the number that the prompt asks for. */
function numberPart(job, number, actions) {
  if (!number) return null;
  const field = el("input", { type: "number", name: number.name, min: String(number.low), max: String(number.high),
    step: "any", required: true, "aria-label": words(number.name) });
  return el("form", { onsubmit: (event) => {
    event.preventDefault();
    actions.answer(job.id, field.value);
  } }, field, el("span", {}, number.unit || words(number.name)), el("button", { type: "submit" }, "Answer"));
}

function progressPart(progress) {
  if (!progress) return [];
  const eta = progress.eta === null ? "" : ` · about ${Math.ceil(progress.eta)} s left`;
  return [
    el("progress", { max: Math.max(progress.target, 1e-9), value: Math.min(progress.current, progress.target) }),
    el("p", { class: "quiet small" }, `${progress.text}${eta}`)];
}

/** @param {OutcomeModel} outcome */
function outcomePart(outcome, checked) {
  if (!outcome) return null;
  if (outcome.kind === "result") {
    const text = checked ? `Proof: ${outcome.proof}. ${outcome.text}` : outcome.text;
    return el("p", { class: checked && outcome.proof !== "full" ? "warn" : "good" }, text);
  }
  return el("p", { class: "bad" }, `${outcome.cause} ${outcome.remedy}`);
}

/** @param {StandingModel[]} standing */
function standingPart(standing) {
  if (!standing.length) return null;
  return el("ul", {}, standing.map((s) =>
    el("li", { class: "bad small" }, `${s.name}: last heard ${number(s.value)}, was ${number(s.old)}, to be ${number(s.new)}. ${s.note}`)));
}

/** @param {JobModel} job */
function planPart(job, actions) {
  const plan = job.plan;
  if (!plan) return null;
  if (job.state !== "review") return writtenPart(plan, job);
  const rows = plan.changes.map((change) => el("tr", {},
    el("td", {}, change.name),
    el("td", { class: "number" }, number(change.old)),
    el("td", { class: "number" }, number(change.new)),
    el("td", { class: "number" }, rough(change.sd)),
    el("td", {}, change.unit),
    el("td", { class: "why" }, change.why)));
  const accept = (reboot, text) => el("button",
    { class: "primary", disabled: plan.blockers.length > 0, onclick: () => actions.apply(job.id, plan.sha256, reboot) }, text);
  return el("div", {},
    plan.blockers.map((text) => el("p", { class: "bad" }, `Will not be written: ${text}`)),
    plan.warnings.map((text) => el("p", { class: "warn small" }, text)),
    table(["parameter", ">now", ">new", ">± sd", "unit", "why"], rows),
    plan.losses.length ? el("p", { class: "small" }, "What this autopilot cannot hold:") : null,
    el("ul", {}, plan.losses.map((loss) =>
      el("li", { class: "small" }, `${loss.text} (costs ${rough(loss.cost)} ${loss.unit})`))),
    el("div", { class: "actions" }, accept(false, "Write to the vehicle"),
      plan.needs_reboot ? accept(true, "Write and restart the vehicle") : null));
}

/** What the job's plan holds, once it has left review. */
function writtenPart(plan, job) {
  const rows = plan.changes.map((change) => el("tr", {},
    el("td", {}, change.name),
    el("td", { class: "number" }, number(change.old)),
    el("td", { class: "number" }, number(change.new))));
  const what = job.state === "succeeded" ? "Written" : "Planned";
  return el("details", {}, el("summary", {}, `${what}: ${plan.changes.length} parameters`),
    table(["parameter", ">before", ">new"], rows));
}

/** A heading that begins with ">" stands over numbers. */
const table = (head, rows) => el("div", { class: "scroll" }, el("table", {},
  el("thead", {}, el("tr", {}, head.map((text) =>
    el("th", { class: text.startsWith(">") ? "number" : "" }, text.replace(">", ""))))), el("tbody", {}, rows)));

/** @param {VerificationModel} verification */
function verificationPart(verification) {
  if (!verification) return null;
  const tones = { proved: "good", consistent: "warn", not_observable: "warn", contradicted: "bad" };
  return el("details", {},
    el("summary", {}, verification.proved ? "Proved on the vehicle" : "What the vehicle's stream proves"),
    el("ul", { class: "small" }, verification.parameters.map((p) =>
      el("li", { class: tones[p.verdict] }, `${p.name}: ${words(p.verdict)}. ${p.text}`))),
    verification.movement ? el("p", { class: "small" }, verification.movement.text) : null);
}
