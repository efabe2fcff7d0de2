// Calls of the service. Every address is relative, so that the panel works behind any path prefix.

const BASE = "./api/v1";

/** Ask the service; an answer that is a problem document becomes an Error with its text. */
async function call(method, path, body, headers = {}) {
  const response = await fetch(BASE + path, {
    method,
    headers: body === undefined ? headers : { "Content-Type": "application/json", ...headers },
    body: body === undefined ? undefined : JSON.stringify(body),
  });
  const text = await response.text();
  const answer = text ? JSON.parse(text) : null;
  if (!response.ok) {
    throw new Error(answer?.detail ?? answer?.title ?? `the service answered ${response.status}`);
  }
  return answer;
}

export const api = {
  links: () => call("GET", "/links"),
  openLink: (url) => call("POST", "/links", { url }),
  closeLink: (id) => call("DELETE", `/links/${encodeURIComponent(id)}`),
  vehicles: () => call("GET", "/vehicles"),
  procedures: () => call("GET", "/procedures"),
  jobs: () => call("GET", "/jobs"),
  job: (id) => call("GET", `/jobs/${encodeURIComponent(id)}`),
  start: (vehicle, kind) => call("POST", `/vehicles/${encodeURIComponent(vehicle)}/jobs`, { kind }),
  answer: (id, value) => call("POST", `/jobs/${encodeURIComponent(id)}/answers`, { value }),
  cancel: (id) => call("DELETE", `/jobs/${encodeURIComponent(id)}`),
  // The plan's digest is the key: the same acceptance sent twice is one.
  apply: (id, digest, reboot) =>
    call("POST", `/jobs/${encodeURIComponent(id)}/apply`, { plan_sha256: digest, reboot },
      { "Idempotency-Key": `${id}-${digest.slice(0, 16)}-${reboot}` }),
  revert: (id) => call("POST", `/jobs/${encodeURIComponent(id)}/revert`, {}),
};

/** Follow everything that happens; `changed(event)` gets each event, `state(text, ok)` the connection's state. */
export function follow(changed, state) {
  const source = new EventSource(`${BASE}/events`);
  source.onopen = () => state("live", true);
  source.onerror = () => state("connection lost, trying again …", false);
  source.addEventListener("job", (event) => changed(JSON.parse(event.data)));
  source.addEventListener("vehicle", (event) => changed(JSON.parse(event.data)));
  return source;
}
