// Keeps the page in step with the service: one event stream, and a fresh read of what changed.

import { api, follow } from "./api.js";
import { el, jobCard, linkRow, vehicleCard } from "./render.js";

const page = (id) => document.getElementById(id);
const jobs = new Map();
let vehicles = [];
let procedures = [];
let notice = 0;

const RUNNING = new Set(["queued", "running", "waiting_for_operator", "fitting", "applying", "waiting_for_reboot",
  "verifying", "rolling_back", "in_doubt"]);

function complain(error) {
  page("notice").textContent = error.message;
  page("notice").hidden = false;
  clearTimeout(notice);
  notice = setTimeout(() => { page("notice").hidden = true; }, 8000);
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

const actions = {
  start: acting((vehicle, kind) => api.start(vehicle, kind)),
  answer: acting((id, value) => api.answer(id, value)),
  cancel: acting((id) => api.cancel(id)),
  apply: acting((id, digest, reboot) => api.apply(id, digest, reboot)),
  revert: acting((id) => api.revert(id)),
  closeLink: acting((id) => api.closeLink(id)),
};

function drawVehicles() {
  const busy = (id) => [...jobs.values()].some((job) => job.vehicle_id === id && RUNNING.has(job.state));
  const cards = vehicles.map((vehicle) => vehicleCard(vehicle, procedures, busy(vehicle.id), actions));
  page("vehicles").replaceChildren(...(cards.length ? cards
    : [el("p", { class: "quiet" }, "No vehicle has been heard yet.")]));
}

function drawJobs() {
  if (!jobs.size) return;
  const newest = [...jobs.values()].sort((a, b) => b.created_at - a.created_at);
  page("jobs").replaceChildren(...newest.map((job) => jobCard(job, actions)));
}

async function readJob(id) {
  jobs.set(id, await api.job(id));
  drawJobs();
  drawVehicles();
}

async function readVehicles() {
  const [heard, links] = await Promise.all([api.vehicles(), api.links()]);
  vehicles = heard;
  drawVehicles();
  page("links").replaceChildren(...links.map((link) => linkRow(link, actions)));
}

async function refresh() {
  try {
    if (!procedures.length) procedures = await api.procedures();
    const listed = await api.jobs();
    await Promise.all(listed.map(async (job) => jobs.set(job.id, await api.job(job.id))));
    await readVehicles();
    drawJobs();
  } catch (error) {
    complain(error);
  }
}

function changed(event) {
  const known = jobs.get(event.job_id);
  if (event.kind === "progress" && known) {
    jobs.set(event.job_id, { ...known, progress: event.data });
    drawJobs();
  } else if (event.job_id) {
    readJob(event.job_id).catch(complain);
  }
}

page("link-form").addEventListener("submit", acting(async (event) => {
  event.preventDefault();
  await api.openLink(page("link-url").value.trim());
}));

follow(changed, (text, ok) => {
  page("connection").textContent = text;
  page("connection").className = ok ? "good" : "bad";
  if (ok) refresh();
});
setInterval(() => readVehicles().catch(() => {}), 2000);
