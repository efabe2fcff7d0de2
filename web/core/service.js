// Calls of the service, by operation. Every address is relative, so that the panel works behind any path prefix.

import { OPERATIONS } from "../operations.js";

/**
 * @import { JobEvent, LinkModel, Operations, VehicleModel } from "../mavcal.d.ts"
 * @typedef {{ parameters?: Record<string, string>, query?: Record<string, any>, body?: any, header?: Record<string, any> }} AnyAsked
 */
/**
 * What an operation takes: its parameters, query, header and body.
 * @template {keyof Operations} K
 * @typedef {Omit<Operations[K], "method" | "path" | "answer" | "message">} Asked
 */

const KEY = "mavcal-key";
const AGAIN_MS = 1500;

/** The service asks for an API key, or for another one. */
export class KeyNeeded extends Error {}

/** The service refused: `code` is that of the problem, `status` that of HTTP. */
export class Refused extends Error {
  /** @param {string} text @param {number} status @param {string} code */
  constructor(text, status, code) {
    super(text);
    this.status = status;
    this.code = code;
  }
}

/** Nobody answered. */
export class Unreachable extends Error {}

/** Use this API key until the window is closed. @param {string} key */
export function useKey(key) {
  sessionStorage.setItem(KEY, key);
}

/** Whether a key is in use: what the browser fetches by itself does not carry it. */
export const hasKey = () => sessionStorage.getItem(KEY) !== null;

/** @returns {Record<string, string>} */
function authorization() {
  const key = sessionStorage.getItem(KEY);
  return key ? { Authorization: `Bearer ${key}` } : {};
}

/** The address of an operation, relative to the page. @param {keyof Operations} name @param {AnyAsked} asked */
export function address(name, asked = {}) {
  const path = OPERATIONS[name][1].replace(/{(\w+)}/g, (_, key) => encodeURIComponent(asked.parameters?.[key] ?? ""));
  const query = new URLSearchParams();
  for (const [key, value] of Object.entries(asked.query ?? {})) {
    if (value !== undefined && value !== null) query.set(key, typeof value === "object" ? JSON.stringify(value) : `${value}`);
  }
  return `.${path}${query.size ? `?${query}` : ""}`;
}

/** @param {Response} response */
async function decoded(response) {
  const text = await response.text();
  if (!response.headers.get("Content-Type")?.includes("json")) return response.ok ? text : { detail: text.slice(0, 200) };
  try {
    return text ? JSON.parse(text) : null;
  } catch {
    return { detail: `the answer ${response.status} is not from mavcal` };
  }
}

/**
 * Ask the service. Throws KeyNeeded, Refused or Unreachable.
 * @template {keyof Operations} K
 * @param {K} name
 * @param {Asked<K>} [asked]
 * @returns {Promise<Operations[K] extends { answer: infer A } ? A : never>}
 */
export async function ask(name, asked) {
  const given = /** @type {AnyAsked} */ (asked ?? {});
  const file = given.body instanceof Blob;
  /** @type {Record<string, string>} */
  const headers = { ...authorization() };
  for (const [key, value] of Object.entries(given.header ?? {})) headers[key] = `${value}`;
  if (given.body !== undefined) headers["Content-Type"] = file ? "application/octet-stream" : "application/json";
  let response;
  try {
    const body = given.body === undefined ? undefined : file ? given.body : JSON.stringify(given.body);
    response = await fetch(address(name, given), { method: OPERATIONS[name][0], headers, body });
  } catch {
    throw new Unreachable("The service does not answer.");
  }
  const answer = await decoded(response);
  if (response.status === 401) throw new KeyNeeded(answer?.detail ?? "An API key is needed.");
  if (!response.ok) {
    const text = answer?.detail ?? answer?.title ?? `The service answered ${response.status}.`;
    throw new Refused(text, response.status, answer?.code ?? "");
  }
  return answer;
}

/**
 * Upload a file, and hear how much has gone.
 * @param {File} file
 * @param {(share: number) => void} told
 * @param {AbortSignal} stop
 * @returns {Promise<Operations["upload_recording"]["answer"]>}
 */
export function upload(file, told, stop) {
  return new Promise((done, fail) => {
    const request = new XMLHttpRequest(); // fetch does not tell how much of a body has gone
    request.open("POST", address("upload_recording", { query: { name: file.name } }));
    for (const [name, value] of Object.entries(authorization())) request.setRequestHeader(name, value);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.upload.onprogress = (event) => told(event.lengthComputable ? event.loaded / event.total : 0);
    request.onload = () => {
      let answer;
      try {
        answer = JSON.parse(request.responseText);
      } catch {
        answer = {};
      }
      if (request.status < 300) done(answer);
      else fail(new Refused(answer.detail ?? `The service answered ${request.status}.`, request.status, answer.code ?? ""));
    };
    request.onerror = () => fail(new Unreachable("The upload broke off. Drop the file again."));
    request.onabort = () => fail(new Refused("The upload was cancelled.", 0, "cancelled"));
    stop.addEventListener("abort", () => request.abort());
    request.send(file);
  });
}

/**
 * Follow a stream until `stop` is called; begins again by itself. `told(event, data)` gets each message,
 * `opened()` is called whenever it begins, `lost(error)` whenever it ends.
 * @param {keyof Operations} name
 * @param {AnyAsked | (() => Promise<AnyAsked>)} asked what it takes; a function is called whenever the stream begins
 * @param {string[]} events
 * @param {{ told: (name: string, data: any) => void, opened?: () => void, lost?: (error: Error) => void }} to
 * @returns {() => void} stop
 */
export function follow(name, asked, events, to) {
  /** @type {EventSource | undefined} */
  let source;
  let stopped = false;
  let timer = 0;
  const again = () => { if (!stopped) timer = window.setTimeout(begin, AGAIN_MS); };
  async function begin() {
    let ticket, given;
    try {
      given = typeof asked === "function" ? await asked() : asked;
      if (stopped) return;
      ({ ticket } = await ask("make_ticket")); // an EventSource cannot send headers
    } catch (error) {
      to.lost?.(/** @type {Error} */ (error));
      if (!(error instanceof KeyNeeded)) again();
      return;
    }
    if (stopped) return;
    source = new EventSource(address(name, { ...given, query: { ...given.query, ...(ticket ? { ticket } : {}) } }));
    source.onopen = () => to.opened?.();
    source.onerror = () => {
      source?.close(); // not by itself: a ticket opens one stream
      to.lost?.(new Unreachable("The service does not answer."));
      again();
    };
    for (const event of events) source.addEventListener(event, (message) => to.told(event, JSON.parse(message.data)));
  }
  begin();
  return () => {
    stopped = true;
    clearTimeout(timer);
    source?.close();
  };
}

/** A file of the service, saved by the browser: a link could not carry the key. @param {keyof Operations} name @param {any} asked @param {string} as */
export async function save(name, asked, as) {
  const text = /** @type {any} */ (await ask(name, asked));
  const file = new Blob([typeof text === "string" ? text : JSON.stringify(text, null, 2)], { type: "text/plain" });
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(file), download: as });
  link.click();
  window.setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
