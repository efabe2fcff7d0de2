// Tells somebody who holds the vehicle what has changed, by tone, vibration and voice.

import { cue, keepAwake, say } from "../../core/cues.js";
import { BUSY } from "../../core/store.js";
import { forgetCloud } from "../samples.js";
import { held } from "./pose.js";

/** @import { JobModel } from "../../mavcal.d.ts" */
/** @typedef {typeof import("../../core/store.js").store} Store */
/** @typedef {{ id: string, state: string, text: string, stable: boolean, missing: number }} Seen */

/** @type {Seen} */
let before = { id: "", state: "", text: "", stable: false, missing: 0 };

/** @param {Store} store */
export function watchJobs(store) {
  const { room, id } = store.place;
  const job = room === "job" ? store.full.get(id) : undefined;
  keepAwake(job !== undefined && BUSY.has(job.state));
  if (!job) {
    before = { ...before, id: "" };
    return;
  }
  const now = seen(job);
  if (before.id === now.id) tell(before, now);
  else forgetCloud();
  before = now;
}

/** @param {JobModel} job @returns {Seen} */
function seen(job) {
  const { prompt } = job;
  return { id: job.id, state: job.state, text: prompt?.text ?? "", stable: prompt !== null && held(prompt), missing: prompt?.remaining.length ?? 0 };
}

/** @param {Seen} was @param {Seen} is */
function tell(was, is) {
  if (was.state !== is.state) {
    if (is.state === "failed" || is.state === "in_doubt") return sign("fail", "It did not work. Look at the screen.");
    if (is.state === "review" || is.state === "succeeded") return sign("done", is.state === "review" ? "Ready for your review." : "Done.");
  }
  if (!is.text) return undefined; // nothing is asked for: it computes, or somebody has cancelled
  if (is.missing < was.missing) return sign("done", is.text);
  if (is.stable && !was.stable) return sign("hold", "");
  if (is.text !== was.text) return sign("next", is.text);
  return undefined;
}

/** @param {import("../../core/cues.js").Cue} name @param {string} text */
function sign(name, text) {
  cue(name);
  if (text) say(text);
}
