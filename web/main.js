// Keeps the page in step with the service: one event stream, and a fresh read of what changed.

import { api, follow, KeyNeeded, useKey } from "./api.js";
import { jobCard, linkRow, showProgress, vehicleCard } from "./render.js";

/** @import { JobModel, LinkModel, ProcedureModel, VehicleModel } from "./mavcal.d.ts" */

const LOOK_MS = 5000; // a vehicle or link that has gone sends no event
const SHOWN_JOBS = 20;

const page = (id) => document.getElementById(id);
const field = (id) => /** @type {HTMLInputElement} */ (page(id));
/** @type {Map<string, JobModel>} */
const jobs = new Map();
/** @type {Map<string, VehicleModel>} */
let vehicles = new Map();
/** @type {Map<string, LinkModel>} */
let links = new Map();
/** @type {ProcedureModel[]} */
let procedures = [];
let noticeTimer = 0;

const FREE = new Set(["review", "succeeded", "reverted", "failed", "cancelled", "interrupted"]);

function complain(error) {
  if (error instanceof KeyNeeded) {
    page("key-form").hidden = false;
    page("key").focus();
    return;
  }
  page("notice").textContent = error.message;
  page("notice").hidden = false;
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => { page("notice").hidden = true; }, 10000);
}

/** Do something, then read again whatever it may have changed; say what went wrong. */
const acting = (act) => async (...given) => {
  try {
    await act(...given);
  } catch (error) {
    complain(error);
  }
  await refresh();
};

async function save(job, form) {
  const file = new Blob([await api.exported(job, form)], { type: "text/plain" });
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(file), download: `mavcal-${job}.${form}` });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

const actions = {
  start: async (vehicle, kind) => {
    await acting(() => api.start(vehicle, kind))();
    page("jobs").firstElementChild?.scrollIntoView({ block: "nearest" }); // its prompt is what the operator needs now
  },
  answer: acting((id, value) => api.answer(id, value)),
  cancel: acting((id) => api.cancel(id)),
  planAgain: acting((id) => api.planAgain(id)),
  apply: acting((id, digest, reboot) => api.apply(id, digest, reboot)),
  revert: acting((id) => api.revert(id)),
  closeLink: acting((id) => api.closeLink(id)),
  save: (id, form) => save(id, form).catch(complain),
};

/**
 * Show one node an item, in this order. A node is replaced only if what it shows has changed: a button that is
 * exchanged under the finger swallows the click.
 */
function keep(container, items, shown, draw) {
  const present = new Map([...container.children].filter((n) => n.dataset.key).map((n) => [n.dataset.key, n]));
  const nodes = items.map((item) => {
    const text = JSON.stringify(shown(item));
    let node = present.get(item.id);
    if (node?.shown !== text) {
      const open = node?.querySelector("details")?.open ?? false;
      const typed = node?.querySelector("input");
      const writing = typed && document.activeElement === typed;
      node = draw(item);
      const field = typed && node.querySelector(`input[name="${typed.name}"]`);
      if (field) field.value = typed.value;
      if (field && writing) queueMicrotask(() => field.focus());
      node.dataset.key = item.id;
      node.shown = text;
      if (open && node.querySelector("details")) node.querySelector("details").open = true;
    }
    return node;
  });
  [...container.children].filter((node) => !nodes.includes(node)).forEach((node) => node.remove());
  nodes.forEach((node, i) => {
    if (container.children[i] !== node) container.insertBefore(node, container.children[i] ?? null);
  });
}

function draw() {
  const busy = (id) => [...jobs.values()].some((job) => job.vehicle_id === id && !FREE.has(job.state));
  page("no-vehicles").hidden = vehicles.size > 0;
  page("no-jobs").hidden = jobs.size > 0;
  keep(page("vehicles"), [...vehicles.values()],
    (v) => [v.autopilot, v.firmware, v.silent, v.armed, v.landed, v.loss.toFixed(3), v.obstacles, busy(v.id), procedures.length],
    (v) => vehicleCard(v, procedures, busy(v.id), actions));
  keep(page("links"), [...links.values()], (l) => [l.url, l.state, l.reason], (l) => linkRow(l, actions));
  const newest = [...jobs.values()].sort((a, b) => b.created_at - a.created_at);
  keep(page("jobs"), newest, ({ progress, updated_at, ...rest }) => [rest, vehicles.get(rest.vehicle_id)?.autopilot, procedures.length],
    (job) => jobCard(job, title(job.kind), vehicles.get(job.vehicle_id), actions));
  newest.forEach((job, i) => showProgress(page("jobs").children[i], job));
}

const OTHERS = { fit: "Fit of a recording", gap: "Gap diagnosis", recording: "Calibration from a recording", campaign: "Campaign" };
const title = (kind) => procedures.find((procedure) => procedure.kind === kind)?.title ?? OTHERS[kind] ?? kind;
const byId = (items) => new Map(items.map((item) => [item.id, item]));

async function refresh() {
  try {
    if (!procedures.length) procedures = await api.procedures();
    const newest = await api.jobs(SHOWN_JOBS);
    const changed = newest.filter((job) => jobs.get(job.id)?.updated_at !== job.updated_at);
    await Promise.all(changed.map(async (job) => jobs.set(job.id, await api.job(job.id))));
    await look();
  } catch (error) {
    complain(error);
  }
}

async function look() {
  const [heard, open] = await Promise.all([api.vehicles(), api.links()]);
  vehicles = byId(heard);
  links = byId(open);
  draw();
}

async function told(name, data) {
  if (name === "vehicle") vehicles.set(data.id, data);
  if (name === "link") links.set(data.id, data);
  if (name === "job") {
    const known = jobs.get(data.job_id);
    if (data.kind === "progress" && known) jobs.set(known.id, { ...known, progress: data.data });
    else if (data.kind !== "item") jobs.set(data.job_id, await api.job(data.job_id));
  }
  draw();
}

function connection(text, good) {
  page("connection").textContent = text;
  page("connection").className = good ? "good" : "bad";
}

function begin() {
  follow((name, data) => told(name, data).catch(complain),
    () => { connection("live", true); refresh(); },
    (error) => {
      connection(error instanceof KeyNeeded ? "no key" : error.message, false);
      if (error instanceof KeyNeeded) complain(error);
    });
}

page("link-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const url = field("link-url").value.trim();
  if (url) acting(() => api.openLink(url))();
});

page("key-form").addEventListener("submit", (event) => {
  event.preventDefault();
  useKey(field("key").value.trim());
  field("key").value = "";
  page("key-form").hidden = true;
  begin();
});

begin();
setInterval(() => look().catch(() => {}), LOOK_MS);
