// How a job ended, what it left out, or what is in doubt: cause and remedy, never more than was read.

import { h } from "../../core/dom.js";
import { number, sentence, STATES, tone, unitName } from "../../core/words.js";
import { table } from "../parts.js";

/** @import { JobModel, LeftOutModel } from "../../mavcal.d.ts" */
/** @import { Tone } from "../parts.js" */

const PROOF = { full: ["good", "Proved on the vehicle"], partial: ["warn", "Proved in part"], none: ["warn", "Written and read back, not proved"] };

/** Whether the old values are back because somebody asked for it. @param {JobModel} job */
export const takenBack = (job) => job.state === "reverted" && job.outcome?.kind === "result";

/** The job's badge: its tone and its words. @param {JobModel} job @returns {[Tone, string]} */
export function stateOf(job) {
  if (job.prompt?.step === "silent") return ["warn", "Vehicle silent"];
  if (job.state === "succeeded" && job.left_out.length) return ["bad", "Done in part"];
  return [takenBack(job) ? "good" : tone(job.state), STATES[job.state]];
}

/** What could not be calibrated, and why: the first thing to be read of a result. @param {JobModel} job */
export function leftOut(job) {
  const sensors = [...job.left_out, ...job.broken];
  if (!sensors.length) return null;
  const names = sensors.map(({ sensor, instance }) => unitName(sensor, instance));
  return h("section", { class: "outcome bad left-out", role: "alert", key: "left out" },
    h("h2", {}, `${names.join(" and ")} ${names.length > 1 ? "are" : "is"} left out`),
    sensors.map((out) => h("p", { key: `${out.sensor}${out.instance}` }, `${why(out, sensors.length > 1)}${job.broken.includes(out)
      ? " This calibration does without it." : " It keeps its old calibration."}`)),
    h("p", { class: "remedy" }, h("strong", {}, "What helps: "), "Check the sensor, then calibrate again."));
}

/** @param {LeftOutModel} out @param {boolean} named */
const why = (out, named) => sentence(`${named ? `${unitName(out.sensor, out.instance)}: ` : ""}${out.reason.replace(/\.?$/, ".")}`);

/** @param {JobModel} job */
export function outcome(job) {
  const { outcome: told } = job;
  if (!told) return null;
  if (told.kind === "result") {
    const checked = job.verification !== null && !takenBack(job);
    const [tone, words] = PROOF[told.proof];
    const plain = takenBack(job) ? "The old values are back and read" : job.left_out.length ? "Done in part" : "Done";
    return h("section", { class: `outcome ${checked ? tone : job.left_out.length ? "warn" : "good"}`, role: "status" },
      h("h2", {}, checked ? words : plain),
      h("p", {}, sentence(told.text)),
      checked && told.proof !== "full" && told.proof_reason && !told.text.includes(told.proof_reason) ? h("p", {}, sentence(told.proof_reason)) : null);
  }
  const mild = told.kind === "write_failed" || job.state === "cancelled";
  return h("section", { class: `outcome ${mild ? "warn" : "bad"}`, role: "status" },
    h("h2", {}, told.kind === "write_failed" ? "Nothing was written" : job.state === "cancelled" ? "Cancelled" : "It did not work"),
    h("p", {}, sentence(told.cause)),
    told.remedy ? h("p", { class: "remedy" }, h("strong", {}, "What helps: "), sentence(told.remedy)) : null);
}

/** @param {JobModel} job */
export function standing(job) {
  if (!job.standing.length) return null;
  return h("section", { class: "card bad", role: "alert" },
    h("h2", {}, "Parameters that are not certain"),
    table(["parameter", ">last heard", ">before", ">to be", "note"],
      job.standing.map((s) => [s.name, number(s.value, 7), number(s.old, 7), number(s.new, 7), s.note]), "Parameters that are not certain"));
}
