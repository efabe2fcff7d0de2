// The prompt: what to do now, in letters that are read from three metres.

import { h } from "../../core/dom.js";
import { ask } from "../../core/service.js";
import { POSES, sentence, span, STATES, words } from "../../core/words.js";
import { bar } from "../parts.js";
import { held, taken } from "./pose.js";

/** @import { JobModel, NumberModel } from "../../mavcal.d.ts" */
/** @typedef {typeof import("../../core/store.js").store} Store */

/** @type {Partial<Record<JobModel["state"], string>>} */
const WITHOUT_PROMPT = {
  queued: "Waiting for its turn.",
  running: "Hold still: its calibration is read.",
  fitting: "Computing the result from what was recorded.",
  applying: "Writing to the vehicle. Do not move it.",
  waiting_for_reboot: "Waiting for the vehicle to come back after its restart.",
  verifying: "Checking on the vehicle that the new values are right. Keep it still.",
  rolling_back: "Taking the new values back.",
  in_doubt: "The write was interrupted. Keep the vehicle disarmed and connected: mavcal finishes by itself.",
};

/** @param {Store} store @param {JobModel} job */
export function promptPart(store, job) {
  const prompt = job.prompt;
  const text = prompt?.text || WITHOUT_PROMPT[job.state] || STATES[job.state];
  const progress = job.progress;
  const silent = prompt?.step === "silent";
  const left = progress?.eta === null || silent ? "" : `about ${span(progress?.eta)} left`;
  return h("section", { class: `prompt ${silent ? "silent" : prompt && held(prompt) ? "stable" : ""}`, "aria-live": "assertive", "aria-label": "What to do now" },
    h("p", { class: "say" }, sentence(text)),
    seen(job),
    prompt?.number ? numberForm(store, job, prompt.number) : null,
    progress ? h("div", { class: "advance", "aria-live": "off" },
      bar(progress.current, progress.target, progress.text),
      h("p", { class: "quiet small" }, [progress.text, left].filter(Boolean).join(" · "))) : null);
}

/** What the vehicle itself shows. @param {JobModel} job */
function seen({ prompt }) {
  if (prompt?.silence) {
    const { lasted, limit } = prompt.silence;
    return h("p", { class: "seen warn", "aria-live": "off" }, `Silent for ${span(lasted)}, gives up in ${span(Math.max(0, limit - lasted))}.`);
  }
  if (!prompt?.detected) return null;
  const pose = POSES[prompt.detected];
  if (taken(prompt)) return h("p", { class: "seen quiet" }, `✓ ${pose} is done. Turn it to the next one.`);
  if (prompt.step === "prove" && prompt.detected !== prompt.pose) return h("p", { class: "seen quiet" }, `Seen: ${pose.toLowerCase()}`);
  return h("p", { class: `seen ${prompt.stable ? "good" : "quiet"}` },
    prompt.stable ? `✓ ${pose}: hold it` : `Seen: ${pose.toLowerCase()}, still moving`);
}

/** @param {Store} store @param {JobModel} job @param {NumberModel} number */
function numberForm(store, job, number) {
  const name = words(number.name);
  return h("form", { class: "number-form", key: number.name, onsubmit: (/** @type {Event} */ event) => {
    event.preventDefault();
    const field = /** @type {HTMLInputElement} */ (/** @type {HTMLFormElement} */ (event.target).elements.namedItem("number"));
    store.act(async () => {
      await ask("answer_job", { parameters: { job_id: job.id }, body: { value: field.value } });
      await store.load(job.id);
    });
  } },
  h("label", { for: "number" }, `${sentence(name)}, ${number.low} to ${number.high} ${number.unit}`),
  h("input", { id: "number", name: "number", type: "number", inputmode: "decimal", min: number.low, max: number.high, step: "any", required: true }),
  h("button", { type: "submit", class: "primary" }, "Answer"));
}
