// Calls of the service. Every address is relative, so that the panel works behind any path prefix.

/**
 * @import { JobModel, JobSummary, LinkModel, PlanModel, ProcedureModel, VehicleModel } from "./mavcal.d.ts"
 * @import { JobEvent, TicketModel } from "./mavcal.d.ts"
 */

const BASE = "./api/v1";
const KEY = "mavcal-key";
const AGAIN_MS = 2000;

/** The service asks for an API key, or for another one. */
export class KeyNeeded extends Error {}

/** Use this API key until the window is closed. */
export function useKey(key) {
  sessionStorage.setItem(KEY, key);
}

function authorization() {
  const key = sessionStorage.getItem(KEY);
  return key ? { Authorization: `Bearer ${key}` } : {};
}

async function decoded(response) {
  const text = await response.text();
  try {
    return text ? JSON.parse(text) : null;
  } catch {
    return { detail: `the answer ${response.status} is not from mavcal` };
  }
}

/** Ask the service; an answer that is a problem document becomes an Error with its text. */
async function call(method, path, body, headers = {}) {
  const response = await fetch(BASE + path, {
    method,
    headers: { ...authorization(), ...(body === undefined ? {} : { "Content-Type": "application/json" }), ...headers },
    body: body === undefined ? undefined : JSON.stringify(body),
  });
  const answer = await decoded(response);
  if (response.status === 401) throw new KeyNeeded(answer?.detail ?? "an API key is needed");
  if (!response.ok) {
    throw new Error(answer?.detail ?? answer?.title ?? `the service answered ${response.status}`);
  }
  return answer;
}

const id = encodeURIComponent;

export const api = {
  /** @returns {Promise<LinkModel[]>} */
  links: () => call("GET", "/links"),
  openLink: (url) => call("POST", "/links", { url }),
  closeLink: (link) => call("DELETE", `/links/${id(link)}`),
  /** @returns {Promise<VehicleModel[]>} */
  vehicles: () => call("GET", "/vehicles"),
  /** @returns {Promise<ProcedureModel[]>} */
  procedures: () => call("GET", "/procedures"),
  /** @returns {Promise<JobSummary[]>} */
  jobs: (count) => call("GET", `/jobs?order=newest&limit=${count}`),
  /** @returns {Promise<JobModel>} */
  job: (job) => call("GET", `/jobs/${id(job)}`),
  /** @returns {Promise<JobModel>} */
  start: (vehicle, kind) => call("POST", `/vehicles/${id(vehicle)}/jobs`, { kind }),
  /** @returns {Promise<JobModel>} */
  answer: (job, value) => call("POST", `/jobs/${id(job)}/answers`, { value }),
  /** @returns {Promise<JobModel>} */
  cancel: (job) => call("DELETE", `/jobs/${id(job)}`),
  /** @returns {Promise<PlanModel>} */
  planAgain: (job) => call("POST", `/jobs/${id(job)}/plan`, {}),
  // The plan's digest is the key: the same acceptance sent twice is one.
  /** @returns {Promise<JobModel>} */
  apply: (job, digest, reboot) =>
    call("POST", `/jobs/${id(job)}/apply`, { plan_sha256: digest, reboot },
      { "Idempotency-Key": `${job}-${digest.slice(0, 16)}-${reboot}` }),
  /** @returns {Promise<JobModel>} */
  revert: (job) => call("POST", `/jobs/${id(job)}/revert`, {}),
  /** A file of the result, as text: a link could not carry the key. */
  exported: async (job, form) => {
    const response = await fetch(`${BASE}/jobs/${id(job)}/export.${form}`, { headers: authorization() });
    if (!response.ok) throw new Error((await decoded(response))?.detail ?? "no file");
    return response.text();
  },
};

/**
 * Follow everything that happens, for ever: `told(name, data)` gets each event, `opened()` is called whenever the
 * stream begins (what happened before has to be read), `lost(error)` whenever it ends.
 */
export async function follow(told, opened, lost) {
  let ticket;
  try {
    ({ ticket } = await call("POST", "/tickets")); // an EventSource cannot send headers
  } catch (error) {
    lost(error);
    if (!(error instanceof KeyNeeded)) setTimeout(() => follow(told, opened, lost), AGAIN_MS);
    return;
  }
  const source = new EventSource(`${BASE}/events${ticket ? `?ticket=${id(ticket)}` : ""}`);
  source.onopen = opened;
  source.onerror = () => {
    source.close(); // not by itself: a ticket opens one stream
    lost(new Error("connection lost, trying again …"));
    setTimeout(() => follow(told, opened, lost), AGAIN_MS);
  };
  for (const name of ["job", "vehicle", "link"]) {
    source.addEventListener(name, (event) => told(name, JSON.parse(event.data)));
  }
}
