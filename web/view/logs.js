// Logs: drop one, and see what is in it.

import { h } from "../core/dom.js";
import { go, to } from "../core/route.js";
import { ask, upload } from "../core/service.js";
import { ago, kindName, size, STATES, tone } from "../core/words.js";
import { badge, bar, quiet, title } from "./parts.js";

/** @typedef {typeof import("../core/store.js").store} Store */
/** @typedef {{ name: string, share: number, stop: AbortController }} Uploading */

/** @param {Store} store */
export function logsRoom(store) {
  const recordings = store.answer("recordings", () => ask("list_recordings"), 10000) ?? [];
  const jobs = store.newest().filter((job) => job.kind !== "campaign" && (job.vehicle_id === null || job.kind === "recording")).slice(0, 12);
  return h("div", {},
    title("Logs"),
    dropZone(store, (recording) => go("log", recording.id)),
    recordings.length ? h("ul", { class: "plain jobs" }, [...recordings].reverse().map((recording) =>
      h("li", { key: recording.id }, h("a", { href: to("log", recording.id) }, recording.name),
        h("span", { class: "quiet small" }, `${size(recording.size)} · ${ago(recording.uploaded_at)}`)))) : quiet("No log has been uploaded yet."),
    jobs.length ? h("section", {}, h("h2", {}, "Fits and diagnoses"), h("ul", { class: "plain jobs" }, jobs.map((job) =>
      h("li", { key: job.id }, h("a", { href: job.kind === "gap" ? to("gap", job.id) : to("job", job.id) }, kindName(job.kind)),
        badge(tone(job.state), STATES[job.state]), h("span", { class: "quiet small" }, ago(job.created_at)))))) : null);
}

/** Where a file is dropped or chosen. @param {Store} store @param {(recording: import("../mavcal.d.ts").RecordingModel) => void} done */
export function dropZone(store, done, name = "log", text = "Drop a log here, or choose one") {
  const held = store.keep(`upload ${name}`, () => ({ now: /** @type {Uploading | undefined} */ (undefined), over: false }));
  /** @type {(file: File | null | undefined) => void} */
  const send = (file) => {
    if (!file) return;
    const stop = new AbortController();
    held.now = { name: file.name, share: 0, stop };
    store.act(async () => {
      try {
        const recording = await upload(file, (share) => { if (held.now) held.now.share = share; store.changed(); }, stop.signal);
        store.forget("recordings");
        done(recording);
      } finally {
        held.now = undefined;
      }
    });
  };
  if (held.now) {
    const { name: file, share, stop } = held.now;
    const reading = share >= 1;
    return h("div", { class: "drop", key: name }, h("p", {}, reading ? `Reading ${file} …` : `Uploading ${file}: ${Math.round(100 * share)} %`),
      bar(share, 1, `${Math.round(100 * share)} % uploaded`), h("button", { class: "danger", onclick: () => stop.abort() }, "Cancel"));
  }
  const over = (/** @type {boolean} */ on) => (/** @type {DragEvent} */ event) => { event.preventDefault(); held.over = on; store.changed(); };
  return h("label", { class: `drop ${held.over ? "over" : ""}`, key: name, ondragover: over(true), ondragleave: over(false),
    ondrop: (/** @type {DragEvent} */ event) => { over(false)(event); send(event.dataTransfer?.files[0]); } },
  h("strong", {}, text), h("span", { class: "quiet small" }, "DataFlash .bin, ULog .ulg, telemetry .tlog, tables .csv .npz .mat"),
  h("input", { type: "file", class: "hidden-file", onchange: (/** @type {Event} */ event) => {
    const field = /** @type {HTMLInputElement} */ (event.target);
    send(field.files?.[0]);
    field.value = "";
  } }));
}
